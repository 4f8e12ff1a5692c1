"""Takes jobs and works them off: a measurement from the first drive to the closed bag."""

import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from skinplan_msgs.action import MeasurePart
from skinplan_msgs.msg import Heartbeat, InspectionResult, JobStatus, Status
from skinplan_msgs.srv import JobCommand, JobGet, JobList, JobSubmit

from skinplan.errors import SkinplanError
from skinplan.jobs.checks import new_job_id
from skinplan.jobs.model import Job, JobRecord, JobState
from skinplan.jobs.model import JobCommand as JobCommands
from skinplan.jobs.store import JobStore
from skinplan_nodes.conversions import job_from_msg, job_status_to_msg, job_to_msg
from skinplan_nodes.goal_slot import GoalEnd, accept_goal, conclude
from skinplan_nodes.node import CellNode
from skinplan_nodes.parameters import CELL_FILE, Parameter
from skinplan_nodes.planning import configured_cell
from skinplan_nodes.qos import LATCHED, STATE
from skinplan_nodes.replies import ok, replies, status_of
from skinplan_nodes.run import run_node
from skinplan_nodes.supervisor.control import JobControl
from skinplan_nodes.supervisor.desk import JobDesk
from skinplan_nodes.supervisor.ros_cell import RosCell
from skinplan_nodes.supervisor.waiters import JobWaiters
from skinplan_nodes.supervisor.watch import NodeWatch
from skinplan_nodes.supervisor.worker import JobWorker

_LOOK_PERIOD_S = 1.0
_END_TIMEOUT_S = 2.0
_NO_NODES = ""


