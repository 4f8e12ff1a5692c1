"""State, stop and reset of the devices, where they offer them.

With real drivers that have none of these the cell works with the actions alone.
"""

import time
from collections.abc import Callable

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from skinplan_msgs.msg import DeviceState, Status
from std_srvs.srv import Trigger

from skinplan_nodes.qos import LATCHED
from skinplan_nodes.supervisor.control import Request, StepError
from skinplan_nodes.supervisor.faults import Answer, answer_to
from skinplan_nodes.supervisor.machine import Event
from skinplan_nodes.supervisor.waiting import Waiter

DEVICES = ("arm", "base", "camera", "tracker", "scanner")
#: What moves, and is stopped.
MOVING = ("arm", "base")
_ANSWER_S = 2.0
_RESET_PERIOD_S = 1.0
# What a fault's name comes to; the first that it contains counts.
_BY_NAME: dict[str, tuple[tuple[str, int], ...]] = {
    "arm": (("protective", Status.PROTECTIVE_STOP), ("emergency", Status.EMERGENCY_STOP)),
    "base": (
        ("block", Status.BASE_BLOCKED),
        ("lost", Status.BASE_LOST),
        ("emergency", Status.EMERGENCY_STOP),
    ),
    "camera": (("stale", Status.STALE_IMAGE), ("", Status.NO_IMAGE)),
    "tracker": (("", Status.TRACKER_LOST),),
    "scanner": (("", Status.DEVICE_FAILED),),
}


def code_of_state(state: DeviceState) -> int:
    """Returns the status code that a device's state comes to; 0 = it can work, or is just off."""
    if state.state == DeviceState.EMERGENCY_STOP:
        return int(Status.EMERGENCY_STOP)
    if state.state == DeviceState.STOPPED:
        return int(Status.DEVICE_STOPPED)
    if state.state != DeviceState.FAULT:
        return 0
    names = _BY_NAME.get(state.device, ())
    return int(next((code for part, code in names if part in state.fault), Status.DEVICE_FAILED))


class Devices:
    """The devices of a cell.

    Args:
        node: The supervisor.
        waiter: Waits for answers.
        on_fault: Told when a device can't go on.
    """

    def __init__(self, node: Node, waiter: Waiter, on_fault: Callable[[Request], None]) -> None:
        self._waiter = waiter
        self._on_fault = on_fault
        self._states: dict[str, DeviceState] = {}
        self._stopped: set[str] = set()
        self._asked_s = 0.0
        group = ReentrantCallbackGroup()
        self._resets = {
            name: node.create_client(Trigger, f"{name}/reset", callback_group=group)
            for name in DEVICES
        }
        self._stops = {
            name: node.create_client(Trigger, f"{name}/stop", callback_group=group)
            for name in MOVING
        }
        for name in DEVICES:
            node.create_subscription(
                DeviceState,
                f"{name}/state",
                lambda message, device=name: self._on_state(device, message),
                LATCHED,
            )

    def faults(self) -> list[StepError]:
        """Returns why devices can't go on; those that we stopped ourselves are left out."""
        found = []
        for name, state in list(self._states.items()):
            code = code_of_state(state)
            if code and not self._by_us(name, code):
                found.append(StepError(code, _sentence(name, state), name))
        return found

    def stop(self) -> None:
        """Stops what moves, where it offers that; what does not answer in time is left behind."""
        asked = []
        for name, client in self._stops.items():
            if client.service_is_ready():
                self._stopped.add(name)
                asked.append(client.call_async(Trigger.Request()))
        self._waiter.until(lambda: all(answer.done() for answer in asked), _ANSWER_S)

    def reset(self, all_devices: bool) -> None:
        """Resets the devices that we stopped.

        Args:
            all_devices: Also those that stopped by themselves: somebody has looked at them.

        Raises:
            StepError: One of them refused.
        """
        wanted = set(self._stopped)
        if all_devices:
            wanted |= {error.node for error in self.faults()}
        for name in sorted(wanted):
            self._reset(name)

    def reset_by_itself(self) -> None:
        """Asks devices that recover by themselves to go on; does not wait for the answer."""
        if time.monotonic() - self._asked_s < _RESET_PERIOD_S:
            return
        self._asked_s = time.monotonic()
        for error in self.faults():
            client = self._resets.get(error.node)
            if answer_to(error.code) is Answer.AUTOMATIC and client is not None:
                if client.service_is_ready():
                    client.call_async(Trigger.Request())

    def _reset(self, name: str) -> None:
        client = self._resets[name]
        if client.service_is_ready():
            answer = self._waiter.wall(
                client.call_async(Trigger.Request()), 5.0, f"service {name}/reset", name
            )
            if not answer.success:
                code = code_of_state(self._states.get(name, DeviceState()))
                raise StepError(
                    code or Status.DEVICE_STOPPED, f"{name} was not reset: {answer.message}", name
                )
        self._stopped.discard(name)
        # What was latched before the reset does not count any more.
        self._states.pop(name, None)

    def _by_us(self, name: str, code: int) -> bool:
        return name in self._stopped and code == Status.DEVICE_STOPPED

    def _on_state(self, name: str, message: DeviceState) -> None:
        message.device = message.device or name
        before = self._states.get(name)
        self._states[name] = message
        code = code_of_state(message)
        known = before is not None and code_of_state(before) == code
        if code and not known and not self._by_us(name, code):
            self._on_fault(Request(Event.FAULT, code, _sentence(name, message), name))


def _sentence(name: str, state: DeviceState) -> str:
    return f"{name}: {state.message or state.fault or 'it does not take orders'}"
