"""The jobs that wait, and the one on the cell: next, progress, end. Needs no ROS."""

import logging
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from skinplan.errors import JobStoreError, SkinplanError
from skinplan.jobs.model import Job, JobRecord, JobState
from skinplan.jobs.store import JobStore
from skinplan_nodes.supervisor.admission import Admission
from skinplan_nodes.supervisor.control import JobControl, Request, StepError
from skinplan_nodes.supervisor.machine import State, job_state
from skinplan_nodes.supervisor.progress import Progress
from skinplan_nodes.supervisor.time_left import TimeLeft

_DAY_NS = 86_400_000_000_000
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Retention:
    """How long jobs that are over are kept.

    Attributes:
        jobs: So many of them; 0 = no limit.
        days: So long [d].
    """

    jobs: int = 0
    days: float = 36500.0


class JobQueue:
    """The jobs of a cell, one at a time on the cell itself. To be called from any thread.

    Args:
        store: Keeps the jobs.
        start: Called with a job that is to run now; returns at once.
        on_change: Called with every changed record, and about once a second with that of the job
            on the cell.
        admission: Which jobs are taken.
        code_of: Status code of an error of the library.
        retention: How long jobs that are over are kept.
        now_s: Returns the cell's time [s].

    Attributes:
        lock: Held while a job changes hands.
        active: The job on the cell; None = it is free.
        control: Switches of the job on the cell.
    """

    def __init__(
        self,
        store: JobStore,
        start: Callable[[JobRecord, JobControl], None],
        on_change: Callable[[JobRecord], None],
        admission: Admission,
        code_of: Callable[[SkinplanError], int],
        retention: Retention = Retention(),
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._store = store
        self._start = start
        self._on_change = on_change
        self._admission = admission
        self._code_of = code_of
        self._retention = retention
        self._now_s = now_s
        self.lock = threading.RLock()
        self.active: JobRecord | None = None
        self.control = JobControl()
        self._time_left = TimeLeft()
        self._closed = False
        # Why the job on the cell is in its state, when that could not be stored yet.
        self._behind: str | None = None
        self._not_stored: tuple[JobRecord, Mapping[str, Any] | None] | None = None

    def abort_active(self, code: int, message: str, node: str = "") -> None:
        """Ends the job on the cell at once, if there is one.

        Args:
            code: Status code.
            message: Why, one sentence.
            node: Node that caused it; may be empty.
        """
        with self.lock:
            if self.active is not None:
                self.control.abort(code, message, node)

    def close(self, code: int, message: str) -> None:
        """Ends the job on the cell; no other one begins any more."""
        with self.lock:
            self._closed = True
            self.abort_active(code, message)

    def ask(self, request: Request) -> None:
        """Tells the job on the cell that something has happened, if there is a job."""
        with self.lock:
            if self.active is not None:
                self.control.ask(request)

    def take_over(self, job_id: str) -> None:
        """Goes on with a job that another supervisor process has begun.

        Args:
            job_id: A job that is Running or Interrupted.
        """
        with self.lock:
            record = self._store.get(job_id)
            self.control = JobControl()
            self.active = self._store.update(
                replace(record, state=JobState.INTERRUPTED, sub_state=State.STOPPING.value),
                "the supervisor was started anew",
            )
            self._on_change(self.active)
            self._start(self.active, self.control)

    def progress(
        self,
        job_id: str,
        state: State,
        progress: Progress,
        run_folder: str,
        why: StepError | None = None,
    ) -> None:
        """Stores how far the job on the cell is; called by the job's own thread.

        A store that can't be written does not end the measurement.

        Args:
            job_id: The job.
            state: State of the machine.
            progress: How far it is.
            run_folder: The run's folder.
            why: Why it stands still; None = it does not.
        """
        with self.lock:
            record = self.active
            if record is None or record.job.job_id != job_id:
                record = self._store.get(job_id)
            changed = _advanced(record, state, progress, run_folder, why)
            self.active = changed = self._stored(changed, "" if why is None else str(why))
            self._time_left.begin(changed, self._now_s())
            self._on_change(self.as_of_now(changed))

    def _stored(self, record: JobRecord, reason: str) -> JobRecord:
        """Stores a record, now or with one of the next ticks."""
        try:
            record = self._store.update(record, reason)
        except JobStoreError as error:
            _log.error("job %s: %s", record.job.job_id, error)
            self._behind = reason
        else:
            self._behind = None
        return record

    def known(self, job_id: str) -> JobRecord:
        """Returns a job as it is, also while the store can't be written.

        Raises:
            JobUnknownError: There is no such job.
        """
        with self.lock:
            if self.active is not None and self.active.job.job_id == job_id:
                return self.active
            return self._store.get(job_id)

    def finish(
        self,
        job_id: str,
        state: JobState,
        code: int,
        error: str,
        run_folder: str = "",
        result: Mapping[str, Any] | None = None,
    ) -> None:
        """Stores the end of the job on the cell and starts the next one.

        Args:
            job_id: The job.
            state: ENDED or ABORTED.
            code: Status code; 1 = all is well.
            error: Why it was aborted, one sentence; empty = it was not.
            run_folder: The run's folder; empty = there is none.
            result: What it came to; None = nothing.
        """
        with self.lock:
            record = self.active or self._store.get(job_id)
            over = replace(
                record,
                state=state,
                sub_state="",
                progress=1.0 if state is JobState.ENDED else record.progress,
                time_left_s=0.0 if state is JobState.ENDED else float("nan"),
                error_code=code,
                error=error,
                run_folder=run_folder,
            )
            self._store_end(over, result)

    def tick(self) -> None:
        """Does what comes with time; to be called about once a second."""
        with self.lock:
            self._time_left.look(self._now_s(), time.monotonic())
            if self._not_stored is not None:
                self._store_end(*self._not_stored)
            elif self._behind is not None and self.active is not None:
                self.active = self._stored(self.active, self._behind)
            if self.active is None:
                self.run_next()
            elif self.active.state is JobState.RUNNING:
                self._on_change(self.as_of_now(self.active))

    def run_next(self) -> None:
        """Starts the next job when the cell is free; one that may not start any more waits."""
        with self.lock:
            try:
                while not self._busy() and self._take():
                    pass
            except JobStoreError as error:
                # Tried again with the next tick.
                _log.error("%s", error)

    def retain(self) -> None:
        """Forgets old jobs, and the oldest of too many."""
        oldest_ns = time.time_ns() - round(self._retention.days * _DAY_NS)
        try:
            gone = self._store.retain(self._retention.jobs, oldest_ns)
        except JobStoreError as error:
            _log.error("%s", error)
            return
        if gone:
            _log.info("%d jobs that are over were forgotten", gone)

    def would_begin(self, job: Job) -> bool:
        """Whether a job would begin now, if it were allowed to start."""
        free = self.active is None and self._store.next_to_run() is None
        return free and job.earliest_start_ns <= time.time_ns()

    def as_of_now(self, record: JobRecord) -> JobRecord:
        """Returns a record with the time left by now, and the expected end."""
        return self._time_left.now(record, self._now_s(), time.time())

    def _busy(self) -> bool:
        return self._closed or self.active is not None or self._not_stored is not None

    def _take(self) -> bool:
        """Begins the next job, or sends it back; returns whether there was one."""
        waiting = self._store.next_to_run()
        if waiting is None:
            return False
        try:
            self._admission.check_calibration(waiting.job)
        except SkinplanError as error:
            self._revoke(waiting, error)
            return True
        self._begin(waiting)
        return True

    def _begin(self, waiting: JobRecord) -> None:
        self.control = JobControl()
        self.active = self._store.update(
            replace(waiting, state=JobState.RUNNING, sub_state="starting", error_code=1, error="")
        )
        self._on_change(self.active)
        self._start(self.active, self.control)

    def _revoke(self, waiting: JobRecord, error: SkinplanError) -> None:
        held = replace(
            waiting,
            state=JobState.NOT_ALLOWED_TO_START,
            error_code=self._code_of(error),
            error=str(error),
        )
        self._on_change(self._store.update(held))

    def _store_end(self, over: JobRecord, result: Mapping[str, Any] | None) -> None:
        try:
            over = self._store.finish(over, result)
        except JobStoreError as error:
            # The next job waits until this one's end is written down.
            _log.error("job %s: %s", over.job.job_id, error)
            self._not_stored = over, result
            return
        self._not_stored = self.active = self._behind = None
        self._on_change(over)
        self.retain()
        self.run_next()


def _advanced(
    record: JobRecord, state: State, progress: Progress, run_folder: str, why: StepError | None
) -> JobRecord:
    failed = why is not None and why.code > 0
    return replace(
        record,
        state=job_state(state),
        sub_state=progress.sub_state,
        station=progress.station,
        station_count=progress.station_count,
        rescan=progress.rescan,
        step=progress.step,
        step_count=progress.step_count,
        progress=progress.share,
        time_left_s=progress.time_left_s,
        run_folder=run_folder,
        error_code=why.code if why is not None and failed else 1,
        error=str(why) if failed else "",
    )
