"""Runs one node as a program, and ends it cleanly."""

import contextlib
import ctypes
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import (
    Executor,
    ExternalShutdownException,
    MultiThreadedExecutor,
)
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from skinplan.errors import SkinplanError
from skinplan_nodes.dds_profiles import use_profiles
from skinplan_nodes.lean_executor import LeanExecutor
from skinplan_nodes.node import end_heartbeats

_PR_SET_PDEATHSIG = 1
# Callbacks that are still running get so long to end.
_JOIN_TIMEOUT_S = 1.5


def run_node(kind: Callable[[], Any], arguments: Sequence[str] | None = None) -> int:
    """Runs a node until SIGINT, SIGTERM, the end of the context, or its own end.

    Args:
        kind: Class of the node. Its ``make_executor()``, where it has one, makes the executor.
        arguments: Command line with ``--ros-args``; None = the program's own.

    Returns:
        Exit code: 0 when it was asked to end (or the node's own), 1 when it failed, 2 when its
        parameters can't be used.
    """
    die_with_parent()
    name = str(getattr(kind, "NAME", "node"))
    log_format = "[%(levelname)s] [%(name)s]: %(message)s"
    logging.basicConfig(level=logging.INFO, stream=sys.stderr, format=log_format)
    early = threading.Event()
    _on_signals(early)
    use_profiles(bool(getattr(kind, "LARGE_MESSAGES", False)))
    # Signals end the node in order; they do not pull the context away from under it.
    rclpy.init(
        args=None if arguments is None else list(arguments),
        signal_handler_options=SignalHandlerOptions.NO,
    )
    try:
        node = kind()
    except (SkinplanError, ParameterException) as error:
        logging.getLogger(name).error("the node can't start: %s", error)
        _give_up()
        return 2
    except Exception:
        logging.getLogger(name).exception("the node can't start")
        _give_up()
        return 1
    _on_signals(node.asked_to_end)
    if early.is_set():
        node.asked_to_end.set()
    return _spin(node, node.asked_to_end)


def _give_up() -> None:
    """Ends what a constructor began before it failed: a thread that sends on would crash."""
    end_heartbeats()
    rclpy.try_shutdown()


def die_with_parent() -> None:
    """Has this process ended by the kernel when its parent dies, whatever kills that (Linux)."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)


def _on_signals(asked_to_end: threading.Event) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: asked_to_end.set())


def _spin(node: Any, asked_to_end: threading.Event) -> int:
    failures: list[BaseException] = []
    executor = _executor(node)
    executor.add_node(node)
    thread = threading.Thread(
        target=_spin_until_shut, args=(executor, failures, asked_to_end), name="spin", daemon=True
    )
    thread.start()
    # A wait with a limit lets the main thread run the signal handlers.
    while not asked_to_end.wait(0.2):
        pass
    _end(node, thread)
    code = 1 if failures else int(node.exit_code)
    if thread.is_alive():
        logging.getLogger(node.NAME).warning("a callback was still running at the end")
        sys.stderr.flush()
        # The executor's pool would be waited for, however long its callback takes.
        os._exit(code)
    return code


def _end(node: Any, thread: threading.Thread) -> None:
    """Shut, join, destroy: the executor may still run callbacks after its own shutdown."""
    try:
        node.close()
        end_heartbeats()
        rclpy.try_shutdown()
        thread.join(_JOIN_TIMEOUT_S)
        if not thread.is_alive():
            node.destroy_node()
    except Exception:
        logging.getLogger(node.NAME).exception("the node did not end cleanly")


def _spin_until_shut(
    executor: Executor, failures: list[BaseException], asked_to_end: threading.Event
) -> None:
    try:
        executor.spin()
    except ExternalShutdownException:
        pass  # the context was shut: that is how a node is asked to end
    except BaseException as error:
        # The context may go while a callback publishes or the executor waits: no failure.
        if not asked_to_end.is_set():
            logging.getLogger(__name__).exception("the node failed")
            failures.append(error)
    finally:
        asked_to_end.set()


def _executor(node: Node) -> Executor:
    make: Callable[[], Executor] | None = getattr(node, "make_executor", None)
    if make is not None:
        return make()
    threads = int(getattr(node, "THREADS", 1))
    if threads > 1:
        return MultiThreadedExecutor(threads, context=node.context)
    return LeanExecutor(context=node.context)