class CellSupervisor(CellNode):
    """Job services and the action ``measure_part``; one job at a time in a thread of its own."""

    NAME = "cell_supervisor"
    THREADS = 1
    PARAMETERS = (
        CELL_FILE,
        Parameter(
            "runs_folder",
            "runs",
            "Folder that gets the run folders; relative to where the node is started.",
        ),
        Parameter(
            "jobs_file", "", "SQLite file of the jobs; empty = jobs.sqlite in the runs folder."
        ),
        Parameter(
            "auto_start",
            True,
            "Jobs start as soon as they are handed in, unless they say otherwise.",
        ),
        Parameter("report", True, "Write report.html after a job."),
        Parameter(
            "required_nodes",
            [_NO_NODES],
            "Names of the nodes that a job needs; empty = none is watched.",
        ),
        Parameter(
            "silent_max_s",
            5.0,
            "A required node without heartbeat for so long of wall time, whose process is gone, is "
            "lost; four times as long otherwise [s].",
            2.0,
            60.0,
        ),
        Parameter(
            "start_timeout_s",
            60.0,
            "Longest wait for the required nodes, wall time [s].",
            1.0,
            600.0,
        ),
        Parameter(
            "planning_timeout_s", 300.0, "Longest wait for a planner, wall time [s].", 1.0, 3600.0
        ),
        Parameter(
            "drive_timeout_s", 180.0, "Longest drive of the base, cell time [s].", 1.0, 3600.0
        ),
        Parameter(
            "localize_timeout_s",
            400.0,
            "Longest localisation with all its drives, cell time [s].",
            1.0,
            3600.0,
        ),
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        values = self.values
        config = configured_cell(values.cell_file)
        runs_folder = Path(values.runs_folder).absolute()
        self._watch = NodeWatch(tuple(values.required_nodes), values.silent_max_s)
        self._cell = RosCell(self, values, self._watch.missing, self._is_lost)
        self._worker = JobWorker(self._cell, config, runs_folder, _code_of, values.report)
        self._thread: threading.Thread | None = None
        self._waiters = JobWaiters(self)
        self._status = self.create_publisher(JobStatus, "job_status", LATCHED)
        self._store = self._open_store(runs_folder)
        self._desk = JobDesk(
            self._store, self._start_job, self._on_change, Status.JOB_ABORTED, values.auto_start
        )
        self._serve()

    def close(self) -> None:
        """Ends the job on the cell: its devices stop, its folder says why."""
        self._desk.abort_active(Status.JOB_ABORTED, "the supervisor was ended")
        if self._thread is not None:
            self._thread.join(_END_TIMEOUT_S)

    def _open_store(self, runs_folder: Path) -> JobStore:
        path = Path(self.values.jobs_file) if self.values.jobs_file else runs_folder / "jobs.sqlite"
        store = JobStore(path)
        for record in store.abort_unfinished(
            Status.JOB_ABORTED, "the supervisor ended while the job was running"
        ):
            self.get_logger().warning(
                f"job {record.job.job_id} was not finished by the supervisor before this one"
            )
        # A cell that was started anew does not move by itself: what waited has to be started again.
        for record in store.list():
            if record.state is JobState.ALLOWED_TO_START:
                store.update(
                    replace(record, state=JobState.NOT_ALLOWED_TO_START),
                    "the supervisor was started anew",
                )
        return store

    def _serve(self) -> None:
        self.create_service(JobSubmit, "jobs/submit", self._on_submit)
        self.create_service(JobGet, "jobs/get", self._on_get)
        self.create_service(JobList, "jobs/list", self._on_list)
        self.create_service(JobCommand, "jobs/command", self._on_command)
        self._server = ActionServer(
            self,
            MeasurePart,
            "measure_part",
            self._on_measure,
            goal_callback=accept_goal,
            cancel_callback=self._on_cancel,
        )
        self.create_subscription(Heartbeat, "heartbeat", self._on_beat, STATE)
        self.create_timer(
            _LOOK_PERIOD_S,
            self._on_look,
            callback_group=MutuallyExclusiveCallbackGroup(),
            clock=Clock(clock_type=ClockType.STEADY_TIME),
        )

    @replies
    def _on_submit(self, request: JobSubmit.Request, response: JobSubmit.Response) -> None:
        record = self._desk.submit(_with_id(job_from_msg(request.job)))
        response.job_id = record.job.job_id
        response.job_status = job_status_to_msg(record)

    @replies
    def _on_get(self, request: JobGet.Request, response: JobGet.Response) -> None:
        record = self._desk.get(request.job_id)
        response.job = job_to_msg(record.job)
        response.job_status = job_status_to_msg(record)

    @replies
    def _on_list(self, request: JobList.Request, response: JobList.Response) -> None:
        response.jobs = [job_status_to_msg(record) for record in self._desk.list(request.limit)]

    @replies
    def _on_command(self, request: JobCommand.Request, response: JobCommand.Response) -> None:
        record = self._desk.command(request.job_id, request.command, request.reason)
        response.job_status = job_status_to_msg(record)

    async def _on_measure(self, handle: ServerGoalHandle) -> MeasurePart.Result:
        try:
            record = self._desk.submit(_with_id(job_from_msg(handle.request.job)))
        except SkinplanError as error:
            handle.abort()
            return MeasurePart.Result(status=status_of(error))
        return self._measured(handle, await self._waiters.until_over(record, handle))

    def _on_cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        job_id = self._waiters.job_of(handle)
        if job_id is None:
            return CancelResponse.REJECT
        try:
            self._desk.command(job_id, JobCommands.ABORT, "the goal was cancelled")
        except SkinplanError as error:
            self.get_logger().warning(str(error))
            return CancelResponse.REJECT
        return CancelResponse.ACCEPT

    def _measured(self, handle: ServerGoalHandle, record: JobRecord) -> MeasurePart.Result:
        ended = record.state is JobState.ENDED
        conclude(handle, GoalEnd.REACHED if ended else GoalEnd.CANCELLED)
        folder = Path(record.run_folder) if record.run_folder else None
        summary = folder / "summary.json" if folder is not None else None
        return MeasurePart.Result(
            job_status=job_status_to_msg(record),
            result=self._cell.inspected if ended else InspectionResult(),
            summary_uri=str(summary) if summary is not None and summary.is_file() else "",
            status=ok() if ended else Status(code=record.error_code, message=record.error),
        )

    def _start_job(self, record: JobRecord, control: JobControl) -> None:
        self._cell.waiter.control = control
        self._thread = threading.Thread(
            target=self._work, args=(record.job, control), name="job", daemon=True
        )
        self._thread.start()

    def _work(self, job: Job, control: JobControl) -> None:
        def on_progress(progress: Any, folder: str) -> None:
            self._desk.progress(job.job_id, progress, folder)

        outcome = self._worker.work(job, control, on_progress)
        folder = "" if outcome.folder is None else str(outcome.folder.path)
        self._desk.finish(job.job_id, outcome.state, outcome.code, outcome.error, folder)

    def _on_change(self, record: JobRecord) -> None:
        self._status.publish(job_status_to_msg(record))
        self._waiters.changed(record)
        if record.error:
            self.get_logger().error(f"job {record.job.job_id}: {record.error}")

    def _on_beat(self, message: Heartbeat) -> None:
        self._watch.beat(message.node, time.monotonic(), message.pid)

    def _on_look(self) -> None:
        here = self.get_namespace()
        found = self.get_node_names_and_namespaces()
        self._watch.look(name for name, namespace in found if namespace == here)
        lost = self._watch.lost(time.monotonic())
        if lost is not None:
            self._desk.abort_active(Status.NODE_LOST, f"node {lost} was lost", lost)

    def _is_lost(self, name: str) -> bool:
        return self._watch.is_lost(name, time.monotonic())


def _with_id(job: Job) -> Job:
    return job if job.job_id else replace(job, job_id=new_job_id())


def _code_of(error: SkinplanError) -> int:
    return int(status_of(error).code)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    return run_node(CellSupervisor, arguments)


if __name__ == "__main__":
    sys.exit(main())
