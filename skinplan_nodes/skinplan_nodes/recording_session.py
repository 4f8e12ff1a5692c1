"""One recording: subscribes every topic, hands the serialised messages to a writer thread."""

import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rclpy.callback_groups import CallbackGroup
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
from skinplan.recording.bag import BagWriter
from skinplan.recording.model import BagSummary
from skinplan.recording.qos import INFINITE_NS
from skinplan.recording.qos import QosProfile as RecordedQos
from skinplan.recording.schema import schema_with_dependencies
from skinplan_nodes.conversions import raw_stamp_s
from skinplan_nodes.draining import subscribe_draining
from skinplan_nodes.message_types import definition_text, message_class
from skinplan_nodes.time_ack import TimeAck

_DEPTH = 500
_STEADY_TOPIC = "/joint_states"


@dataclass(frozen=True)
class _Item:
    topic: str
    data: bytes
    time_ns: int


class WriterThread:
    """Writes messages to a bag in the background; what does not fit into its queue is dropped.

    Args:
        writer: The bag.
        queue_bytes: So many bytes wait at most.
    """

    def __init__(self, writer: BagWriter, queue_bytes: int) -> None:
        self._writer = writer
        self._most = queue_bytes
        self._items: deque[_Item] = deque()
        self._bytes = 0
        self._changed = threading.Condition()
        self._ended = False
        self.dropped = 0
        self.failure: BagNotWritableError | None = None
        self._thread = threading.Thread(target=self._run, name="bag writer", daemon=True)
        self._thread.start()

    def put(self, topic: str, data: bytes, time_ns: int) -> None:
        """Takes a message."""
        with self._changed:
            if self._ended or self.failure or self._bytes + len(data) > self._most:
                self.dropped += 1
                return
            self._items.append(_Item(topic, data, time_ns))
            self._bytes += len(data)
            self._changed.notify()

    def finish(self) -> None:
        """Writes what waits, and ends."""
        with self._changed:
            self._ended = True
            self._changed.notify()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                while not self._items and not self._ended:
                    self._changed.wait()
                if not self._items:
                    return
                item = self._items.popleft()
                self._bytes -= len(item.data)
            try:
                self._writer.write(item.topic, item.data, item.time_ns)
            except BagNotWritableError as error:
                self.failure = error
                with self._changed:
                    self.dropped += 1 + len(self._items)
                    self._items.clear()
                    self._bytes = 0


class RecordingSession:
    """Records every topic of the graph into one bag.

    Args:
        node: The node that subscribes.
        folder: Bag folder.
        metadata: Facts about the run.
        queue_bytes: So many bytes wait for the disk at most.
        group: Callback group of the subscriptions.
        ack: Tells the clock how far the recording has come.

    Raises:
        BagNotWritableError: The folder is not empty, or can't be created.
    """

    def __init__(
        self,
        node: Node,
        folder: Path,
        metadata: Mapping[str, str],
        queue_bytes: int,
        group: CallbackGroup,
        ack: TimeAck,
    ) -> None:
        self._node = node
        self._group = group
        self._bag = BagWriter(folder, metadata)
        self._thread = WriterThread(self._bag, queue_bytes)
        self._subscriptions: dict[str, tuple[QoSProfile, Any]] = {}
        self._refused: set[str] = set()
        self._last_ns = 0
        self._ack = ack

    @property
    def dropped(self) -> int:
        """Messages dropped so far."""
        return self._thread.dropped

    @property
    def topics(self) -> int:
        """Topics subscribed so far."""
        return len(self._subscriptions)

    @property
    def failure(self) -> BagNotWritableError | None:
        """Why nothing more can be written; None = all is well."""
        return self._thread.failure

    def discover(self) -> None:
        """Subscribes topics that are new, and anew where publishers offer less than before."""
        for topic, types in self._node.get_topic_names_and_types():
            if topic in self._refused or _is_left_out(topic):
                continue
            publishers = self._node.get_publishers_info_by_topic(topic)
            if not publishers:
                continue
            known = self._subscriptions.get(topic)
            wanted = matching_qos(publishers)
            if known is not None and known[0] == wanted:
                continue
            try:
                self._subscribe(topic, types[0], publishers, wanted)
            except (LookupError, BagNotWritableError) as error:
                self._refused.add(topic)
                self._node.get_logger().warning(f"topic {topic} is not recorded: {error}")

    def finish(self) -> BagSummary:
        """Ends the subscriptions, writes what waits, closes the bag.

        Raises:
            BagNotWritableError: The disk did not take everything.
        """
        for _, subscription in self._subscriptions.values():
            self._node.destroy_subscription(subscription)
        self._ack.idle()
        self._thread.finish()
        return self._bag.finish()

    def _subscribe(
        self, topic: str, type_name: str, publishers: list[TopicEndpointInfo], qos: QoSProfile
    ) -> None:
        kind = message_class(type_name)
        known = self._subscriptions.pop(topic, None)
        if known is not None:
            self._node.destroy_subscription(known[1])
        self._bag.add_topic(
            topic,
            type_name,
            schema_with_dependencies(type_name, definition_text),
            str(publishers[0].topic_type_hash),
            [recorded_qos(info.qos_profile) for info in publishers],
        )
        self._subscriptions[topic] = (
            qos,
            subscribe_draining(
                self._node, kind, topic, self._taker(topic), qos, self._group, raw=True
            ),
        )

    def _taker(self, topic: str) -> Callable[[bytes], None]:
        clock = self._node.get_clock()
        # The most frequent topic tells how far this node has come.
        steady = topic.endswith(_STEADY_TOPIC)

        def take(data: bytes) -> None:
            if steady:
                self._ack.reached(raw_stamp_s(data))
            # The order of receipt is kept even when the cell's clock is set back.
            self._last_ns = max(self._last_ns, clock.now().nanoseconds)
            self._thread.put(topic, data, self._last_ns)

        return take


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


def offered_qos(recorded: RecordedQos) -> QoSProfile:
    """Returns the QoS with which a recorded topic is published again."""
    reliable = recorded.reliability != "best_effort"
    return QoSProfile(
        history=QoSHistoryPolicy.KEEP_LAST,
        depth=recorded.depth or _DEPTH,
        reliability=(
            QoSReliabilityPolicy.RELIABLE if reliable else QoSReliabilityPolicy.BEST_EFFORT
        ),
        durability=(
            QoSDurabilityPolicy.TRANSIENT_LOCAL
            if recorded.latched
            else QoSDurabilityPolicy.VOLATILE
        ),
    )


def _name(policy: Any) -> str:
    return str(policy.short_key)


def _is_left_out(topic: str) -> bool:
    """Tells whether a topic is not for the bag.

    ROS hides those of actions, ``ros2 bag`` leaves them out, too; what only a simulation can know
    is for no node of the cell.
    """
    return any(part.startswith("_") or part == "truth" for part in topic.split("/"))
