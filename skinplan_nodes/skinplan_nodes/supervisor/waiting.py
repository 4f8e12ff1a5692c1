"""Bounded waits of a job's thread for answers of other nodes."""

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rclpy.task import Future
from skinplan_msgs.msg import Status

from skinplan_nodes.supervisor.control import JobControl, StepError

_LOOK_S, _QUICK_LOOK_S = 0.02, 0.01
# The cell's clock may stand still for so long of wall time: longer means that it is gone.
_FROZEN_S = 15.0


class Waiter:
    """Waits for futures, on wall time or on the cell's time; gives way to what is asked of the job.

    Args:
        now_s: Returns the cell's time [s].
        is_lost: Whether a node was seen and is gone: it will never answer.
        pid: Returns the process of a node, 0 = it is not known: another one than was asked will
            never answer either.
    """

    def __init__(
        self,
        now_s: Callable[[], float],
        is_lost: Callable[[str], bool],
        pid: Callable[[str], int],
    ) -> None:
        self._now_s = now_s
        self._is_lost = is_lost
        self._pid = pid
        self.control = JobControl()
        self._end_s = math.inf

    def end_by(self, end_s: float) -> None:
        """Ends every wait, also what nothing breaks into: this process is to end.

        Args:
            end_s: From then on nothing is waited for, monotonic time [s].
        """
        self._end_s = end_s

    def until(self, done: Callable[[], bool], timeout_s: float) -> bool:
        """Waits on wall time until something is so; nothing breaks into it but the end.

        Args:
            done: Looks whether it is.
            timeout_s: Longest wait [s].

        Returns:
            Whether it came to be.
        """
        deadline = time.monotonic() + timeout_s
        while not (found := done()) and time.monotonic() < min(deadline, self._end_s):
            time.sleep(_QUICK_LOOK_S)
        return found

    def is_over(self) -> bool:
        """Whether nothing is waited for any more: this process ends."""
        return time.monotonic() > self._end_s

    @contextmanager
    def undisturbed(self) -> Iterator[None]:
        """What is waited for inside stops or closes something: nothing breaks into it."""
        control, self.control = self.control, JobControl()
        try:
            yield
        finally:
            self.control = control

    def wall(
        self,
        future: Future,
        timeout_s: float,
        what: str,
        node: str,
        servers: Callable[[], int] = lambda: 1,
    ) -> Any:
        """Waits on wall time.

        Args:
            future: What is waited for.
            timeout_s: Longest wait [s].
            what: What was asked, for the message.
            node: Who was asked.
            servers: Counts who serves it.

        Raises:
            InterruptError: Something breaks into it.
            StepError: NODE_LOST, DEVICE_TIMEOUT, or what the future raised.
        """
        deadline = time.monotonic() + timeout_s

        def late() -> str | None:
            return f"no answer within {timeout_s:g} s" if time.monotonic() > deadline else None

        return self._wait(future, late, what, node, _Newcomers(servers))

    def cell(self, future: Future, timeout_s: float, what: str, node: str) -> Any:
        """Waits on the cell's time, which may be faster than wall time; else as `wall`."""
        deadline = self._now_s() + timeout_s
        last = [self._now_s(), time.monotonic()]

        def late() -> str | None:
            now_s, wall_s = self._now_s(), time.monotonic()
            if now_s != last[0]:
                last[:] = [now_s, wall_s]
            elif wall_s - last[1] > _FROZEN_S:
                return f"the clock has stood still for {_FROZEN_S:g} s"
            return f"not done within {timeout_s:g} s" if now_s > deadline else None

        return self._wait(future, late, what, node)

    def _wait(
        self,
        future: Future,
        late: Callable[[], str | None],
        what: str,
        node: str,
        newcomers: "_Newcomers | None" = None,
    ) -> Any:
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())
        asked = self._pid(node)
        while not done.wait(_LOOK_S):
            self.control.check()
            if self._is_lost(node):
                raise StepError(Status.NODE_LOST, f"{what}: node {node} was lost", node)
            another = newcomers is not None and newcomers.look()
            if another or (asked and self._pid(node) not in (0, asked)):
                text = f"{what}: node {node} was started again meanwhile"
                raise StepError(Status.NODE_LOST, text, node)
            reason = "no answer when this program was ended" if self.is_over() else late()
            if reason is not None:
                raise StepError(Status.DEVICE_TIMEOUT, f"{what}: {reason}", node)
        if future.exception() is not None:
            raise StepError(Status.DEVICE_FAILED, f"{what}: {future.exception()}", node)
        return future.result()


class _Newcomers:
    """Sees a server that came after the question: it was not asked.

    A node that was started again is heard before its services are found, and those of the process
    before it, which was killed, seem to be there for 20 s: they get the question.
    """

    def __init__(self, servers: Callable[[], int]) -> None:
        self._servers = servers
        # Nothing is known before the first one is seen: what can be asked is there.
        self._known: int | None = None
        self.look()

    def look(self) -> bool:
        """Whether there are more servers than at the last look."""
        known, found = self._known, self._servers()
        if known is not None or found:
            self._known = found
        return known is not None and found > known
