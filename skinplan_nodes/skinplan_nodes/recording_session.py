"""One recording: subscribes the chosen topics, hands the serialised messages to a writer thread."""

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.qos import (
    QoSDurabilityPolicy,
    QoSHistoryPolicy,
    QoSLivelinessPolicy,
    QoSProfile,
    QoSReliabilityPolicy,
)
from rclpy.topic_endpoint_info import TopicEndpointInfo

from skinplan.errors import BagNotWritableError
from skinplan.recording.bag import BagSettings, BagWriter
from skinplan.recording.message_queue import MessageQueue, QueuedMessage
from skinplan.recording.model import BagSummary
from skinplan.recording.qos import INFINITE_NS
from skinplan.recording.qos import QosProfile as RecordedQos
from skinplan.recording.ring import SnapshotRing
from skinplan.recording.schema import schema_with_dependencies
from skinplan.recording.selection import TopicSelection
from skinplan.recording.sequence_gaps import SequenceGaps
from skinplan_nodes.conversions import raw_stamp_s
from skinplan_nodes.message_types import definition_text, message_class
from skinplan_nodes.time_ack import TimeAck

_DEPTH = 2000
# Messages of one topic taken in a row; then the others have their turn.
_MOST_AT_ONCE = 200
_STEADY_TOPIC = "/joint_states"
# Who publishes a known topic, and how, is asked at every so many-th search: it costs ten times as
# much as to count them, of which the others take note.
_THOROUGH = 8


@dataclass(frozen=True)
class RecordingOrder:
    """What is to be recorded, and how.

    Attributes:
        folder: Bag folder.
        metadata: Facts about the run.
        queue_bytes: So much waits for the disk at most [B].
        settings: How the bag is written.
        selection: Which topics.
        snapshot_bytes: Memory of the snapshot mode [B]; 0 = everything goes to the disk at once.
        snapshot_s: How far back a snapshot reaches [s]; 0 = as far as the memory does.
    """

    folder: Path
    metadata: Mapping[str, str]
    queue_bytes: int
    settings: BagSettings = field(default_factory=BagSettings)
    selection: TopicSelection = field(default_factory=TopicSelection)
    snapshot_bytes: int = 0
    snapshot_s: float = 0.0


@dataclass(frozen=True)
class _Subscribed:
    """A topic that is recorded; `take_waiting` takes at most so many messages that wait."""

    qos: QoSProfile
    subscription: Any
    publishers: int
    take_waiting: Callable[[int], None]


