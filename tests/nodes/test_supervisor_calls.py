"""Services that a job's thread asks, and servers that are killed and come back."""

import threading
import time
from collections.abc import Iterator

import pytest
from rclpy.node import Node
from skinplan_msgs.msg import Status
from std_srvs.srv import Trigger

from nodes.bench import TIMEOUT_S, Bench
from skinplan_nodes.supervisor.calls import Calls
from skinplan_nodes.supervisor.control import StepError
from skinplan_nodes.supervisor.waiting import Waiter

# Longer than any test may last.
_FOREVER_S = 1000.0


class Asked:
    """A question in a thread of its own."""

    def __init__(self, bench: Bench) -> None:
        calls = Calls(bench.tester, Waiter(time.monotonic, lambda _: False, lambda _: 0))
        client = bench.tester.create_client(Trigger, "inspect")
        self.ended: list[StepError | Trigger.Response] = []

        def ask() -> None:
            try:
                self.ended.append(calls.service(client, Trigger.Request(), _FOREVER_S, "inspector"))
            except StepError as error:
                self.ended.append(error)

        self.thread = threading.Thread(target=ask, daemon=True)
        self.thread.start()

    def wait(self) -> StepError | Trigger.Response:
        self.thread.join(TIMEOUT_S)
        assert not self.thread.is_alive()
        (found,) = self.ended
        return found


@pytest.fixture
def silent(bench: Bench) -> Iterator[Node]:
    """Serves and never answers, as a process that was killed does to those that knew it."""
    node = Node("inspector_before", context=bench.context, use_global_arguments=False)
    node.create_service(Trigger, "inspect", lambda _, response: response)
    yield node
    node.destroy_node()


def serve(bench: Bench) -> None:
    def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.message = "here"
        return response

    bench.tester.create_service(Trigger, "inspect", answer)


def test_a_server_that_came_after_the_question_was_not_asked(bench: Bench, silent: Node) -> None:
    bench.wait(lambda: bench.tester.count_services("inspect") == 1)
    asked = Asked(bench)
    asked.thread.join(0.5)
    assert asked.thread.is_alive(), "nobody answers"
    serve(bench)
    error = asked.wait()
    assert isinstance(error, StepError)
    assert (error.code, error.node) == (Status.NODE_LOST, "inspector")
    assert str(error) == "service inspect: node inspector was started again meanwhile"


def test_a_server_that_left_and_came_again_was_not_asked(bench: Bench, silent: Node) -> None:
    bench.wait(lambda: bench.tester.count_services("inspect") == 1)
    asked = Asked(bench)
    asked.thread.join(0.5)
    silent.destroy_node()
    bench.wait(lambda: bench.tester.count_services("inspect") == 0)
    asked.thread.join(0.2)
    assert asked.thread.is_alive()
    serve(bench)
    assert isinstance(asked.wait(), StepError)


def test_the_first_server_is_waited_for_and_asked(bench: Bench) -> None:
    asked = Asked(bench)
    asked.thread.join(0.3)
    assert asked.thread.is_alive()
    serve(bench)
    found = asked.wait()
    assert isinstance(found, Trigger.Response) and found.message == "here"
