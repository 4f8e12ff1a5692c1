"""Runs the tools of the set-up, one setup at a time, and leaves none of them behind."""

from __future__ import annotations

import contextlib
import fcntl
import os
import signal
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

#: Environment variable that marks every process started by a set-up; its value is the work tree.
MARK = "SKINPLAN_SETUP_OF"

#: Lines of a failed tool's output that are shown.
TAIL_LINES = 30


class SetupError(Exception):
    """The set-up cannot go on; the message says what was found and what would help."""


@contextlib.contextmanager
def exclusive(lock_file: Path) -> Iterator[None]:
    """Hold the lock of the work tree, waiting for another set-up of the same tree to end.

    The kernel frees the lock when its holder dies, however it dies.

    Args:
        lock_file: File to lock; made if missing, never removed.
    """
    with lock_file.open("w") as handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print("setup: another set-up of this work tree is running; waiting for it", flush=True)
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield


def stop_orphans(root: Path) -> int:
    """Kill what an earlier, killed set-up of this work tree left running.

    Call it with the lock held only: then every process that carries the mark is an orphan, which
    would go on writing into the environment that is about to be repaired.

    Args:
        root: The work tree.

    Returns:
        Number of processes killed.
    """
    mark = f"{MARK}={root}".encode()
    stopped = 0
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if int(folder.name) != os.getpid() and mark in (folder / "environ").read_bytes().split(
                b"\0"
            ):
                os.kill(int(folder.name), signal.SIGKILL)
                stopped += 1
    return stopped


def run_tool(
    command: Sequence[str | Path], *, cwd: Path, env: Mapping[str, str], log: Path, what: str
) -> str:
    """Run one tool to its end, its output in the log.

    Args:
        command: Program and arguments.
        cwd: Folder to run in.
        env: Whole environment of the tool, with the mark (see ``MARK``).
        log: File that the output is appended to.
        what: What the tool is doing, for the error message.

    Returns:
        Standard output of the tool.

    Raises:
        SetupError: The tool cannot be started or ended with an error.
    """
    words = [str(word) for word in command]
    try:
        process = subprocess.Popen(
            words,
            cwd=cwd,
            env=dict(env),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            # A group of its own, so that an interrupt ends the compilers that it started, too.
            start_new_session=True,
        )
    except OSError as error:
        raise SetupError(f"{what}: cannot start {words[0]}: {error}") from error
    try:
        output, _ = process.communicate()
    except BaseException:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        raise
    with log.open("a", encoding="utf-8") as handle:
        handle.write(f"$ {' '.join(words)}\n{output}\n")
    if process.returncode != 0:
        tail = "\n".join(output.splitlines()[-TAIL_LINES:])
        raise SetupError(
            f"{what} failed (exit code {process.returncode}); the whole output is in {log}:\n{tail}"
        )
    return output
