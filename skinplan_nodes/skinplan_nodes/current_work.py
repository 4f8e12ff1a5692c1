"""The long work that a node does at the moment, and how somebody else cancels it."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from skinplan.errors import CancelledError, SkinplanError

Progress = Callable[[float, str], None]


class Work:
    """One piece of work; its methods are what the library's long functions are given.

    Args:
        what: What is being done, e.g. ``planning station 3``.
        ended: Whether the node has to end.
        note: Takes the progress.
    """

    def __init__(self, what: str, ended: Callable[[], bool], note: Progress) -> None:
        self.what = what
        self._ended = ended
        self._note = note
        self._asked = threading.Event()

    def cancel(self) -> None:
        """Asks the work to end."""
        self._asked.set()

    def is_cancelled(self) -> bool:
        """Tells whether the work has to end: somebody cancelled it, or the node ends."""
        return self._asked.is_set() or self._ended()

    def progress(self, share: float, text: str) -> None:
        """Takes the progress. The library asks only in its searches; here is one more place to end.

        Raises:
            CancelledError: The work has to end.
        """
        self.check()
        self._note(share, text)

    def check(self) -> None:
        """Ends the work where it has to end.

        Raises:
            CancelledError: It has to.
        """
        if self.is_cancelled():
            raise CancelledError(f"{self.what} was cancelled")


class CurrentWork:
    """What a node works on; at most one piece at a time.

    Args:
        ended: Whether the node has to end.
        note: Takes the progress.
    """

    def __init__(self, ended: Callable[[], bool], note: Progress) -> None:
        self._ended = ended
        self._note = note
        self._lock = threading.Lock()
        self._work: Work | None = None

    @contextmanager
    def doing(self, what: str) -> Iterator[Work]:
        """Works on something that can be cancelled inside.

        Raises:
            CancelledError: It was cancelled, however far it had come and whatever came out: who was
                told that the work is cancelled gets neither its result nor its error.
        """
        work = Work(what, self._ended, self._note)
        with self._lock:
            self._work = work
        try:
            yield work
        except SkinplanError as error:
            self._clear()
            if work.is_cancelled():
                raise CancelledError(f"{what} was cancelled") from error
            raise
        finally:
            self._clear()
        work.check()

    def cancel(self) -> str:
        """Cancels the work; returns what it is, or nothing when there is none."""
        with self._lock:
            if self._work is None:
                return ""
            self._work.cancel()
            return self._work.what

    def _clear(self) -> None:
        with self._lock:
            self._work = None
