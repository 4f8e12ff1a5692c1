"""Runs the whole graph as a user does: `python -m skinplan_nodes.runner`, one process per node."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil

# The wait for what should take seconds; the machine may be busy.
TIMEOUT_S = 150.0


class GraphRun:
    """The runner with all its processes and events.

    Args:
        folder: Folder of the runs; the part file lies beside.
        part_file: What stands in the mock cell, and is measured.
        arguments: Further arguments of the runner.
    """

    def __init__(self, folder: Path, part_file: Path, *arguments: str) -> None:
        command = [sys.executable, "-P", "-m", "skinplan_nodes.runner", "--part", str(part_file)]
        command += ["--runs-folder", str(folder), "--json-lines", *arguments]
        self.errors = folder / "runner.err"
        folder.mkdir(parents=True, exist_ok=True)
        with self.errors.open("w") as stream:
            self.process = subprocess.Popen(
                command,
                stdout=subprocess.PIPE,
                stderr=stream,
                text=True,
                env={**os.environ, "PYTHONUNBUFFERED": "1"},
                start_new_session=True,
            )
        self.events: list[dict[str, Any]] = []
        self._known: dict[int, psutil.Process] = {}
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def until(self, condition: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Waits for an event and returns it."""
        deadline = time.monotonic() + TIMEOUT_S
        seen = 0
        while True:
            while seen < len(self.events):
                if condition(self.events[seen]):
                    return self.events[seen]
                seen += 1
            said = self.errors.read_text()
            assert self.process.poll() is None, f"the runner ended: {self.events[-3:]} {said}"
            assert time.monotonic() < deadline, f"no such event: {self.events[-3:]} {said}"
            time.sleep(0.02)

    def until_sub_state(self, name: str) -> dict[str, Any]:
        """Waits until the job is in a sub-state."""
        return self.until(lambda event: event.get("sub_state") == name)

    def processes(self) -> list[psutil.Process]:
        """Returns all processes that the run has started so far and that are still there."""
        if self.process.poll() is None:
            root = psutil.Process(self.process.pid)
            for found in [root, *root.children(recursive=True)]:
                self._known[found.pid] = found
        return [p for p in self._known.values() if _is_running(p)]

    def node(self, name: str) -> psutil.Process:
        """Returns the process of a node."""
        module = f"skinplan_nodes.{name}"
        return next(p for p in self.processes() if module in command_of(p)[:6])

    def wait(self, timeout_s: float = TIMEOUT_S) -> int:
        """Waits for the end of the runner and returns its exit code."""
        code = self.process.wait(timeout_s)
        self._reader.join(timeout_s)
        return code

    def end(self) -> None:
        """Ends a served graph in order: what is killed may leave DDS's shared memory locked."""
        self.process.send_signal(signal.SIGINT)
        self.wait()
        self.wait_gone()

    def wait_gone(self, timeout_s: float = 10.0) -> None:
        """Waits until none of the run's processes is left."""
        deadline = time.monotonic() + timeout_s
        while left := self.processes():
            assert time.monotonic() < deadline, f"left over: {[p.cmdline() for p in left]}"
            time.sleep(0.05)

    def close(self) -> None:
        """Ends what is left, whatever happened."""
        for found in self.processes():
            with_group = found.pid if found.pid == self.process.pid else None
            if with_group is None:
                found.kill()
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGKILL)
        self.process.wait(TIMEOUT_S)
        self._reader.join(TIMEOUT_S)

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.events.append(json.loads(line))


def command_of(process: psutil.Process) -> list[str]:
    """Returns the words of a process's command; none = it has gone.

    A fork tells its command as one word, where that of a program is a list.
    """
    try:
        return " ".join(process.cmdline()).split()
    except psutil.NoSuchProcess:
        return []


def _is_running(process: psutil.Process) -> bool:
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
