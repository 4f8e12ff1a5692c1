"""The real nodes in a graph of their own, with a clock to set and bounded waits."""

import os
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

import rclpy
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock

from skinplan.errors import SkinplanError
from skinplan_nodes.conversions import stamp_to_msg
from skinplan_nodes.qos import STATE

_JOIN_S = 10.0
_POLL_S = 0.005
_DISCOVERY_S = 60.0


class NotAnsweredError(SkinplanError):
    """A node did not answer in time."""


class VerifyBench:
    """Runs nodes in a namespace and with a clock that no other graph on this machine has.

    Attributes:
        node: Node of the verification itself.
        group: Callback group for what must go on while something else waits.
    """

    def __init__(self) -> None:
        self.context = Context()
        rclpy.init(args=[], context=self.context)
        self._namespace = f"/verify_{os.getpid()}"
        self._executor = MultiThreadedExecutor(4, context=self.context)
        self._nodes: list[Node] = []
        self._last: list[Callable[[], object]] = []
        self._failure: BaseException | None = None
        self.node = Node(
            "verify",
            context=self.context,
            namespace=self._namespace,
            use_global_arguments=False,
        )
        self.group = ReentrantCallbackGroup()
        self._clock = self.node.create_publisher(Clock, f"{self._namespace}/clock", STATE)
        self._add(self.node)
        self._thread = threading.Thread(target=self._spin, name="verify", daemon=True)
        self._thread.start()

    def start(self, kind: Callable[..., Any], parameters: Mapping[str, Any], sim: bool) -> Any:
        """Starts a node.

        Args:
            kind: Its class.
            parameters: Values that differ from the node's defaults.
            sim: It lives on the clock that `set_clock` sets.

        Raises:
            SkinplanError: The node can't start.
        """
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        if sim:
            overrides.append(Parameter("use_sim_time", value=True))
        node = kind(
            context=self.context,
            namespace=self._namespace,
            cli_args=["--ros-args", "-r", f"/clock:={self._namespace}/clock"],
            parameter_overrides=overrides,
            use_global_arguments=False,
        )
        self._add(node)
        return node

    def set_clock(self, now_s: float) -> None:
        """Sets the time."""
        self._clock.publish(Clock(clock=stamp_to_msg(now_s)))

    def wait(self, condition: Callable[[], Any], timeout_s: float, what: str) -> Any:
        """Waits until a condition is true, and returns its value.

        Raises:
            NotAnsweredError: Not within the time, or nothing runs the nodes any more.
        """
        deadline = time.monotonic() + timeout_s
        while not (value := condition()):
            if self._failure is not None:
                raise NotAnsweredError(
                    f"{what} was waited for, but the nodes have failed ({self._failure})"
                ) from self._failure
            if time.monotonic() > deadline:
                raise NotAnsweredError(f"{what} was waited for {timeout_s:g} s, but did not come")
            time.sleep(_POLL_S)
        return value

    def call(self, kind: Any, name: str, request: Any, timeout_s: float) -> Any:
        """Calls a service.

        Raises:
            NotAnsweredError: There is no answer within the time.
        """
        client = self.node.create_client(kind, name, callback_group=self.group)
        try:
            self.wait(client.service_is_ready, _DISCOVERY_S, f"the service {name}")
            future = client.call_async(request)
            self.wait(future.done, timeout_s, f"the answer of {name}")
            return future.result()
        finally:
            self.node.destroy_client(client)

    def at_end(self, destroy: Callable[[], object]) -> None:
        """Keeps what destroys an action's client or server until nothing waits for it any more.

        rclpy's executor fails when one goes between being gathered and being waited for.
        """
        self._last.append(destroy)

    def close(self) -> None:
        """Ends all nodes."""
        for node in reversed(self._nodes):
            if hasattr(node, "close"):
                node.close()
        rclpy.try_shutdown(context=self.context)
        self._thread.join(_JOIN_S)
        for destroy in reversed(self._last):
            destroy()
        for node in reversed(self._nodes):
            node.destroy_node()

    def _add(self, node: Node) -> None:
        self._nodes.append(node)
        self._executor.add_node(node)

    def _spin(self) -> None:
        try:
            while self.context.ok():
                self._executor.spin_once(timeout_sec=0.2)
        except ExternalShutdownException:
            pass  # the context went between two steps of the executor: that is the end
        except BaseException as error:
            self._failure = error
