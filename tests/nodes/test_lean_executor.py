"""The executor that the nodes run in: what comes and goes, what waits, what fails, how it ends."""

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionClient, ActionServer
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.task import Future
from std_msgs.msg import Int32
from std_srvs.srv import Trigger

from skinplan_nodes.lean_executor import LeanExecutor

TIMEOUT_S = 20.0


class Spun:
    """A node in the executor, in a thread of its own."""

    def __init__(self) -> None:
        self.context = Context()
        rclpy.init(args=[], context=self.context)
        self.node = Node("spun", context=self.context, use_global_arguments=False)
        self.executor = LeanExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.ended_by: BaseException | None = None
        self.thread = threading.Thread(target=self._spin)
        self.thread.start()

    def wait(self, condition: Callable[[], Any]) -> None:
        """Waits until something is true."""
        deadline = time.monotonic() + TIMEOUT_S
        while not condition():
            assert time.monotonic() < deadline, "the condition did not come true in time"
            time.sleep(0.002)

    def end(self) -> None:
        """Shuts the context and waits for the thread."""
        rclpy.try_shutdown(context=self.context)
        self.thread.join(TIMEOUT_S)
        assert not self.thread.is_alive()
        self.node.destroy_node()
        self.executor.shutdown()

    def _spin(self) -> None:
        try:
            self.executor.spin()
        except BaseException as error:
            self.ended_by = error


@pytest.fixture
def spun() -> Iterator[Spun]:
    one = Spun()
    yield one
    one.end()


def test_each_message_comes_once_and_in_order(spun: Spun) -> None:
    got: list[int] = []
    spun.node.create_subscription(Int32, "numbers", lambda message: got.append(message.data), 1000)
    publisher = spun.node.create_publisher(Int32, "numbers", 1000)
    spun.wait(lambda: publisher.get_subscription_count() == 1)
    for number in range(500):
        publisher.publish(Int32(data=number))
    spun.wait(lambda: len(got) >= 500)
    assert got == list(range(500))


def test_what_other_threads_create_and_destroy_is_heard_and_no_longer_heard(spun: Spun) -> None:
    publisher = spun.node.create_publisher(Int32, "numbers", 10)
    for round_ in range(20):
        got: list[int] = []
        subscription = spun.node.create_subscription(
            Int32, "numbers", lambda message, got=got: got.append(message.data), 10
        )
        spun.wait(lambda: publisher.get_subscription_count() == 1)
        publisher.publish(Int32(data=round_))
        spun.wait(lambda got=got: got)
        spun.node.destroy_subscription(subscription)
        spun.wait(lambda: publisher.get_subscription_count() == 0)
        assert got == [round_]
    assert spun.ended_by is None


def test_a_callback_may_destroy_what_is_ready_beside_it(spun: Spun) -> None:
    """Two timers that are due at once: the first one destroys the second, and makes a third."""
    made: list[str] = []
    group = MutuallyExclusiveCallbackGroup()

    def first() -> None:
        time.sleep(0.05)
        spun.node.destroy_timer(timers[1])
        spun.node.destroy_timer(timers[0])
        spun.node.create_timer(0.01, lambda: made.append("third"))
        made.append("first")

    timers = [
        spun.node.create_timer(0.02, first, group),
        spun.node.create_timer(0.021, lambda: made.append("second"), group, autostart=False),
    ]
    timers[1].reset()
    spun.wait(lambda: made.count("third") > 2)
    assert made.count("first") == 1
    after = made[made.index("first") :]
    assert "second" not in after
    assert spun.ended_by is None


def test_a_callback_may_destroy_a_subscription(spun: Spun) -> None:
    """Its events are no longer waited for, either."""
    ticks: list[int] = []
    subscriptions = [
        spun.node.create_subscription(Int32, "numbers", lambda _: None, 10) for _ in range(20)
    ]
    assert all(subscription.event_handlers for subscription in subscriptions)

    def tick() -> None:
        ticks.append(1)
        if len(ticks) > 3 and subscriptions:
            spun.node.destroy_subscription(subscriptions.pop())

    spun.node.create_timer(0.002, tick)
    spun.wait(lambda: not subscriptions or spun.ended_by)
    count = len(ticks)
    spun.wait(lambda: len(ticks) > count + 3 or spun.ended_by)
    assert spun.ended_by is None