class RecordingSession:
    """Records topics of the graph into one bag.

    Args:
        node: The node that subscribes.
        order: What is to be recorded.
        group: Callback group of the subscriptions.
        ack: Tells the clock how far the recording has come.

    Raises:
        BagNotWritableError: The folder is not empty, or can't be created.
        DiskFullError: The disk has too little left.
    """

    def __init__(
        self, node: Node, order: RecordingOrder, group: CallbackGroup, ack: TimeAck
    ) -> None:
        self._node = node
        self._ack = ack
        self._group = group
        self._selection = order.selection
        self._bag = BagWriter(order.folder, order.metadata, order.settings)
        self._queue = MessageQueue(self._bag, order.queue_bytes)
        self._ring: SnapshotRing | None = None
        if order.snapshot_bytes:
            self._ring = SnapshotRing(order.snapshot_bytes, order.snapshot_s)
        self._snapshots = 0
        self._subscriptions: dict[str, _Subscribed] = {}
        self._gaps: dict[str, SequenceGaps] = {}
        self._refused: set[str] = set()
        self._searches = 0
        # The end comes from another thread than what looks for topics.
        self._subscribing = threading.Lock()
        self._over = False
        self._last_ns = 0
        self.dropped_topics: dict[str, int] = {}

    @property
    def folder(self) -> Path:
        """Bag folder."""
        return self._bag.folder

    @property
    def dropped(self) -> int:
        """Messages dropped so far, or lost on their way here."""
        return sum([*(self.dropped_topics or self._missing()).values()])

    @property
    def topics(self) -> int:
        """Topics subscribed so far."""
        return len(self._subscriptions)

    @property
    def failure(self) -> BagNotWritableError | None:
        """Why nothing more can be written; None = all is well."""
        return self._bag.failure

    def figures(self) -> dict[str, Any]:
        """Returns how the recording is going, for the diagnostics."""
        worst = sorted(self._missing().items(), key=lambda item: -item[1])[:5]
        return {
            "messages": self._bag.messages,
            "topics": self.topics,
            "dropped": self.dropped,
            "dropped_topics": ", ".join(f"{topic}: {count}" for topic, count in worst),
            "waiting_bytes": self._queue.waiting_bytes,
            "refused": "" if self._queue.failure is None else str(self._queue.failure),
        }

    def discover(self) -> None:
        """Subscribes topics that are new, and anew where publishers offer less than before."""
        self._searches += 1
        thorough = self._searches % _THOROUGH == 1
        for topic, types in self._node.get_topic_names_and_types():
            if topic in self._refused or not self._selection.takes(topic, types[0]):
                continue
            known = self._subscriptions.get(topic)
            if (
                known is not None
                and not thorough
                and self._node.count_publishers(topic) == known.publishers
            ):
                continue
            publishers = self._node.get_publishers_info_by_topic(topic)
            if not publishers:
                continue
            self._gaps.setdefault(topic, SequenceGaps()).note_publishers(len(publishers))
            wanted = matching_qos(publishers)
            if known is not None and (known.qos, known.publishers) == (wanted, len(publishers)):
                continue
            try:
                with self._subscribing:
                    if self._over:
                        return
                    self._subscribe(topic, types[0], publishers, wanted)
            except (LookupError, BagNotWritableError) as error:
                if self.failure is not None:
                    return
                self._refused.add(topic)
                self._node.get_logger().warning(f"topic {topic} is not recorded: {error}")

    def split(self) -> Path:
        """Begins the next file.

        Returns:
            The file that was closed.

        Raises:
            BagNotWritableError: The disk does not take it.
        """
        return self._bag.split(self._last_ns)

    def snapshot(self) -> tuple[int, float]:
        """Writes the last messages to the bag; each further snapshot begins a file.

        Returns:
            Number of messages, and the time that they span [s].

        Raises:
            BagNotWritableError: This is no recording in snapshot mode, or the disk is full.
        """
        if self._ring is None:
            raise BagNotWritableError(
                f"a snapshot was asked for, but everything is recorded to {self.folder} at once; "
                "recorder/start with snapshot begins a recording in snapshot mode"
            )
        messages = self._ring.take()
        if messages and self._snapshots:
            self.split()
        self._snapshots += bool(messages)
        self._queue.put_all(messages)
        span_ns = messages[-1].log_time_ns - messages[0].log_time_ns if messages else 0
        return len(messages), span_ns * 1e-9

    def finish(self) -> BagSummary:
        """Ends the subscriptions, writes what waits, closes the bag.

        Raises:
            BagNotWritableError: Not even the end of the bag could be written.
        """
        with self._subscribing:
            self._over = True
            for known in self._subscriptions.values():
                self._end(known)
        self._ack.idle()
        self._queue.finish()
        self.dropped_topics = self._missing()
        if self.dropped_topics:
            text = ", ".join(f"{topic}: {n}" for topic, n in sorted(self.dropped_topics.items()))
            self._bag.note("dropped", text)
        summary = self._bag.finish()
        for topic, count in summary.lost.items():
            self.dropped_topics[topic] = self.dropped_topics.get(topic, 0) + count
        return summary

    def _missing(self) -> dict[str, int]:
        """What the queue dropped and what was lost on its way here, by topic."""
        found = dict(self._queue.dropped)
        for topic, gaps in list(self._gaps.items()):
            if gaps.lost:
                found[topic] = found.get(topic, 0) + gaps.lost
        return found

    def _subscribe(
        self, topic: str, type_name: str, publishers: list[TopicEndpointInfo], qos: QoSProfile
    ) -> None:
        kind = message_class(type_name)
        offered = [recorded_qos(info.qos_profile) for info in publishers]
        self._bag.add_topic(
            topic,
            type_name,
            schema_with_dependencies(type_name, definition_text),
            str(publishers[0].topic_type_hash),
            offered,
        )
        if self._ring is not None and any(profile.latched for profile in offered):
            self._ring.latch(topic)
        known = self._subscriptions.get(topic)
        if known is not None and known.qos == qos:
            # Another publisher of the same kind: the subscription serves it, too.
            self._subscriptions[topic] = replace(known, publishers=len(publishers))
            return
        if known is not None:
            self._end(known)
        subscription: Any = None
        take = self._taker(topic)

        def take_waiting(most: int) -> None:
            for _ in range(most):
                try:
                    with subscription.handle:
                        found = subscription.handle.take_message(kind, True)
                except InvalidHandle:
                    return
                if found is None:
                    return
                take(*found)

        def take_all(data: bytes, info: Any) -> None:
            take(data, info)
            # What waits behind it, without the executor's round for each message.
            take_waiting(_MOST_AT_ONCE)

        subscription = self._node.create_subscription(
            kind, topic, take_all, qos, raw=True, callback_group=self._group
        )
        self._subscriptions[topic] = _Subscribed(qos, subscription, len(publishers), take_waiting)

    def _end(self, known: _Subscribed) -> None:
        """Ends a subscription; what has come, and its sender was told so, is taken before."""
        known.take_waiting(_DEPTH)
        self._node.destroy_subscription(known.subscription)

    def _taker(self, topic: str) -> Callable[[bytes, Any], None]:
        clock = self._node.get_clock()
        on_cell_clock = bool(clock.ros_time_is_active)
        put, note = self._put, self._gaps[topic].note
        # The most frequent topic tells how far this node has come.
        steady = topic.endswith(_STEADY_TOPIC)

        def take(data: bytes, info: Any) -> None:
            note(info["publication_sequence_number"])
            if steady:
                self._ack.reached(raw_stamp_s(data))
            if on_cell_clock:
                # What the publisher's time was on the cell's clock nobody says.
                now_ns = published_ns = clock.now().nanoseconds
            else:
                now_ns, published_ns = time.time_ns(), info["source_timestamp"]
            # The order of receipt is kept even when the cell's clock is set back.
            self._last_ns = max(self._last_ns, now_ns)
            put(topic, data, self._last_ns, published_ns if published_ns > 0 else self._last_ns)

        return take

    def _put(self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        if self._ring is None:
            self._queue.put(topic, data, log_time_ns, publish_time_ns)
        else:
            self._ring.add(QueuedMessage(topic, data, log_time_ns, publish_time_ns))


def matching_qos(publishers: list[TopicEndpointInfo]) -> QoSProfile:
    """Returns the strictest QoS that all publishers of a topic can serve."""
    profiles = [info.qos_profile for info in publishers]
    reliable = all(p.reliability == QoSReliabilityPolicy.RELIABLE for p in profiles)
    latched = all(p.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL for p in profiles)
    return QoSProfile(
        history=QoSHistoryPolicy.KEEP_LAST,
        depth=_DEPTH,
        reliability=(
            QoSReliabilityPolicy.RELIABLE if reliable else QoSReliabilityPolicy.BEST_EFFORT
        ),
        durability=(
            QoSDurabilityPolicy.TRANSIENT_LOCAL if latched else QoSDurabilityPolicy.VOLATILE
        ),
    )


def recorded_qos(profile: QoSProfile) -> RecordedQos:
    """Converts offered QoS for the bag."""
    return RecordedQos(
        history=_name(QoSHistoryPolicy(profile.history)),
        depth=profile.depth,
        reliability=_name(QoSReliabilityPolicy(profile.reliability)),
        durability=_name(QoSDurabilityPolicy(profile.durability)),
        deadline_ns=min(profile.deadline.nanoseconds, INFINITE_NS),
        lifespan_ns=min(profile.lifespan.nanoseconds, INFINITE_NS),
        liveliness=_name(QoSLivelinessPolicy(profile.liveliness)),
        liveliness_lease_ns=min(profile.liveliness_lease_duration.nanoseconds, INFINITE_NS),
        avoid_ros_namespace_conventions=profile.avoid_ros_namespace_conventions,
    )


def _name(policy: Any) -> str:
    return str(policy.short_key)
