"""The job services and the action ``measure_part``: messages in, messages out, nothing waits."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from skinplan_msgs.action import MeasurePart
from skinplan_msgs.msg import InspectionResult, Status
from skinplan_msgs.srv import JobCommand, JobGet, JobList, JobSubmit

from skinplan.errors import SkinplanError
from skinplan.jobs.checks import new_job_id
from skinplan.jobs.model import Job, JobRecord, JobState
from skinplan.jobs.model import JobCommand as JobCommands
from skinplan.jobs.store import JobStore
from skinplan_nodes.conversions import (
    history_entry_to_msg,
    job_from_msg,
    job_status_to_msg,
    job_to_msg,
)
from skinplan_nodes.goal_slot import GoalEnd, accept_goal, conclude
from skinplan_nodes.qos import CALLS
from skinplan_nodes.replies import log_error, ok, replies, status_of
from skinplan_nodes.supervisor.admission import Admission
from skinplan_nodes.supervisor.desk import JobDesk
from skinplan_nodes.supervisor.waiters import JobWaiters


class JobServices:
    """Serves ``jobs/submit``, ``jobs/get``, ``jobs/list`` and ``jobs/command``.

    Args:
        node: The supervisor.
        desk: Takes what is asked.
        store: Keeps the jobs.
    """

    def __init__(self, node: Node, desk: JobDesk, store: JobStore) -> None:
        self._desk = desk
        self._store = store
        self.get_logger = node.get_logger
        node.create_service(JobSubmit, "jobs/submit", self._on_submit, qos_profile=CALLS)
        node.create_service(JobGet, "jobs/get", self._on_get, qos_profile=CALLS)
        node.create_service(JobList, "jobs/list", self._on_list, qos_profile=CALLS)
        node.create_service(JobCommand, "jobs/command", self._on_command, qos_profile=CALLS)

    @replies
    def _on_submit(self, request: JobSubmit.Request, response: JobSubmit.Response) -> None:
        record = self._desk.submit(_with_id(job_from_msg(request.job)))
        response.job_id = record.job.job_id
        response.job_status = job_status_to_msg(record)

    @replies
    def _on_get(self, request: JobGet.Request, response: JobGet.Response) -> None:
        record = self._desk.get(request.job_id)
        job_id = record.job.job_id
        response.job = job_to_msg(record.job)
        response.job_status = job_status_to_msg(record)
        if request.with_history:
            response.history = [history_entry_to_msg(e) for e in self._store.history(job_id)]
        if request.with_result:
            response.result = self._store.result(job_id)
        if record.run_folder:
            folder = Path(record.run_folder)
            response.summary_uri = _existing(folder / "summary.json")
            response.report_uri = _existing(folder / "report.html")

    @replies
    def _on_list(self, request: JobList.Request, response: JobList.Response) -> None:
        found = self._desk.list(
            request.limit, request.before_job_id, request.states, request.include_cleared
        )
        response.jobs = [job_status_to_msg(record) for record in found]

    @replies
    def _on_command(self, request: JobCommand.Request, response: JobCommand.Response) -> None:
        record = self._desk.command(
            request.job_id, request.command, request.reason, request.operator_name
        )
        response.job_status = job_status_to_msg(record)


class MeasureGoals:
    """Serves the action ``measure_part``: a job for those who want to wait for its end.

    Args:
        node: The supervisor.
        desk: Takes the jobs.
        waiters: The goals that wait.
        admission: Knows whether there is a list of operators.
        inspected: Returns the figures of the last inspection.
    """

    def __init__(
        self,
        node: Node,
        desk: JobDesk,
        waiters: JobWaiters,
        admission: Admission,
        inspected: Callable[[], InspectionResult],
    ) -> None:
        self._node = node
        self._desk = desk
        self._waiters = waiters
        self._admission = admission
        self._inspected = inspected
        self._server = ActionServer(
            node,
            MeasurePart,
            "measure_part",
            self._on_measure,
            goal_callback=accept_goal,
            cancel_callback=self._on_cancel,
        )

    async def _on_measure(self, handle: ServerGoalHandle) -> MeasurePart.Result:
        try:
            record = self._desk.submit(_with_id(job_from_msg(handle.request.job)))
        except Exception as error:  # whatever it is, the goal ends with a status
            log_error(self._node.get_logger(), "measure_part", error)
            handle.abort()
            return MeasurePart.Result(status=status_of(error))
        return self._measured(handle, await self._waiters.until_over(record, handle))

    def _on_cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        job_id = self._waiters.job_of(handle)
        if job_id is None:
            return CancelResponse.REJECT
        if self._admission.restricted:
            # Who cancels a goal does not say who he is.
            self._node.get_logger().warning(
                f"job {job_id}: its goal was to be cancelled; where the cell has a list of "
                "operators, jobs/command is accepted"
            )
            return CancelResponse.REJECT
        try:
            self._desk.command(job_id, JobCommands.ABORT, "the goal was cancelled")
        except SkinplanError as error:
            self._node.get_logger().warning(str(error))
            return CancelResponse.REJECT
        return CancelResponse.ACCEPT

    def _measured(self, handle: ServerGoalHandle, record: JobRecord) -> MeasurePart.Result:
        ended = record.state is JobState.ENDED
        conclude(handle, GoalEnd.REACHED if ended else GoalEnd.CANCELLED)
        summary = Path(record.run_folder) / "summary.json" if record.run_folder else None
        return MeasurePart.Result(
            job_status=job_status_to_msg(record),
            result=self._inspected() if ended else InspectionResult(),
            summary_uri="" if summary is None else _existing(summary),
            status=ok() if ended else Status(code=record.error_code, message=record.error),
        )


def _with_id(job: Job) -> Job:
    return job if job.job_id else replace(job, job_id=new_job_id())


def _existing(path: Path) -> str:
    return str(path) if path.is_file() else ""
