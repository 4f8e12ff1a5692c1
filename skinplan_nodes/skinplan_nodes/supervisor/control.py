"""What may hold or end a job: set from outside, looked at by the job's thread. Needs no ROS."""

import threading
from dataclasses import dataclass

from skinplan.errors import SkinplanError


class StepError(SkinplanError):
    """A step of a job failed.

    Attributes:
        node: Node at which it failed; empty = the supervisor itself.
        code: Status code (``skinplan_msgs/Status``).
        step: Name of the step; empty until the mission fills it in.
    """

    def __init__(self, code: int, message: str, node: str = "") -> None:
        super().__init__(message)
        self.code = code
        self.node = node
        self.step = ""


class AbortError(StepError):
    """Somebody or something ended the job from outside."""


@dataclass(frozen=True)
class _Abort:
    code: int
    message: str
    node: str


class JobControl:
    """The switches of one job: abort, stop, pause."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._abort: _Abort | None = None
        self._stop = threading.Event()
        self._go = threading.Event()
        self._go.set()

    def abort(self, code: int, message: str, node: str = "") -> None:
        """Ends the job at once; the first reason counts.

        Args:
            code: Status code.
            message: Why, one sentence.
            node: Node that caused it; may be empty.
        """
        with self._lock:
            if self._abort is None:
                self._abort = _Abort(code, message, node)
        self._go.set()

    def stop(self) -> None:
        """Ends the job after the present station, arm at home; what was measured is its result."""
        self._stop.set()
        self._go.set()

    def pause(self) -> None:
        """Holds the job before the next segment."""
        self._go.clear()

    def resume(self) -> None:
        """Lets a held job go on."""
        self._go.set()

    @property
    def aborted(self) -> bool:
        """Whether the job is to end at once."""
        return self._abort is not None

    @property
    def stopping(self) -> bool:
        """Whether the job is to end after the present station."""
        return self._stop.is_set()

    def check(self) -> None:
        """Raises the abort, if there is one.

        Raises:
            AbortError: The job is to end at once.
        """
        if self._abort is not None:
            raise AbortError(self._abort.code, self._abort.message, self._abort.node)

    def hold(self) -> None:
        """Waits while the job is paused; called between segments.

        Raises:
            AbortError: The job is to end at once.
        """
        while not self._go.wait(0.05):
            self.check()
        self.check()
