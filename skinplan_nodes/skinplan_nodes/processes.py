"""The processes of the graph, on top of the process manager honcho. Needs no ROS.

honcho starts the processes and tells when one ends. Added here: Python programs are forks of this
process, which imports what they need once; a node that dies is started again, a bounded number of
times; a staged end (a node that dies for good leaves the supervisor time to
close the job; an interrupt lets the client abort it first); and no orphans, however the runner
itself ends.
"""

import contextlib
import ctypes
import functools
import logging
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from honcho.manager import Manager
from honcho.printer import Message
from honcho.process import Popen, Process

from skinplan_nodes.forked import Forked, Program, preload
from skinplan_nodes.restarts import NO_RESTARTS, RestartCounter, RestartPolicy

_PR_SET_PDEATHSIG = 1
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class EndTimes:
    """How long the stages of the end may take, on wall time.

    Attributes:
        grace_s: From the death of a node until the client is interrupted, which aborts the job: the
            supervisor brings arm and base to rest meanwhile [s].
        client_s: From the client's interrupt until the first process is terminated [s].
        first_s: From there until all others are terminated [s].
        terminate_s: From there until what is left is killed [s].
    """

    grace_s: float = 2.0
    client_s: float = 1.3
    first_s: float = 1.1
    terminate_s: float = 1.6


class LinePrinter:
    """Hands the lines that the client writes to a callback; honcho's own lines go to the log.

    Args:
        on_line: Called with each line of a process.
    """

    width = 0

    def __init__(self, on_line: Callable[[str, str], None]) -> None:
        self._on_line = on_line

    def write(self, message: Message) -> None:
        """Takes one message of honcho."""
        data = message.data
        text = data.decode("utf-8", "replace") if isinstance(data, bytes) else data
        for line in text.splitlines():
            if message.name == "system":
                _log.debug("%s", line)
            else:
                self._on_line(message.name, line)


class _Events:
    """honcho's queue of events, with the deaths taken out that a restart follows.

    Args:
        queue: The queue that honcho's readers fill.
        taken: Told of each event; true = honcho does not get it.
        poll: Called at each look.
    """

    def __init__(
        self, queue: Any, taken: Callable[[Message], bool], poll: Callable[[], None]
    ) -> None:
        self.queue = queue
        self._taken = taken
        self._poll = poll

    def get(self, timeout: float) -> Message:
        """Returns the next event for honcho."""
        self._poll()
        message: Message = self.queue.get(timeout=timeout)
        if self._taken(message):
            # honcho looks at what it knows after every event: this one says nothing.
            return message._replace(type="restart", data={})
        return message


