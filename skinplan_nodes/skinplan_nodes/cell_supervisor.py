"""Takes jobs and works them off: a measurement from the first drive to the closed bag."""

import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
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
from skinplan_nodes.supervisor.control import JobControl, Request, StepError
from skinplan_nodes.supervisor.desk import JobDesk
from skinplan_nodes.supervisor.machine import Event, State
from skinplan_nodes.supervisor.progress import Progress
from skinplan_nodes.supervisor.restore import journal_age_s
from skinplan_nodes.supervisor.ros_cell import RosCell
from skinplan_nodes.supervisor.run_folder import RunFolder
from skinplan_nodes.supervisor.settings import RESUMING, work_settings
from skinplan_nodes.supervisor.waiters import JobWaiters
from skinplan_nodes.supervisor.watch import NodeWatch
from skinplan_nodes.supervisor.worker import JobWorker

_LOOK_PERIOD_S = 1.0
_END_TIMEOUT_S = 2.0
_RECORDER = "run_recorder"
# The cell's clock may be corrected by less than this [s].
_CLOCK_BACK_S = 0.5


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
            [""],
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
        *RESUMING,
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        values = self.values
        config = configured_cell(values.cell_file)
        runs_folder = Path(values.runs_folder).absolute()
        self._watch = NodeWatch(tuple(values.required_nodes), values.silent_max_s)
        self._announced: set[str] = set()
        self._resuming = ""
        self._clock_s = 0.0
        self._cell = RosCell(self, values, self._watch, self._on_fault)
        self._worker = JobWorker(self._cell, config, runs_folder, _code_of, work_settings(values))
        self._thread: threading.Thread | None = None
        self._waiters = JobWaiters(self)
        self._status = self.create_publisher(JobStatus, "job_status", LATCHED)
        self._store = JobStore(
            Path(values.jobs_file) if values.jobs_file else runs_folder / "jobs.sqlite"
        )
        self._desk = JobDesk(
            self._store,
            self._start_job,
            self._on_change,
            Status.JOB_ABORTED,
            values.auto_start,
            dead_node=self._watch.dead,
        )
        self._serve()
        self._take_over(runs_folder)

    def close(self) -> None:
        """Ends the job on the cell: its devices stop, its folder says why."""
        self._desk.abort_active(Status.JOB_ABORTED, "the supervisor was ended")
        if self._thread is not None:
            self._thread.join(_END_TIMEOUT_S)

    def _take_over(self, runs_folder: Path) -> None:
        """Goes on with the job of the supervisor process before this one, if there is one."""
        left = self._store.current()
        fresh = left is not None and self._is_fresh(runs_folder / left.job.job_id)
        if not (fresh and self.values.resume_at_start):
            # A cell that was switched on does not move by itself: what waited waits for START.
            for record in self._store.list():
                if record.state is JobState.ALLOWED_TO_START:
                    self._store.update(
                        replace(record, state=JobState.NOT_ALLOWED_TO_START),
                        "the supervisor was started anew",
                    )
        if left is not None:
            self.get_logger().warning(
                f"job {left.job.job_id} was not finished by the supervisor before this one"
            )
            self._resuming = left.job.job_id
            self._desk.take_over(left.job.job_id)
        self._resuming = ""

    def _is_fresh(self, folder: Path) -> bool:
        return journal_age_s(RunFolder(folder)) <= float(self.values.resume_age_max_s)

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
        self.create_subscription(DiagnosticArray, "diagnostics", self._on_diagnostics, STATE)
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
        resume = record.job.job_id == self._resuming
        self._thread = threading.Thread(
            target=self._work, args=(record.job, control, resume), name="job", daemon=True
        )
        self._thread.start()

    def _work(self, job: Job, control: JobControl, resume: bool) -> None:
        def on_progress(
            state: State, progress: Progress, folder: str, why: StepError | None
        ) -> None:
            self._desk.progress(job.job_id, state, progress, folder, why)

        outcome = self._worker.work(job, control, on_progress, resume)
        folder = "" if outcome.folder is None else str(outcome.folder.path)
        self._desk.finish(job.job_id, outcome.state, outcome.code, outcome.error, folder)

    def _on_change(self, record: JobRecord) -> None:
        self._status.publish(job_status_to_msg(record))
        self._waiters.changed(record)
        if record.error:
            self.get_logger().error(f"job {record.job.job_id}: {record.error}")

    def _on_beat(self, message: Heartbeat) -> None:
        name = message.node.rsplit("/", 1)[-1]
        before_s = self._watch.last_beat_s(name)
        another = self._watch.beat(name, time.monotonic(), message.pid)
        announced = name in self._announced
        self._announced.discard(name)
        if another and not announced:
            self._lose(name, f"node {name} was started anew", before_s)

    def _on_look(self) -> None:
        here = self.get_namespace()
        found = self.get_node_names_and_namespaces()
        self._watch.look(name for name, namespace in found if namespace == here)
        now_s = time.monotonic()
        for name in self._watch.required:
            if name not in self._announced and self._watch.is_lost(name, now_s):
                self._announced.add(name)
                self._lose(name, f"node {name} was lost", self._watch.last_beat_s(name))
        self._look_at_clock()

    def _lose(self, name: str, text: str, since_s: float) -> None:
        """A node is gone, or has lost what it knew: the job stands still until it is back."""
        if name not in self._watch.required:
            return
        self.get_logger().error(text)
        if name != _RECORDER or self.values.without_recorder != "go_on":
            self._desk.ask(Request(Event.NODE_LOST, Status.NODE_LOST, text, name, since_s))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.hardware_id == _RECORDER:
                self._on_recorder(status.message if status.level == DiagnosticStatus.ERROR else "")

    def _on_recorder(self, error: str) -> None:
        """The recorder has told whether it can write."""
        before, self._cell.recorder_error = self._cell.recorder_error, error
        if error and not before:
            self.get_logger().error(f"{_RECORDER}: {error}")
            if self.values.without_recorder != "go_on":
                self._desk.ask(Request(Event.FAULT, Status.DISK_FULL, error, _RECORDER))

    def _look_at_clock(self) -> None:
        before_s, self._clock_s = self._clock_s, self.now_s()
        if before_s - self._clock_s > _CLOCK_BACK_S:
            text = f"the clock went back by {before_s - self._clock_s:.1f} s"
            self._desk.ask(Request(Event.FAULT, Status.CLOCK_JUMPED, text, "clock"))

    def _on_fault(self, request: Request) -> None:
        self.get_logger().error(request.message)
        self._desk.ask(request)


def _with_id(job: Job) -> Job:
    return job if job.job_id else replace(job, job_id=new_job_id())


def _code_of(error: SkinplanError) -> int:
    return int(status_of(error).code)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    return run_node(CellSupervisor, arguments)


if __name__ == "__main__":
    sys.exit(main())
