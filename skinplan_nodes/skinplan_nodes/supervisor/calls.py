"""Service calls and action goals of a job's thread: bounded, named, ended by an abort."""

import threading
import time
from collections.abc import Callable
from typing import Any

from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future
from skinplan_msgs.msg import PartReference, Status

from skinplan.jobs.model import Job
from skinplan_nodes.supervisor.control import StepError
from skinplan_nodes.supervisor.waiting import Waiter

_SERVER_S = 10.0
_ACCEPT_S = 10.0
_CANCEL_S = 1.0
_BUSY_LOOK_S = 0.3


class Calls:
    """Calls services and actions from a thread that is not the executor's.

    Args:
        node: The node that owns the clients.
        waiter: Waits, and knows when the job is to end.
    """

    def __init__(self, node: Node, waiter: Waiter) -> None:
        self._node = node
        self._waiter = waiter
        self._lock = threading.Lock()
        self._goals: list[tuple[Any, str]] = []

    def service(
        self,
        client: Client,
        request: Any,
        timeout_s: float,
        node: str,
        accepted: tuple[int, ...] = (Status.OK,),
    ) -> Any:
        """Calls a service and returns its response.

        Raises:
            InterruptError: Something breaks into it.
            StepError: No server, no answer in time, or a status that is not accepted, with the
                server's own code.
        """
        what = f"service {client.srv_name}"
        self._wait_server(client.service_is_ready, what, node)
        name = client.srv_name
        sent = client.call_async(request)
        response = self._waiter.wall(
            sent, timeout_s, what, node, lambda: self._node.count_services(name)
        )
        status = getattr(response, "status", None)
        if status is not None and status.code not in accepted:
            raise StepError(status.code, _text(status), node)
        return response

    def action(
        self,
        client: ActionClient,
        goal: Any,
        timeout_s: float,
        node: str,
        busy_s: float = 0.0,
    ) -> tuple[Any, bool]:
        """Sends a goal and waits for its end, on the cell's time.

        Args:
            client: Sends it.
            goal: The goal.
            timeout_s: Longest wait for its end, on the cell's time [s].
            node: Who serves it.
            busy_s: A server that works on one goal at a time rejects others: so long the goal is
                sent again, wall time [s].

        Returns:
            The result, and whether the goal succeeded.

        Raises:
            InterruptError: Something breaks into it; the goal is cancelled.
            StepError: No server, goal rejected, or no end in time; then the goal is cancelled, too.
        """
        name = f"action {client._action_name}"
        self._wait_server(client.server_is_ready, name, node)
        handle = self._sent(client, goal, name, node)
        deadline = time.monotonic() + busy_s
        while not handle.accepted and time.monotonic() < deadline:
            time.sleep(_BUSY_LOOK_S)
            handle = self._sent(client, goal, name, node)
        if not handle.accepted:
            raise StepError(Status.DEVICE_REFUSED, f"{name}: the goal was rejected", node)
        with self._lock:
            self._goals.append((handle, node))
        try:
            response = self._waiter.cell(handle.get_result_async(), timeout_s, name, node)
        except StepError:
            self.cancel_all()
            raise
        with self._lock:
            self._goals.clear()
        return response.result, response.status == GoalStatus.STATUS_SUCCEEDED

    def _sent(self, client: ActionClient, goal: Any, name: str, node: str) -> Any:
        """Sends a goal, and returns its handle when it is known whether it is accepted."""
        sent = client.send_goal_async(goal)
        try:
            return self._waiter.wall(sent, _ACCEPT_S, name, node)
        except StepError:
            # Accepted after nobody waits any more: such a goal must not run on.
            sent.add_done_callback(_cancel_late)
            raise

    def cancel_all(self) -> None:
        """Cancels the goals that are being worked on, and waits shortly for the answers."""
        with self._lock:
            goals, self._goals = self._goals, []
        answers = [handle.cancel_goal_async() for handle, _ in goals]
        self._waiter.until(lambda: all(answer.done() for answer in answers), _CANCEL_S)

    def _wait_server(self, ready: Callable[[], bool], what: str, node: str) -> None:
        deadline = time.monotonic() + _SERVER_S
        while not ready():
            self._waiter.control.check()
            if time.monotonic() > deadline or self._waiter.is_over():
                waited = "at the end" if self._waiter.is_over() else f"after {_SERVER_S:g} s"
                text = f"{what}: nobody serves it {waited}"
                raise StepError(Status.DEVICE_NOT_READY, text, node)
            time.sleep(0.02)


def _cancel_late(sent: Future) -> None:
    handle = None if sent.cancelled() or sent.exception() is not None else sent.result()
    if handle is not None and handle.accepted:
        handle.cancel_goal_async()


def _text(status: Status) -> str:
    if status.code == Status.UNSET:
        return "the answer has no status: the server failed without saying why"
    return status.message or f"status {status.code}"


def part_reference(job: Job) -> PartReference:
    """Returns what the services are told about a job's part."""
    return PartReference(uri=job.part_uri, mesh_sha256=job.mesh_sha256)
