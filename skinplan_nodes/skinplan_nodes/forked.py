"""Node programs as forks of one process that has imported what they need. Needs no ROS itself.

A dozen Python programs that import NumPy, SciPy, rclpy and message types one by one take most of
the time that a graph takes to start, and a copy of everything each. A fork has it all at once, and
shares the memory. Each is a process of its own nevertheless, with its own ROS context.
"""

import ctypes
import gc
import importlib
import logging
import os
import shlex
import signal
import sys
import traceback
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Never

import setproctitle

_M_ARENA_MAX = -8
_log = logging.getLogger(__name__)

# It finds the place of the title by what stands behind it: the environment, not yet changed.
setproctitle.getproctitle()


@dataclass(frozen=True)
class Program:
    """A Python module that is run as ``python -m MODULE ARGUMENTS`` would run it.

    Attributes:
        module: Its ``main()`` returns the exit code.
        arguments: Its command line.
        log_file: Gets what it writes to stderr.
        heard: Its stdout goes to who started it; else to the log file, too.
    """

    module: str
    arguments: tuple[str, ...]
    log_file: Path
    heard: bool = False


def preload(modules: Iterable[str]) -> None:
    """Imports what the programs will need; to be called before the process has threads.

    What can't be imported is left to the program itself, whose log then says so.
    """
    # Only who runs `python -m` has the present folder first in its path: it may hold a folder of a
    # package's name.
    if not sys.flags.safe_path and sys.path:
        del sys.path[0]
    arenas = os.environ.get("MALLOC_ARENA_MAX", "")
    if arenas.isdecimal():
        # glibc reads the variable when a process begins, and forks have begun already.
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, int(arenas))
    for module in modules:
        try:
            importlib.import_module(module)
        except Exception as error:
            _log.debug("%s: %s", module, error)
    # The collector would write to all pages that are shared.
    gc.collect()
    gc.freeze()


class Forked:
    """A program that runs as a fork of this process; looks like ``subprocess.Popen`` to honcho.

    Args:
        program: What is run.
        at_start: Called in the new process before anything else.
        env: Ignored, as is `cwd`: the environment of a fork is its parent's.
    """

    def __init__(
        self, program: Program, at_start: Callable[[], None], env: Any = None, cwd: Any = None
    ) -> None:
        self.returncode: int | None = None
        reading, writing = os.pipe()
        self.pid = os.fork()
        if self.pid == 0:
            _run(program, at_start, writing)
        os.close(writing)
        self.stdout: IO[bytes] = os.fdopen(reading, "rb")

    def wait(self) -> int:
        """Waits for the end; returns the exit code, or minus the signal that ended it."""
        if self.returncode is None:
            self.returncode = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        return self.returncode


def _run(program: Program, at_start: Callable[[], None], writing: int) -> Never:
    code = 1
    try:
        os.setsid()
        at_start()
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        _redirect(program, writing)
        command = [sys.executable, "-m", program.module, *program.arguments]
        setproctitle.setproctitle(shlex.join(command))
        setproctitle.setthreadtitle(program.module.rpartition(".")[2])
        sys.argv = command[2:]
        code = importlib.import_module(program.module).main() or 0
    except SystemExit as ended:
        code = _code(ended)
    except BaseException:
        traceback.print_exc()
    # Not taken apart as an interpreter is: that writes to every page that is shared, in all nodes
    # at once, and the frames below are the parent's. Libraries end as always: DDS takes its shared
    # memory away. Under the interpreter's lock no other thread begins anything meanwhile.
    logging.shutdown()
    sys.stdout.flush()
    sys.stderr.flush()
    ctypes.PyDLL(None).exit(code)
    os._exit(code)


def _redirect(program: Program, writing: int) -> None:
    """Gives the program its streams, and none of the parent's open files."""
    log = os.open(program.log_file, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 0)
    os.dup2(writing if program.heard else log, 1)
    os.dup2(log, 2)
    for number in map(int, os.listdir("/proc/self/fd")):
        # Not closed: the parent's objects would later close whatever has got the number.
        if number not in (0, 1, 2, nothing) and os.path.exists(f"/proc/self/fd/{number}"):
            os.dup2(nothing, number, inheritable=False)
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(line_buffering=True)  # type: ignore[union-attr]


def _code(ended: SystemExit) -> int:
    if ended.code is None or isinstance(ended.code, int):
        return ended.code or 0
    sys.stderr.write(f"{ended.code}\n")
    return 1
