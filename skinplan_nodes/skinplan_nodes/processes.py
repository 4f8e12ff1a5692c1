"""The processes of the graph, on top of the process manager honcho. Needs no ROS.

honcho starts the processes and tells when one ends. Added here: a staged end (a node that dies
leaves the supervisor time to close the job; an interrupt lets the client abort it first), and no
orphans, however the runner itself ends.
"""

import contextlib
import ctypes
import functools
import logging
import os
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from honcho.manager import Manager
from honcho.printer import Message
from honcho.process import Popen, Process

_PR_SET_PDEATHSIG = 1
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class EndTimes:
    """How long the stages of the end may take, on wall time.

    Attributes:
        grace_s: From the death of a node until the client is interrupted: the supervisor ends the
            job in it [s].
        client_s: From the client's interrupt until all others are terminated [s].
        terminate_s: From there until what is left is killed [s].
    """

    grace_s: float = 12.0
    client_s: float = 2.5
    terminate_s: float = 1.8


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


class GraphManager(Manager):
    """Runs the nodes, and a client, until the client ends, a node dies or a signal comes.

    Args:
        on_line: Called with process name and line for everything that is not redirected.
        on_death: Called with the name and return code (negative = signal) of a node that died.
        client: Name of the process whose end is the regular end of the run; None = there is none.
        first: Name of the process that is terminated before the others, so that it can end its work
            with them.
        times: How long the stages of the end may take.
    """

    def __init__(
        self,
        on_line: Callable[[str, str], None],
        on_death: Callable[[str, int], None],
        client: str | None = None,
        first: str | None = None,
        times: EndTimes = EndTimes(),
    ) -> None:
        super().__init__(LinePrinter(on_line))
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

    def _end_in_stages(self) -> None:
        while not self._all_started():
            time.sleep(0.02)
        self._report_deaths()
        self._wait(self._times.grace_s, self._grace_over)
        if self._client and not self._client_ended():
            self._send(self._client, signal.SIGINT)
            self._wait(self._times.client_s, self._client_ended)
        if self._first and self._code(self._first) is None:
            self._send(self._first, signal.SIGTERM)
            self._wait(self._times.client_s, self._first_ended)
        self._killall()
        self._wait(self._times.terminate_s, self._all_stopped)
        self._killall(force=True)

    def _report_deaths(self) -> None:
        if self._signals or (self._client and self.client_code() is not None):
            return
        for name in self._processes:
            code = self._code(name)
            if name != self._client and code is not None:
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


def die_with_parent(sent: int = signal.SIGKILL) -> None:
    """Asks the kernel to end this process when its parent ends, however that ends (Linux).

    Args:
        sent: The signal that this process gets then.
    """
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, sent, 0, 0, 0)


class _BoundProcess(Process):
    """A process of honcho that ends with the runner: honcho's reader and the program itself."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        # The program gets SIGTERM, so that the recorder can close its bag.
        ask = functools.partial(die_with_parent, signal.SIGTERM)
        self._child_ctor = functools.partial(Popen, preexec_fn=ask)
        self._starter = os.getpid()

    def run(self, events: Any = None, ignore_signals: bool = False) -> None:
        """Runs in honcho's reader process."""
        die_with_parent()
        if os.getppid() != self._starter:
            return
        super().run(events, ignore_signals)


def domain_of_graph(environment: dict[str, str], locks: Path = Path("/proc/net/udp")) -> int:
    """Returns the DDS domain of a new graph: the one asked for, else 0 if unused, else a free one.

    Args:
        environment: Environment variables; ``ROS_DOMAIN_ID`` decides when it is set.
        locks: The kernel's table of UDP sockets.
    """
    asked = environment.get("ROS_DOMAIN_ID", "").strip()
    if asked:
        return int(asked)
    used = _udp_ports(locks)
    first = os.getpid() % 100
    for domain in (0, *(1 + (first + i) % 100 for i in range(100))):
        # DDS: each domain has 250 ports from 7400 on.
        if not any(7400 + 250 * domain <= port < 7650 + 250 * domain for port in used):
            return domain
    return 0


def _udp_ports(table: Path) -> set[int]:
    try:
        lines = table.read_text(encoding="ascii").splitlines()[1:]
    except OSError:
        return set()
    return {int(line.split()[1].rsplit(":", 1)[1], 16) for line in lines if line.strip()}