def test_a_coroutine_that_waits_does_not_keep_the_others(spun: Spun) -> None:
    got: list[Any] = []
    future: Future[Any] = Future()

    async def waits(message: Int32) -> None:
        got.append(("begin", message.data))
        got.append(await future)

    spun.node.create_subscription(
        Int32, "slow", waits, 10, callback_group=MutuallyExclusiveCallbackGroup()
    )
    spun.node.create_subscription(Int32, "fast", lambda message: got.append(message.data), 10)
    slow = spun.node.create_publisher(Int32, "slow", 10)
    fast = spun.node.create_publisher(Int32, "fast", 10)
    spun.wait(lambda: slow.get_subscription_count() and fast.get_subscription_count())
    slow.publish(Int32(data=1))
    spun.wait(lambda: got == [("begin", 1)])
    for number in range(5):
        fast.publish(Int32(data=number))
    spun.wait(lambda: len(got) == 6)
    slow.publish(Int32(data=2))
    time.sleep(0.1)
    assert len(got) == 6, "its group is busy"
    future.set_result("woken")
    fast.publish(Int32(data=9))
    spun.wait(lambda: "woken" in got and 9 in got)
    spun.wait(lambda: got.count("woken") == 2)
    assert ("begin", 2) in got
    assert spun.ended_by is None


def test_services_and_actions_answer_nodes_of_the_same_executor(spun: Spun) -> None:
    def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = True
        return response

    def follow(handle: ServerGoalHandle) -> FollowJointTrajectory.Result:
        handle.succeed()
        return FollowJointTrajectory.Result(error_string="followed")

    spun.node.create_service(Trigger, "asked", answer)
    server = ActionServer(spun.node, FollowJointTrajectory, "follow", follow)
    client = spun.node.create_client(Trigger, "asked")
    mover = ActionClient(spun.node, FollowJointTrajectory, "follow")
    spun.wait(lambda: client.service_is_ready() and mover.server_is_ready())
    for _ in range(10):
        future = client.call_async(Trigger.Request())
        spun.wait(future.done)
        assert future.result().success
        sent = mover.send_goal_async(FollowJointTrajectory.Goal())
        spun.wait(sent.done)
        found = sent.result().get_result_async()
        spun.wait(found.done)
        assert found.result().result.error_string == "followed"
    mover.destroy()
    server.destroy()
    assert spun.ended_by is None


@pytest.mark.parametrize("is_coroutine", [False, True])
def test_an_error_of_a_callback_ends_the_executor(spun: Spun, is_coroutine: bool) -> None:
    def fails() -> None:
        raise ArithmeticError("of the callback")

    async def fails_later() -> None:
        fails()

    spun.node.create_timer(0.01, fails_later if is_coroutine else fails)
    spun.thread.join(TIMEOUT_S)
    assert isinstance(spun.ended_by, ArithmeticError)


def test_the_end_of_the_context_ends_it_while_it_waits(spun: Spun) -> None:
    time.sleep(0.1)
    spun.end()
    assert isinstance(spun.ended_by, ExternalShutdownException)


def test_a_shut_executor_ends_while_it_waits(spun: Spun) -> None:
    time.sleep(0.1)
    spun.executor.shutdown()
    spun.thread.join(TIMEOUT_S)
    assert not spun.thread.is_alive()
    assert spun.ended_by is None


def test_a_task_of_another_thread_is_done_while_nothing_comes(spun: Spun) -> None:
    time.sleep(0.1)
    task = spun.executor.create_task(lambda: 42)
    spun.wait(task.done)
    assert task.result() == 42
