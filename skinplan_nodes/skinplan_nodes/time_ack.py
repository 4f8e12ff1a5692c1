"""A node tells the clock how far it has come, so that time waits for it."""

from rclpy.node import Node
from rclpy.time import Time
from std_msgs.msg import Header

from skinplan_nodes.qos import STATE

TOPIC = "clock/progress"
# Not told more often than that, on the cell's clock [s].
_STEP_S = 0.5


class TimeAck:
    """Publishes the stamp of the newest data that a node has worked off.

    Args:
        node: The node.
    """

    def __init__(self, node: Node) -> None:
        self._name = node.get_name()
        self._publisher = node.create_publisher(Header, TOPIC, STATE)
        self._told_s = 0.0

    def reached(self, stamp_s: float) -> None:
        """Tells that everything up to a time is worked off [s]."""
        if 0.0 <= stamp_s - self._told_s < _STEP_S:
            return
        self._told_s = stamp_s
        self._publish(Time(nanoseconds=round(stamp_s * 1e9)))

    def idle(self) -> None:
        """Tells that there is nothing to wait for."""
        self._told_s = 0.0
        self._publish(Time())

    def _publish(self, stamp: Time) -> None:
        self._publisher.publish(Header(stamp=stamp.to_msg(), frame_id=self._name))
