"""Long work beside a single-threaded executor."""

import contextlib
import ctypes
import threading
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.task import Future


def in_thread(node: Node, work: Callable[[], Any]) -> Future:
    """Runs work in a thread of its own, to be awaited in a handler of the node.

    An executor with several threads would do, too, but there every message costs several times as
    much as in one with a single thread.

    Args:
        node: The node whose handler waits.
        work: What is to be done.

    Returns:
        Future of what the work returns or raises.
    """
    executor = node.executor
    done = Future(executor=executor)

    def run() -> None:
        try:
            done.set_result(work())
        except Exception as error:
            done.set_exception(error)
        give_memory_back()
        # An executor that waits for messages does not look at futures.
        if executor is not None:
            executor.wake()

    threading.Thread(target=run, name="work", daemon=True).start()
    return done


def give_memory_back() -> None:
    """Gives memory that long work has used and freed back to the system (glibc).

    The C library keeps it for the next time; 13 processes would keep it at the same time, although
    one after the other needs it.
    """
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
