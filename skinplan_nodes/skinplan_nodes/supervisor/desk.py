"""Where jobs are handed in, asked for and commanded. Needs no ROS."""

import logging
import threading
from collections.abc import Callable
from dataclasses import replace

from skinplan.errors import JobUnknownError
from skinplan.jobs.model import Job, JobCommand, JobRecord, JobState
from skinplan.jobs.states import apply_command
from skinplan.jobs.store import JobStore
from skinplan_nodes.supervisor.control import JobControl, Request, StepError
from skinplan_nodes.supervisor.faults import NODE_LOST
from skinplan_nodes.supervisor.machine import Event, State, job_state
from skinplan_nodes.supervisor.progress import Progress

#: Attribute of a job that overrides the cell's own ``auto_start``: "true" or "false".
AUTO_START = "auto_start"
_EVENTS = {
    JobCommand.STOP: Event.STOP,
    JobCommand.PAUSE: Event.PAUSE,
    JobCommand.RESUME: Event.RESUME,
}
_log = logging.getLogger(__name__)


class JobDesk:
    """The jobs of a cell, one at a time on the cell itself. To be called from any thread.

    Args:
        store: Keeps the jobs.
        start: Called with a job that is to run now; returns at once.
        on_change: Called with every changed record.
        aborted_code: Status code of a job that somebody aborts.
        dead_node: Name of a node of the cell that has died; None = there is none.
        auto_start: Jobs may start as soon as they are handed in.
    """

    def __init__(
        self,
        store: JobStore,
        start: Callable[[JobRecord, JobControl], None],
        on_change: Callable[[JobRecord], None],
        aborted_code: int,
        auto_start: bool = True,
        *,
        dead_node: Callable[[], str | None] = lambda: None,
    ) -> None:
        self._store = store
        self._start = start
        self._on_change = on_change
        self._aborted_code = aborted_code
        self._auto_start = auto_start
        self._dead_node = dead_node
        self._lock = threading.RLock()
        self._active: JobRecord | None = None
        self._control = JobControl()

    def submit(self, job: Job) -> JobRecord:
        """Puts a job into the queue and starts it when the cell is free.

        Raises:
            JobInvalidError: A field can't be accepted.
            JobConflictError: The id exists with other content.
        """
        wish = dict(job.attributes).get(AUTO_START, str(self._auto_start)).strip().lower()
        with self._lock:
            record = self._store.submit(job, allowed_to_start=wish in ("true", "1", "yes"))
            self._on_change(record)
            self.run_next()
            return self._store.get(job.job_id)

    def get(self, job_id: str) -> JobRecord:
        """Returns a job; an empty id means the running one, or else the last.

        Raises:
            JobUnknownError: There is no such job.
        """
        if job_id:
            return self._store.get(job_id)
        found = self._store.current() or next(iter(self._store.list(1)), None)
        if found is None:
            raise JobUnknownError(
                "the running or last job was asked for; the cell has had none yet"
            )
        return found

    def list(self, limit: int) -> tuple[JobRecord, ...]:
        """Returns jobs, newest first; 0 = all."""
        return self._store.list(limit)

    def command(self, job_id: str, command: int, reason: str) -> JobRecord:
        """Carries a command out, or begins to; what takes time is seen in the job's state later.

        Raises:
            JobUnknownError: There is no such job.
            JobCommandError: Not in this state.
        """
        with self._lock:
            record = self._store.get(job_id)
            state = apply_command(record, command)
            asked = JobCommand(command)
            if asked is JobCommand.CLEAR:
                self._store.remove(job_id)
                return record
            if self._active is not None and self._active.job.job_id == job_id:
                return self._command_active(record, asked, reason)
            code = self._aborted_code if state is JobState.ABORTED else record.error_code
            text = _sentence(asked, reason) if state is JobState.ABORTED else record.error
            changed = self._store.update(
                replace(record, state=state, error_code=code, error=text), reason
            )
            self._on_change(changed)
            self.run_next()
            return self._store.get(job_id)

    def abort_active(self, code: int, message: str, node: str = "") -> None:
        """Ends the job on the cell at once, if there is one.

        Args:
            code: Status code.
            message: Why, one sentence.
            node: Node that caused it; may be empty.
        """
        with self._lock:
            if self._active is not None:
                self._control.abort(code, message, node)

    def ask(self, request: Request) -> None:
        """Tells the job on the cell that something has happened, if there is a job."""
        with self._lock:
            if self._active is not None:
                self._control.ask(request)

    def take_over(self, job_id: str) -> None:
        """Goes on with a job that another supervisor process has begun.

        Args:
            job_id: A job that is Running or Interrupted.
        """
        with self._lock:
            record = self._store.get(job_id)
            self._control = JobControl()
            self._active = self._store.update(
                replace(record, state=JobState.INTERRUPTED, sub_state=State.STOPPING.value),
                "the supervisor was started anew",
            )
            self._on_change(self._active)
            self._start(self._active, self._control)

    def progress(
        self,
        job_id: str,
        state: State,
        progress: Progress,
        run_folder: str,
        why: StepError | None = None,
    ) -> None:
        """Stores how far the job on the cell is; called by the job's own thread.

        Args:
            job_id: The job.
            state: State of the machine.
            progress: How far it is.
            run_folder: The run's folder.
            why: Why it stands still; None = it does not.
        """
        with self._lock:
            record = self._store.get(job_id)
            failed = why is not None and why.code > 0
            changed = replace(
                record,
                state=job_state(state),
                sub_state=progress.sub_state,
                station=progress.station,
                station_count=progress.station_count,
                rescan=progress.rescan,
                progress=progress.share,
                time_left_s=progress.time_left_s,
                run_folder=run_folder,
                error_code=why.code if why is not None and failed else 1,
                error=str(why) if failed else "",
            )
            self._on_change(self._store.update(changed, "" if why is None else str(why)))

    def finish(
        self, job_id: str, state: JobState, code: int, error: str, run_folder: str = ""
    ) -> None:
        """Stores the end of the job on the cell and starts the next one.

        Args:
            job_id: The job.
            state: ENDED or ABORTED.
            code: Status code; 1 = all is well.
            error: Why it was aborted, one sentence; empty = it was not.
            run_folder: The run's folder; empty = there is none.
        """
        with self._lock:
            record = self._store.get(job_id)
            share = 1.0 if state is JobState.ENDED else record.progress
            over = replace(
                record,
                state=state,
                sub_state="",
                progress=share,
                time_left_s=0.0 if state is JobState.ENDED else float("nan"),
                error_code=code,
                error=error,
                run_folder=run_folder,
            )
            self._active = None
            self._on_change(self._store.update(over))
            self.run_next()

    def run_next(self) -> None:
        """Starts the next job when the cell is free."""
        with self._lock:
            waiting = None if self._active is not None else self._store.next_to_run()
            if waiting is None:
                return
            self._control = JobControl()
            self._active = self._store.update(
                replace(waiting, state=JobState.RUNNING, sub_state="starting")
            )
            self._on_change(self._active)
            self._start(self._active, self._control)

    def _command_active(self, record: JobRecord, asked: JobCommand, reason: str) -> JobRecord:
        _log.info("job %s: %s (%s)", record.job.job_id, asked.name, reason)
        if asked in (JobCommand.ABORT, JobCommand.CANCEL):
            self._abort(_sentence(asked, reason))
        else:
            self._control.ask(Request(_EVENTS[asked], message=_sentence(asked, reason)))
        return record

    def _abort(self, text: str) -> None:
        """Who aborts a job because a node has died is told so by the node's name and code."""
        dead = self._dead_node()
        if dead is None:
            self._control.abort(self._aborted_code, text)
        else:
            self._control.abort(NODE_LOST, f"node {dead} was lost; {text}", dead)


def _sentence(command: JobCommand, reason: str) -> str:
    text = f"the command {command.name} was given"
    return f"{text}: {reason}" if reason else text
