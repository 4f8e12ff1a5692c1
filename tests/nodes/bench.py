"""A private ROS context with the nodes under test, a clock to turn, and bounded waits."""

import gc
import threading
import time
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import (
    ExternalShutdownException,
    MultiThreadedExecutor,
)
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock

from skinplan_nodes.conversions import stamp_to_msg
from skinplan_nodes.lean_executor import LeanExecutor

TIMEOUT_S = 20.0


class Bench:
    """Runs nodes in one process; `tester` is the node that the test itself uses."""

    def __init__(self, threads: int = 1) -> None:
        self.context = Context()
        rclpy.init(args=[], context=self.context)
        if threads > 1:
            self._executor: Any = MultiThreadedExecutor(threads, context=self.context)
        else:
            self._executor = LeanExecutor(context=self.context)
        self._nodes: list[Node] = []
        self.tester = Node("tester", context=self.context, use_global_arguments=False)
        self._clock = self.tester.create_publisher(Clock, "/clock", 10)
        self.now_s = 1.0
        self.failures: list[BaseException] = []
        self._add(self.tester)
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()

    def start(self, kind: Callable[..., Any], simulated: bool = True, **parameters: Any) -> Any:
        """Starts a node with parameters."""
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        if simulated:
            overrides.append(Parameter("use_sim_time", value=True))
        node = kind(context=self.context, parameter_overrides=overrides, use_global_arguments=False)
        self._add(node)
        return node

    def turn_clock(self, until_s: float | None = None, step_s: float = 0.1) -> None:
        """Turns the clock by one step, or in steps until a time."""
        last_s = self.now_s + step_s if until_s is None else until_s
        while self.now_s < last_s - 1e-9:
            self.now_s += step_s
            self._clock.publish(Clock(clock=stamp_to_msg(self.now_s)))
            time.sleep(0.002)

    def wait(self, condition: Callable[[], Any], turning: bool = False, step_s: float = 0.1) -> Any:
        """Waits until a condition is true, the clock standing or turning; returns its value."""
        deadline = time.monotonic() + TIMEOUT_S
        while not (value := condition()):
            assert time.monotonic() < deadline, "the condition did not come true in time"
            assert not self.failures, self.failures
            if turning:
                self.turn_clock(step_s=step_s)
            time.sleep(0.005)
        return value

    def call(self, kind: Any, name: str, request: Any, turning: bool = False) -> Any:
        """Calls a service and waits for its answer."""
        client = self.tester.create_client(kind, name)
        self._executor.wake()
        self.wait(client.service_is_ready)
        answer = self.result(client.call_async(request), turning)
        self.tester.destroy_client(client)
        return answer

    def result(self, future: Any, turning: bool = False) -> Any:
        """Waits for a future's result."""
        self.wait(future.done, turning)
        return future.result()

    def collect(self, kind: Any, topic: str, qos: Any) -> list[Any]:
        """Returns a list that gets every message of a topic that is published already."""
        messages = self.collect_before(kind, topic, qos)
        self.wait(lambda: self.tester.count_publishers(topic) > 0)
        return messages

    def collect_before(self, kind: Any, topic: str, qos: Any) -> list[Any]:
        """Returns a list that gets every message of a topic, published already or later."""
        messages: list[Any] = []
        self.tester.create_subscription(kind, topic, messages.append, qos)
        self._executor.wake()
        return messages

    def close(self) -> None:
        """Shuts the context, joins the thread, destroys the nodes."""
        for node in self._nodes:
            if hasattr(node, "close"):
                node.close()
        rclpy.shutdown(context=self.context)
        self._thread.join(TIMEOUT_S)
        for node in self._nodes:
            node.destroy_node()
        self._executor.shutdown()
        self._nodes.clear()
        # Action servers hold on to their node, and it to them: until they are collected the next
        # test sees them in the graph, takes them for its own, and gets no answer.
        gc.collect()

    def _add(self, node: Node) -> None:
        self._nodes.append(node)
        self._executor.add_node(node)

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            pass
        except BaseException as error:
            # Shut between two steps of the executor: the end that was asked for.
            if self.context.ok():
                self.failures.append(error)
