"""What the mock devices tell and take beside their own interfaces: state, stop, reset, enable."""

import os
import signal
from collections.abc import Callable, Iterable
from typing import Any

from rclpy.clock import Clock, ClockType
from skinplan_msgs.msg import DeviceState, Status
from skinplan_msgs.srv import InjectFault
from std_srvs.srv import SetBool, Trigger

from skinplan.mock.device import Device, DeviceRecord
from skinplan.mock.faults import PROCESS_KILLED, Fault, FaultBook, FaultKind, parse_fault
from skinplan.transforms import Array
from skinplan_nodes.conversions import header_to_msg, key_values_from_msg, xyz_from_msg
from skinplan_nodes.parameters import Parameter
from skinplan_nodes.qos import LATCHED
from skinplan_nodes.replies import RefusedError, replies

#: Of every mock device.
FAULTS = Parameter(
    "faults",
    [""],
    "Faults to have, each as name[@time_s][+duration_s][;key=value]; empty = none.",
)
_TELL_S = 1.0
_DIE_S = 0.1


class DeviceFace:
    """Topic ``<device>/state`` and services ``<device>/stop``, ``/reset`` and ``/enable``.

    Args:
        node: The node that owns the device.
        name: arm, base, camera, tracker or scanner.
        on_stop: Called when the device has to stand still now.
        on_enable: Called when it is switched on or off.
        on_reset: Called when it takes orders again.
    """

    def __init__(
        self,
        node: Any,
        name: str,
        on_stop: Callable[[str], None] | None = None,
        on_enable: Callable[[bool], None] | None = None,
        on_reset: Callable[[], None] | None = None,
    ) -> None:
        self.device = Device(name)
        self._node = node
        self._on_stop_hook, self._on_enable_hook, self._on_reset_hook = on_stop, on_enable, on_reset
        self._told: DeviceRecord | None = None
        self._publisher = node.create_publisher(DeviceState, f"{name}/state", LATCHED)
        node.create_service(Trigger, f"{name}/stop", self._on_stop)
        node.create_service(Trigger, f"{name}/reset", self._on_reset)
        node.create_service(SetBool, f"{name}/enable", self._on_enable)
        node.create_timer(_TELL_S, self._tell, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def get_logger(self) -> Any:
        """Returns the node's logger."""
        return self._node.get_logger()

    def fail(self, fault: str, reason: str, emergency: bool = False) -> None:
        """The device stops by itself; what it was doing ends with the fault's name."""
        self.device.fail(fault, reason, emergency)
        self.get_logger().warning(f"{self.device.name}: {fault}: {reason}")
        self._stand(f"{fault}: {reason}")

    def refresh(self) -> None:
        """Tells the state when it has changed."""
        if self.device.record != self._told:
            self._tell()

    def _tell(self) -> None:
        record = self._told = self.device.record
        message = DeviceState(
            header=header_to_msg("", self._node.now_s()),
            device=self.device.name,
            state=int(record.mode),
            fault=record.fault,
            message=record.message,
            moving=record.moving,
        )
        self._publisher.publish(message)

    def _stand(self, reason: str) -> None:
        if self._on_stop_hook is not None:
            self._on_stop_hook(reason)
        self.refresh()

    @replies
    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> None:
        self.device.stop(f"{self.device.name} was stopped, a reset is needed")
        self._stand("stopped: by service")
        response.message = "stopped"

    @replies
    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> None:
        self.device.reset()
        if self._on_reset_hook is not None:
            self._on_reset_hook()
        self.refresh()
        response.message = self.device.record.mode.name.lower()

    @replies
    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> None:
        name = self.device.name
        if request.data:
            self.device.require_reset_done()
        self.device.enabled = request.data
        if self._on_enable_hook is not None:
            self._on_enable_hook(request.data)
        if not request.data:
            self._stand(f"disabled: {name} was switched off")
        self.refresh()
        response.message = f"{name} {'on' if request.data else 'off'}"


class FaultFace:
    """Service ``<node>/inject_fault`` and the parameter ``faults``.

    Args:
        node: The node whose devices fail.
        kinds: Faults that they can have.
        on_begin: Called when one begins.
        on_end: Called with the name of one that ended.

    Raises:
        InputError: The parameter has a fault that can't be used.
    """

    def __init__(
        self,
        node: Any,
        kinds: Iterable[FaultKind],
        on_begin: Callable[[Fault], None],
        on_end: Callable[[str], None],
    ) -> None:
        self._node = node
        self._begin, self._end = on_begin, on_end
        self._place: Array | None = None
        self.book = FaultBook(kinds, node.NAME)
        for text in node.values.faults:
            self.book.add(parse_fault(text))
        node.create_service(InjectFault, f"{node.NAME}/inject_fault", self._on_inject)

    def get_logger(self) -> Any:
        """Returns the node's logger."""
        return self._node.get_logger()

    def step(self, now_s: float, place: Array | None = None) -> None:
        """Lets begin and end what is due.

        Args:
            now_s: Time on the cell's clock [s].
            place: Where the device is, frame map, shape (3,) [m]; None = as before.
        """
        self._place = self._place if place is None else place
        begun, ended = self.book.step(now_s, self._place)
        for name in ended:
            self.get_logger().warning(f"fault {name} ends")
            self._end(name)
        for fault in begun:
            self.get_logger().warning(f"fault {fault.name} begins")
            if fault.name == PROCESS_KILLED:
                # A little later, so that an answer still goes out.
                self._node.create_timer(_DIE_S, _die, clock=Clock(clock_type=ClockType.STEADY_TIME))
            else:
                self._begin(fault)

    @replies(invalid=Status.REQUEST_INVALID)
    def _on_inject(self, request: InjectFault.Request, response: InjectFault.Response) -> None:
        if request.fault:
            self.book.add(_fault_of(request))
        else:
            self.book.clear()
        self.step(self._node.now_s())
        response.active, response.pending = self.book.active, self.book.pending


def _die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def _fault_of(request: InjectFault.Request) -> Fault:
    values = {}
    items = key_values_from_msg(request.values)
    if len(dict(items)) != len(items):
        raise RefusedError(
            Status.REQUEST_INVALID, f"{request.fault}: every value once is accepted, found {items}"
        )
    for key, text in items:
        try:
            values[key] = float(text)
        except ValueError:
            raise RefusedError(
                Status.REQUEST_INVALID,
                f"{request.fault}: numbers are accepted as values, found {key} = {text!r}",
            ) from None
    place = tuple(float(each) for each in xyz_from_msg(request.place))
    return Fault(
        request.fault,
        request.at,
        request.duration,
        (place[0], place[1], place[2]),
        request.radius,
        values,
    )