class GraphManager(Manager):
    """Runs the nodes, and a client, until the client ends, a node dies for good or a signal comes.

    Args:
        on_line: Called with process name and line for everything that is not redirected.
        on_death: Called with the name and return code (negative = signal) of a node that died for
            good: it ends the graph.
        client: Name of the process whose end is the regular end of the run; None = there is none.
        first: Name of the process that is terminated before the others, so that it can end its work
            with them.
        times: How long the stages of the end may take.
        restarts: How often a node that died is started again.
        on_restart: Called with name, return code and the number of restarts so far when a node died
            that is started again (code None: it has been started).
    """

    def __init__(
        self,
        on_line: Callable[[str, str], None],
        on_death: Callable[[str, int], None],
        client: str | None = None,
        first: str | None = None,
        times: EndTimes = EndTimes(),
        restarts: RestartPolicy = NO_RESTARTS,
        on_restart: Callable[[str, int | None, int], None] = lambda *_: None,
    ) -> None:
        super().__init__(LinePrinter(on_line))
        self.events = _Events(self.events, self._restart_later, self._start_again)
        self._restarts = restarts
        self._on_restart = on_restart
        self._counters: dict[str, RestartCounter] = {}
        # Name -> when it is due [s] and its last return code; guarded, the end comes in a thread.
        self._due: dict[str, tuple[float, int]] = {}
        self._due_lock = threading.Lock()
        self._ending = False
        self._process_ctor = _BoundProcess
        self._on_death = on_death
        self._client = client
        self._first = first
        self._times = times
        self._owner = os.getpid()
        self._signals = 0
        self._guard: threading.Thread | None = None

    def client_code(self) -> int | None:
        """Returns the client's return code; None while it runs or when there is no client."""
        return self._code(self._client) if self._client else None

    def terminate(self) -> None:
        """Begins the end; honcho calls it at a signal and when the first process has ended."""
        if os.getpid() != self._owner:
            return
        if self.returncode in (130, 143):
            self._signals += 1
        if self._guard is None:
            self._guard = threading.Thread(target=self._end_in_stages, name="end", daemon=True)
            self._guard.start()

    def kill(self) -> None:
        """Does nothing: honcho's own deadline does not know the stages of the end."""

    def _all_started(self) -> bool:
        # What waits for its restart is no reason to wait with the end.
        return all(p.get("pid") is not None or n in self._due for n, p in self._processes.items())

    def recent_deaths(self, name: str) -> int:
        """Returns how often a process died within the window of the restarts."""
        return self._counters[name].recent if name in self._counters else 0

    def _start(self) -> None:
        commands = [process["obj"].cmd for process in self._processes.values()]
        preload(command.module for command in commands if isinstance(command, Program))
        for name in self._processes:
            self._launch(name)

    def _launch(self, name: str) -> None:
        process = self._processes[name]
        process["process"] = multiprocessing.Process(
            name=name, target=process["obj"].run, args=(self.events.queue, True)
        )
        process["process"].start()

    def _restart_later(self, message: Message) -> bool:
        """Takes note of a death that a restart follows; false = honcho has to know of it."""
        if message.type != "stop" or message.name == self._client:
            return False
        code = int(message.data["returncode"])
        with self._due_lock:
            if self._ending:
                return False
            counter = self._counters.setdefault(message.name, RestartCounter(self._restarts))
            wait_s = counter.wait_after(code, time.monotonic())
            if wait_s is None:
                return False
            self._processes[message.name]["pid"] = None
            self._due[message.name] = (time.monotonic() + wait_s, code)
        self._on_restart(message.name, code, counter.total)
        return True

    def _start_again(self) -> None:
        """Starts the processes that are due; in the main thread, whose children end with it."""
        with self._due_lock:
            now_s = time.monotonic()
            due = [name for name, (due_s, _) in self._due.items() if due_s <= now_s]
            for name in due:
                del self._due[name]
                self._launch(name)
        for name in due:
            self._on_restart(name, None, self._counters[name].total)

    def _no_more_restarts(self) -> None:
        with self._due_lock:
            self._ending = True
            for name, (_, code) in self._due.items():
                # Nothing of it runs: for the end it has stopped.
                self._processes[name].update(pid=0, returncode=code)
            self._due.clear()

    def _end_in_stages(self) -> None:
        self._no_more_restarts()
        while not self._all_started():
            time.sleep(0.02)
        self._report_deaths()
        self._wait(self._times.grace_s, self._grace_over)
        if self._client and not self._client_ended():
            self._send(self._client, signal.SIGINT)
            self._wait(self._times.client_s, self._client_ended)
        if self._first and self._code(self._first) is None:
            self._send(self._first, signal.SIGTERM)
            self._wait(self._times.first_s, self._first_ended)
        self._killall()
        self._wait(self._times.terminate_s, self._all_stopped)
        self._killall(force=True)

    def _report_deaths(self) -> None:
        if self._signals or (self._client and self.client_code() is not None):
            return
        for name, process in self._processes.items():
            code = self._code(name)
            if name != self._client and code is not None and process["pid"]:
                self._on_death(name, code)

    def _wait(self, timeout_s: float, done: Callable[[], bool]) -> None:
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline and not done():
            time.sleep(0.02)

    def _client_ended(self) -> bool:
        return self._client is not None and self.client_code() is not None

    def _first_ended(self) -> bool:
        return self._first is not None and self._code(self._first) is not None

    def _grace_over(self) -> bool:
        return self._signals > 0 or self._client_ended()

    def _send(self, name: str, number: signal.Signals) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._processes[name]["pid"], number)

    def _code(self, name: str) -> int | None:
        code: int | None = self._processes[name].get("returncode")
        return code


def die_with_parent(sent: int, parent: int) -> None:
    """Asks the kernel to end this process when its parent ends, however that ends (Linux).

    Args:
        sent: The signal that this process gets then.
        parent: Process id of the parent: when it has ended already, this process ends at once.
    """
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, sent, 0, 0, 0)
    if os.getppid() != parent:
        os._exit(1)


class _BoundProcess(Process):
    """A process of honcho that ends with the runner: honcho's reader and the program itself."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._starter = os.getpid()

    def run(self, events: Any = None, ignore_signals: bool = False) -> None:
        """Runs in honcho's reader process."""
        die_with_parent(signal.SIGKILL, self._starter)
        # The program gets SIGTERM, so that the recorder can close its bag.
        ask = functools.partial(die_with_parent, signal.SIGTERM, os.getpid())
        if isinstance(self.cmd, Program):
            self._child_ctor = functools.partial(Forked, at_start=ask)
        else:
            self._child_ctor = functools.partial(Popen, preexec_fn=ask)
        super().run(events, ignore_signals)
