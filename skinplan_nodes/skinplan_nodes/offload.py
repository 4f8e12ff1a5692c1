"""Long work beside a single-threaded executor."""

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
        # An executor that waits for messages does not look at futures.
        if executor is not None:
            executor.wake()

    threading.Thread(target=run, name="work", daemon=True).start()
    return done
