"""What may hold or end a job: set from outside, looked at by the job's thread. Needs no ROS."""

import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from skinplan.errors import SkinplanError
from skinplan_nodes.supervisor.machine import Event


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


@dataclass(frozen=True)
class Request:
    """Something that the job is to answer to.

    Attributes:
        event: What.
        code: Status code; 0 = a command without one.
        message: Why, one sentence; may be empty.
        node: Node that caused it; may be empty.
        since_s: From then on what the node did can't be relied on, monotonic time [s]; infinite =
            from now on.
    """

    event: Event
    code: int = 0
    message: str = ""
    node: str = ""
    since_s: float = float("inf")


class InterruptError(StepError):
    """Somebody or something breaks into what the job is doing.

    Attributes:
        request: What is asked for.
    """

    def __init__(self, request: Request) -> None:
        super().__init__(request.code, request.message or request.event.value, request.node)
        self.request = request


class AbortError(InterruptError):
    """Somebody or something ended the job from outside."""


#: What breaks into a wait, the most urgent one first.
BREAKING = (Event.ABORT, Event.STOP, Event.FAULT, Event.NODE_LOST, Event.PAUSE, Event.TIMED_OUT)


class JobControl:
    """What is asked of one job from outside. To be called from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._asked: dict[Event, Request] = {}
        self._news = threading.Event()
        self._late: Callable[[], Request | None] = _never
        self._ignored: frozenset[Event] = frozenset()

    def ask(self, request: Request) -> None:
        """Asks something of the job; of the same kind the first one counts."""
        with self._lock:
            if request.event is Event.RESUME:
                self._asked.pop(Event.PAUSE, None)
            elif request.event is Event.PAUSE:
                self._asked.pop(Event.RESUME, None)
            self._asked.setdefault(request.event, request)
        self._news.set()

    def abort(self, code: int, message: str, node: str = "") -> None:
        """Ends the job at once.

        Args:
            code: Status code.
            message: Why, one sentence.
            node: Node that caused it; may be empty.
        """
        self.ask(Request(Event.ABORT, code, message, node))

    @property
    def aborted(self) -> bool:
        """Whether the job is to end at once."""
        return Event.ABORT in self._asked

    def enter(self, late: Callable[[], Request | None], ignored: frozenset[Event]) -> None:
        """Tells that another state of the job begins.

        Args:
            late: Tells when it lasts too long.
            ignored: What does not break into it.
        """
        self._late, self._ignored = late, ignored

    def take(self, events: Iterable[Event] = tuple(Event)) -> Request | None:
        """Returns the most urgent of what is asked for, and forgets it; None = nothing.

        Args:
            events: Only these.
        """
        wanted = set(events)
        with self._lock:
            for event in (*BREAKING, Event.RESUME):
                if event in wanted and event in self._asked:
                    return self._asked.pop(event)
            self._news.clear()
        return self._late() if Event.TIMED_OUT in wanted else None

    def wait(self, timeout_s: float) -> None:
        """Waits until something is asked, or the time is over."""
        self._news.wait(timeout_s)

    def check(self) -> None:
        """Breaks into what the job is doing, when something is asked that does so.

        Raises:
            AbortError: The job is to end at once.
            InterruptError: It is to stop, or lasts too long.
        """
        with self._lock:
            breaking = [e for e in BREAKING if e in self._asked and e not in self._ignored]
            found = self._asked[breaking[0]] if breaking else None
        found = found or self._late()
        if found is not None:
            raise AbortError(found) if found.event is Event.ABORT else InterruptError(found)


def _never() -> Request | None:
    return None
