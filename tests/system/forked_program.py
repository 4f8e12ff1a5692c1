"""What a fork of the runner is: tells of itself, and ends as its name says."""

import json
import os
import signal
import sys
import time

import psutil

from system.graph_run import command_of

MODULES = "there"


def main() -> int:
    """Tells on stdout and stderr; returns 7."""
    name = sys.argv[1]
    if name == "raises":
        return 1 // 0
    if name == "sleeps":
        time.sleep(600.0)
    told = {
        "name": name,
        "pid": os.getpid(),
        "parent": os.getppid(),
        "group": os.getpgid(0),
        "session": os.getsid(0),
        "handlers": [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)],
        "open": sum(not _is_null(n) for n in os.listdir("/proc/self/fd") if int(n) > 2),
        "modules": MODULES,
        "title": command_of(psutil.Process()),
    }
    sys.stdout.write(json.dumps(told, default=str) + "\n")
    sys.stderr.write(f"{name} to stderr\n")
    # The client ends the graph: the node has its say before.
    time.sleep(2.0 if name == "client" else 600.0)
    return 7


def _is_null(number: str) -> bool:
    try:
        return os.readlink(f"/proc/self/fd/{number}") == os.devnull
    except FileNotFoundError:
        return True
