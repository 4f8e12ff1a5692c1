"""Those who wait for the end of a job: the goals of the action ``measure_part``."""

import threading
from typing import Any

from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from rclpy.task import Future
from skinplan_msgs.action import MeasurePart

from skinplan.jobs.model import JobRecord
from skinplan.jobs.states import is_over
from skinplan_nodes.conversions import job_status_to_msg


class JobWaiters:
    """Goals by the job that they wait for. `changed` may be called from any thread.

    Args:
        node: The supervisor.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._lock = threading.Lock()
        self._goals: dict[bytes, tuple[str, ServerGoalHandle, Future]] = {}

    def until_over(self, record: JobRecord, handle: ServerGoalHandle) -> Future:
        """Returns the future of a job's last record.

        Args:
            record: The job as it is.
            handle: The goal; it gets every change as feedback.
        """
        over = Future(executor=self._node.executor)
        with self._lock:
            self._goals[_key(handle)] = (record.job.job_id, handle, over)
        if is_over(record.state):
            self.changed(record)
        return over

    def changed(self, record: JobRecord) -> None:
        """Tells the goals of a job about a change; the last one is their result."""
        with self._lock:
            items = [
                (key, *goal) for key, goal in self._goals.items() if goal[0] == record.job.job_id
            ]
            if is_over(record.state):
                for key, *_ in items:
                    del self._goals[key]
        for _, _, handle, over in items:
            if is_over(record.state):
                over.set_result(record)
            else:
                handle.publish_feedback(MeasurePart.Feedback(job_status=job_status_to_msg(record)))

    def job_of(self, handle: ServerGoalHandle) -> str | None:
        """Returns the id of the job that a goal waits for; None = it does not wait any more."""
        with self._lock:
            found: tuple[str, Any, Any] | None = self._goals.get(_key(handle))
        return None if found is None else found[0]


def _key(handle: ServerGoalHandle) -> bytes:
    return bytes(handle.goal_id.uuid)
