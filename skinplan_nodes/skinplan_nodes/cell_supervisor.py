"""Takes jobs and works them off: a measurement from the first drive to the closed bag."""

import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from skinplan_msgs.msg import Heartbeat, JobStatus, Status

from skinplan.errors import SkinplanError
from skinplan.jobs.model import Job, JobRecord, JobState
from skinplan.jobs.store import JobStore
from skinplan_nodes.conversions import job_status_to_msg
from skinplan_nodes.node import CellNode
from skinplan_nodes.parameters import CELL_FILE, Parameter
from skinplan_nodes.planning import configured_cell
from skinplan_nodes.qos import LATCHED, STATE
from skinplan_nodes.replies import RefusedError, status_of
from skinplan_nodes.run import run_node
from skinplan_nodes.supervisor.admission import Admission
from skinplan_nodes.supervisor.control import JobControl, Request, StepError
from skinplan_nodes.supervisor.desk import DeskSettings, JobDesk
from skinplan_nodes.supervisor.job_queue import JobQueue, Retention
from skinplan_nodes.supervisor.job_services import JobServices, MeasureGoals
from skinplan_nodes.supervisor.machine import Event, State
from skinplan_nodes.supervisor.progress import Progress
from skinplan_nodes.supervisor.restore import journal_age_s
from skinplan_nodes.supervisor.ros_cell import RosCell
from skinplan_nodes.supervisor.run_folder import RunFolder
from skinplan_nodes.supervisor.settings import (
    JOBS,
    RESUMING,
    calibration_book,
    work_settings,
)
from skinplan_nodes.supervisor.waiters import JobWaiters
from skinplan_nodes.supervisor.watch import NodeWatch
from skinplan_nodes.supervisor.worker import JobWorker

_LOOK_PERIOD_S = 1.0
# A job gets so long to come to its end; other nodes are waited for no longer than the first part.
_END_TIMEOUT_S, _END_WAITS_S = 2.0, 0.4
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
        *JOBS,
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
        self._told: JobRecord | None = None
        self._closed = False
        self._cell = RosCell(self, values, self._watch, self._on_fault)
        book = calibration_book(values)
        self._worker = JobWorker(
            self._cell, config, runs_folder, _code_of, work_settings(values), book.documents
        )
        self._admission = Admission(
            book, values.operators, values.calibration_required, self._not_ready
        )
        self._thread: threading.Thread | None = None
        self._waiters = JobWaiters(self)
        self._status = self.create_publisher(JobStatus, "job_status", LATCHED)
        self._store = JobStore(
            Path(values.jobs_file) if values.jobs_file else runs_folder / "jobs.sqlite"
        )
        self._queue = JobQueue(
            self._store,
            self._start_job,
            self._on_change,
            self._admission,
            _code_of,
            Retention(values.jobs_kept, values.days_kept),
            self.now_s,
        )
        self._desk = JobDesk(
            self._store,
            self._queue,
            self._admission,
            self._on_change,
            DeskSettings(Status.JOB_ABORTED, values.auto_start, values.queue_max),
            self._watch.dead,
        )
        self._queue.retain()
        self._serve()
        self._take_over(runs_folder)

    def close(self) -> None:
        """Ends the job on the cell: its devices stop, its folder says why."""
        self._cell.waiter.end_by(time.monotonic() + _END_WAITS_S)
        self._queue.close(Status.JOB_ABORTED, "the supervisor was ended")
        if self._thread is not None:
            self._thread.join(_END_TIMEOUT_S)
        with self._queue.lock:
            # A job that takes longer to come to its end is written down, but told to nobody.
            self._closed = True

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
            self._queue.take_over(left.job.job_id)
        self._resuming = ""

    def _is_fresh(self, folder: Path) -> bool:
        return journal_age_s(RunFolder(folder)) <= float(self.values.resume_age_max_s)

    def _serve(self) -> None:
        self._job_services = JobServices(self, self._desk, self._store)
        self._measure_goals = MeasureGoals(
            self, self._desk, self._waiters, self._admission, lambda: self._cell.inspected
        )
        self.create_subscription(Heartbeat, "heartbeat", self._on_beat, STATE)
        self.create_subscription(DiagnosticArray, "diagnostics", self._on_diagnostics, STATE)
        self.create_timer(
            _LOOK_PERIOD_S,
            self._on_look,
            callback_group=MutuallyExclusiveCallbackGroup(),
            clock=Clock(clock_type=ClockType.STEADY_TIME),
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
            self._queue.progress(job.job_id, state, progress, folder, why)

        outcome = self._worker.work(job, control, on_progress, resume)
        folder = "" if outcome.folder is None else str(outcome.folder.path)
        self._queue.finish(
            job.job_id, outcome.state, outcome.code, outcome.error, folder, outcome.summary
        )

    def _on_change(self, record: JobRecord) -> None:
        if self._closed:
            return
        self._status.publish(job_status_to_msg(record))
        self._waiters.changed(record)
        if record.error and record != self._told:
            self._told = record
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
        self._queue.tick()

    def _not_ready(self) -> RefusedError | None:
        """Returns why no job could begin now; a node that was not seen yet may still come."""
        for error in self._cell.faults():
            return RefusedError(Status.DEVICE_NOT_READY, str(error))
        lost = self._watch.lost(time.monotonic())
        return RefusedError(Status.DEVICE_NOT_READY, f"node {lost} is lost") if lost else None

    def _lose(self, name: str, text: str, since_s: float) -> None:
        """A node is gone, or has lost what it knew: the job stands still until it is back."""
        if name not in self._watch.required:
            return
        self.get_logger().error(text)
        if name != _RECORDER or self.values.without_recorder != "go_on":
            self._queue.ask(Request(Event.NODE_LOST, Status.NODE_LOST, text, name, since_s))

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
                self._queue.ask(Request(Event.FAULT, Status.DISK_FULL, error, _RECORDER))

    def _look_at_clock(self) -> None:
        before_s, self._clock_s = self._clock_s, self.now_s()
        if before_s - self._clock_s > _CLOCK_BACK_S:
            text = f"the clock went back by {before_s - self._clock_s:.1f} s"
            self._queue.ask(Request(Event.FAULT, Status.CLOCK_JUMPED, text, "clock"))

    def _on_fault(self, request: Request) -> None:
        self.get_logger().error(request.message)
        self._queue.ask(request)


def _code_of(error: SkinplanError) -> int:
    return int(status_of(error).code)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    return run_node(CellSupervisor, arguments)


if __name__ == "__main__":
    sys.exit(main())
