"""The publishers of a bag's topics, and how their latched ones are brought to another state."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from geometry_msgs.msg import TransformStamped
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from tf2_msgs.msg import TFMessage

from skinplan.recording.latched import latched_depth
from skinplan.recording.model import BagMessage, BagTopic
from skinplan.recording.qos import QosProfile as RecordedQos
from skinplan_nodes.message_types import message_class
from skinplan_nodes.playback_qos import profile_to_play, ros_profile

# Subscribers find a publisher that was made anew within this, or get its state when they do.
_MATCH_S = 0.3
_POLL_S = 0.002
# A subscriber that hangs must not hold up the others for longer.
_PATIENCE_S = 0.5
# Fast DDS asks what has arrived when its queue is full and after some bytes, else only every 3 s:
# with half a queue of small messages each answer would take a second.
_IN_FLIGHT_BYTES = 16_000_000
# A queue that fills within this runs over whatever the subscribers do [s].
_BURST_S = 0.1
_TF_STATIC = "tf2_msgs/msg/TFMessage"

Overrides = Mapping[str, Callable[[RecordedQos], RecordedQos]]


@dataclass
class _Topic:
    kind: Any
    qos: QoSProfile
    publisher: Any
    type_name: str
    depth: int
    sent: int = 0
    unacked: int = 0
    unacked_bytes: int = 0
    since_s: float = 0.0


class BagPublishers:
    """Publishes serialised messages on the topics of a bag.

    Args:
        node: The node.
        topics: Topics to publish.
        overrides: Topic -> what changes its QoS.

    Attributes:
        refused: Topics that can't be published, with the reason.
    """

    def __init__(self, node: Node, topics: list[BagTopic], overrides: Overrides) -> None:
        self._node = node
        self._topics: dict[str, _Topic] = {}
        self.refused: dict[str, str] = {}
        for topic in topics:
            try:
                self._topics[topic.name] = self._made(topic, overrides.get(topic.name))
            except Exception as error:  # an invalid name, a type that is not installed
                self.refused[topic.name] = str(error).splitlines()[0]

    @property
    def names(self) -> frozenset[str]:
        """Topics that are published."""
        return frozenset(self._topics)

    @property
    def latched(self) -> dict[str, int]:
        """Latched topics -> how many of its last messages a late subscriber gets."""
        return {name: topic.depth for name, topic in self._topics.items() if topic.depth}

    def publish(self, message: BagMessage, patient: bool = False) -> None:
        """Publishes one message.

        Args:
            message: The message.
            patient: Subscribers that can't follow are waited for before the queue runs over, also
                where it has not filled at once.
        """
        topic = self._topics[message.topic]
        topic.publisher.publish(message.data)
        topic.sent += 1
        topic.unacked += 1
        topic.unacked_bytes += len(message.data)
        now_s = time.monotonic()
        if topic.unacked == 1:
            topic.since_s = now_s
        full = topic.unacked >= topic.qos.depth or topic.unacked_bytes >= _IN_FLIGHT_BYTES
        # A latched topic's short queue is meant to keep its last messages only.
        at_once = not topic.depth and now_s - topic.since_s < _BURST_S
        if full and (patient or at_once):
            topic.publisher.wait_for_all_acked(Duration(seconds=_PATIENCE_S))
        if full:
            topic.unacked = topic.unacked_bytes = 0

    def restore(self, state: Mapping[str, list[BagMessage]]) -> None:
        """Brings the latched topics to a state: for those who listen and for those who come later.

        A publisher that holds messages which the state does not have is made anew, because a late
        subscriber would get them.
        """
        wanted = {name: _merged(self._topics[name], messages) for name, messages in state.items()}
        stale = {
            name: self._topics[name] for name, data in wanted.items() if self._is_stale(name, data)
        }
        old = {name: topic.publisher for name, topic in stale.items()}
        for topic_name, topic in stale.items():
            topic.publisher = self._publisher(topic.kind, topic_name, topic.qos)
            topic.sent = 0
        _wait_for_subscribers([(old[name], topic.publisher) for name, topic in stale.items()])
        for name, data in wanted.items():
            for piece in data:
                self._topics[name].publisher.publish(piece)
                self._topics[name].sent += 1
        for publisher in old.values():
            self._node.destroy_publisher(publisher)

    def wait_for_all_acked(self, timeout_s: float) -> bool:
        """Waits until all reliable subscribers have everything; False = not within the time."""
        deadline = time.monotonic() + timeout_s
        for topic in self._topics.values():
            left_s = max(0.0, deadline - time.monotonic())
            if not topic.publisher.wait_for_all_acked(Duration(seconds=left_s)):
                return False
        return True

    def _made(
        self, topic: BagTopic, override: Callable[[RecordedQos], RecordedQos] | None
    ) -> _Topic:
        if topic.encoding not in ("cdr", ""):
            raise LookupError(f"messages in CDR are accepted, found {topic.encoding!r}")
        kind = message_class(topic.type_name)
        profile = profile_to_play(topic, override)
        depth = max(1, latched_depth(topic)) if profile.latched else 0
        qos = ros_profile(profile)
        publisher = self._publisher(kind, topic.name, qos)
        return _Topic(kind, qos, publisher, topic.type_name, depth)

    def _publisher(self, kind: Any, name: str, qos: QoSProfile) -> Any:
        # Without events: the executor waits for a publisher's events, and this thread, in which
        # bags are played, would take them away from under it.
        events = PublisherEventCallbacks(use_default_callbacks=False)
        return self._node.create_publisher(kind, name, qos, event_callbacks=events)

    def _is_stale(self, name: str, wanted: list[bytes]) -> bool:
        topic = self._topics[name]
        return topic.sent > 0 and not (topic.qos.depth == 1 and wanted)


def _merged(topic: _Topic, messages: list[BagMessage]) -> list[bytes]:
    """Returns the messages to publish; static transforms in one, each child frame once."""
    if topic.type_name != _TF_STATIC or len(messages) < 2:
        return [message.data for message in messages]
    found: dict[str, TransformStamped] = {}
    for message in messages:
        for item in deserialize_message(message.data, TFMessage).transforms:
            found[item.child_frame_id] = item
    return [serialize_message(TFMessage(transforms=list(found.values())))]


def _wait_for_subscribers(pairs: list[tuple[Any, Any]]) -> None:
    """Waits until publishers have as many subscribers as those that they stand in for."""
    deadline = time.monotonic() + _MATCH_S
    for before, now in pairs:
        count = before.get_subscription_count()
        while now.get_subscription_count() < count and time.monotonic() < deadline:
            time.sleep(_POLL_S)
