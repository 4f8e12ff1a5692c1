"""What every node of the cell has: a parameter table, a heartbeat, its health, a clean end."""

import os
import threading
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, ClassVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.exceptions import InvalidHandle
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from skinplan_msgs.msg import Heartbeat

from skinplan_nodes.parameters import Parameter, declare
from skinplan_nodes.qos import STATE

HEARTBEAT_PERIOD_S = 1.0
RCLError = rclpy_implementation.RCLError
_LEVELS = {
    "ok": DiagnosticStatus.OK,
    "warning": DiagnosticStatus.WARN,
    "error": DiagnosticStatus.ERROR,
}

#: Of the lifecycle nodes.
AUTOSTART = Parameter(
    "autostart", True, "Configure and activate at the start, without a lifecycle manager."
)
_beating: set[Any] = set()
_NO_PUBLISHER_EVENTS = PublisherEventCallbacks(use_default_callbacks=False)
_NO_SUBSCRIPTION_EVENTS = SubscriptionEventCallbacks(use_default_callbacks=False)


class CellNodeMixin:
    """Declares the parameters, sends heartbeat and health; for `Node` and `LifecycleNode`.

    Attributes:
        NAME: Name of the node.
        PARAMETERS: Its parameters.
        THREADS: Threads of its executor; each message costs more than twice as much with several.
        LARGE_MESSAGES: It publishes or takes megabytes: its program gets more shared memory.
        values: The parameters' values by name.
        asked_to_end: Set at a signal, and by a node that wants to end by itself.
        exit_code: Of the program, when it ends without an error.
    """

    NAME: ClassVar[str]
    PARAMETERS: ClassVar[Sequence[Parameter]] = ()
    THREADS: ClassVar[int] = 1
    LARGE_MESSAGES: ClassVar[bool] = False

    values: SimpleNamespace
    asked_to_end: threading.Event
    exit_code: int

    def __init__(self: Any, **kwargs: Any) -> None:
        super().__init__(self.NAME, **kwargs)
        self.asked_to_end = threading.Event()
        self.exit_code = 0
        self.values = declare(self, self.PARAMETERS)
        self._health = (DiagnosticStatus.OK, "", {})
        self._beats = 0
        self._heartbeat = self.create_publisher(Heartbeat, "heartbeat", STATE)
        self._diagnostics = self.create_publisher(DiagnosticArray, "diagnostics", STATE)
        # Wall time and a thread of its own: alive also while time stands still or a plan is made,
        # and the executor needs no second thread for it, which costs much under many messages.
        self._no_more_beats = threading.Event()
        self._heart = threading.Thread(target=self._beat, name="heartbeat", daemon=True)
        _beating.add(self)
        self._heart.start()

    def create_publisher(self: Any, *args: Any, **kwargs: Any) -> Any:
        """As the node's, without events of its own: see `create_subscription`."""
        kwargs["event_callbacks"] = kwargs.get("event_callbacks") or _NO_PUBLISHER_EVENTS
        return super().create_publisher(*args, **kwargs)

    def create_subscription(self: Any, *args: Any, **kwargs: Any) -> Any:
        """As the node's, without events of its own.

        rclpy gives each topic two, for a warning when the other end's quality of service does not
        fit, and its executor looks at all of them for every message: a third of what a run of the
        whole graph costs. The other end still warns.
        """
        kwargs["event_callbacks"] = kwargs.get("event_callbacks") or _NO_SUBSCRIPTION_EVENTS
        return super().create_subscription(*args, **kwargs)

    def close(self) -> None:
        """Ends what must not be cut off; called before the node's context is shut."""

    def ended(self: Any) -> bool:
        """Tells whether the node has to end; the library asks in long work."""
        return self.asked_to_end.is_set() or not self.context.ok()

    def now_s(self: Any) -> float:
        """Returns the time on the cell's clock [s]."""
        return float(self.get_clock().now().nanoseconds * 1e-9)

    def set_health(self: Any, level: str, message: str, **details: Any) -> None:
        """Says how the node is; goes out at once and with every heartbeat.

        Args:
            level: ``ok``, ``warning`` or ``error``.
            message: One sentence; may be empty when ok.
            details: Further values by name.
        """
        self._health = (_LEVELS[level], message, details)
        self._publish_health()

    def health_values(self) -> dict[str, Any]:
        """Returns values that go out with every report of the node's health; none here."""
        return {}

    def note_progress(self: Any, share: float, text: str) -> None:
        """Takes the progress of long work; goes out with the next heartbeat."""
        self._health = (DiagnosticStatus.OK, text, {"progress": f"{share:.2f}"})

    def destroy_node(self: Any) -> None:
        """Ends the heartbeat with the node."""
        self.end_heartbeat()
        super().destroy_node()

    def end_heartbeat(self: Any) -> None:
        """Sends no more; to be called before the context is shut, under which nobody may send."""
        self._no_more_beats.set()
        self._heart.join(HEARTBEAT_PERIOD_S)
        _beating.discard(self)

    def _beat(self: Any) -> None:
        while self.context.ok():
            try:
                self._on_heartbeat()
            except (RCLError, InvalidHandle):
                # The context or the node was ended meanwhile.
                return
            if self._no_more_beats.wait(HEARTBEAT_PERIOD_S):
                return

    def _on_heartbeat(self: Any) -> None:
        self._beats += 1
        name = self.get_fully_qualified_name()
        self._heartbeat.publish(Heartbeat(node=name, pid=os.getpid(), count=self._beats))
        self._publish_health()

    def _publish_health(self: Any) -> None:
        level, message, details = self._health
        name = self.get_fully_qualified_name()
        status = DiagnosticStatus(level=level, name=name, message=message, hardware_id=self.NAME)
        status.values = [
            KeyValue(key=key, value=str(value))
            for key, value in {**details, **self.health_values()}.items()
        ]
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)


def end_heartbeats() -> None:
    """Ends those of all nodes of this process, also of one whose constructor has failed."""
    for node in list(_beating):
        node.end_heartbeat()


class CellNode(CellNodeMixin, Node):
    """A node of the cell."""


class CellLifecycleNode(CellNodeMixin, LifecycleNode):
    """A node of the cell that owns a device or a file; `AUTOSTART` is one of its parameters."""

    def autostart(self) -> None:
        """Configures and activates, when the parameter says so; ends the constructor."""
        if self.values.autostart:
            self.trigger_configure()
            self.trigger_activate()
