"""State of a mock device: what it takes orders in, what stops it, what a reset needs."""

from dataclasses import dataclass
from enum import IntEnum

from skinplan.errors import DeviceRefusedError


class Mode(IntEnum):
    """States of a device; the numbers are those of ``skinplan_msgs/DeviceState``."""

    UNKNOWN = 0
    READY = 1
    BUSY = 2
    DISABLED = 3
    STOPPED = 4
    FAULT = 5
    EMERGENCY_STOP = 6


@dataclass(frozen=True)
class DeviceRecord:
    """What a device says about itself.

    Attributes:
        mode: Its state.
        fault: Name of the fault; empty = none.
        message: One sentence; empty when it is ready or busy.
        moving: Whether it moves at this moment.
    """

    mode: Mode
    fault: str = ""
    message: str = ""
    moving: bool = False


class Device:
    """One device. The strongest of emergency stop, fault, stop and switched off is its state.

    Args:
        name: arm, base, camera, tracker or scanner.

    Attributes:
        enabled: Switched on.
        busy: Carries out an order.
        moving: Moves at this moment.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.enabled = True
        self.busy = False
        self.moving = False
        self._stopped = ""
        self._fault = ""
        self._reason = ""
        self._emergency = False
        # The fault can't be reset as long as this is so.
        self._lasts = False

    @property
    def record(self) -> DeviceRecord:
        """The state as it is told."""
        mode, message = self._mode()
        return DeviceRecord(mode, self._fault, message, self.moving)

    @property
    def refusal(self) -> str:
        """Why it takes no orders; empty = it does."""
        mode, message = self._mode()
        if mode in (Mode.READY, Mode.BUSY):
            return ""
        return f"{self._fault}: {message}" if self._fault else f"{mode.name.lower()}: {message}"

    def stop(self, reason: str) -> None:
        """Takes no orders until it is reset."""
        self._stopped = reason

    def fail(self, fault: str, reason: str, emergency: bool = False) -> None:
        """Takes no orders until the cause is gone (`cause_gone`) and it is reset."""
        self._fault, self._reason, self._emergency, self._lasts = fault, reason, emergency, True

    def cause_gone(self, fault: str) -> None:
        """The cause of a fault is gone; a reset is taken now."""
        if fault != self._fault:
            return
        self._lasts = False
        if self._emergency:
            self._emergency = False
            self._fault = ""
            self.stop("the emergency stop is released, a reset is needed")

    def reset(self) -> None:
        """Takes orders again.

        Raises:
            DeviceRefusedError: The cause of the fault lasts.
        """
        if self._fault and self._lasts:
            raise DeviceRefusedError(
                f"a reset of {self.name} was asked for, but {self._fault} lasts: {self._reason}; "
                f"a reset after the cause is gone is accepted"
            )
        self._fault = self._reason = self._stopped = ""

    def require_reset_done(self) -> None:
        """Raises `DeviceRefusedError` while it was stopped, or failed, and was not reset."""
        if self._mode()[0] in (Mode.STOPPED, Mode.FAULT, Mode.EMERGENCY_STOP):
            raise DeviceRefusedError(f"{self.name} takes no orders: {self.refusal}")

    def _mode(self) -> tuple[Mode, str]:
        if self._fault:
            mode = Mode.EMERGENCY_STOP if self._emergency else Mode.FAULT
            rest = "" if self._lasts else "; the cause is gone, a reset is needed"
            return mode, self._reason + rest
        if self._stopped:
            return Mode.STOPPED, self._stopped
        if not self.enabled:
            return Mode.DISABLED, f"{self.name} is switched off"
        return (Mode.BUSY if self.busy else Mode.READY), ""
