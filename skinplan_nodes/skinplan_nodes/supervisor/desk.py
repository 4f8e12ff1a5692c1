"""Where jobs are handed in, asked for and commanded. Needs no ROS."""

import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from skinplan.errors import JobUnknownError
from skinplan.jobs.checks import check_command, check_job
from skinplan.jobs.model import Job, JobCommand, JobRecord, JobState
from skinplan.jobs.states import apply_command
from skinplan.jobs.store import JobStore
from skinplan_nodes.supervisor.admission import Admission
from skinplan_nodes.supervisor.control import Request
from skinplan_nodes.supervisor.faults import NODE_LOST
from skinplan_nodes.supervisor.job_queue import JobQueue
from skinplan_nodes.supervisor.machine import Event

#: Attribute of a job that overrides the cell's own ``auto_start``: "true" or "false".
AUTO_START = "auto_start"
#: No more jobs than this in one answer.
LONGEST_LIST = 500
_EVENTS = {
    JobCommand.STOP: Event.STOP,
    JobCommand.PAUSE: Event.PAUSE,
    JobCommand.RESUME: Event.RESUME,
}
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class DeskSettings:
    """How the desk works.

    Attributes:
        aborted_code: Status code of a job that somebody aborts.
        auto_start: Jobs may start as soon as they are handed in.
        queue_max: So many jobs may wait; 0 = no limit.
    """

    aborted_code: int
    auto_start: bool = True
    queue_max: int = 0


class JobDesk:
    """What is asked of the jobs from outside. To be called from any thread.

    Args:
        store: Keeps the jobs.
        queue: The jobs that wait, and the one on the cell.
        admission: Who may ask for jobs, and which ones are taken.
        on_change: Called with every changed record.
        settings: How the desk works.
        dead_node: Name of a node of the cell that has died; None = there is none.
    """

    def __init__(
        self,
        store: JobStore,
        queue: JobQueue,
        admission: Admission,
        on_change: Callable[[JobRecord], None],
        settings: DeskSettings,
        dead_node: Callable[[], str | None] = lambda: None,
    ) -> None:
        self._store = store
        self._queue = queue
        self._admission = admission
        self._on_change = on_change
        self._settings = settings
        self._dead_node = dead_node

    def submit(self, job: Job) -> JobRecord:
        """Puts a job into the queue and starts it when the cell is free.

        The same job again is the same job, whatever has become of cell and queue meanwhile.

        Raises:
            JobInvalidError: A field can't be accepted.
            JobOperatorError: The operator is not in the cell's list.
            JobConflictError: The id exists with other content.
            JobQueueFullError: As many jobs as may wait do so.
            SkinplanError: Part, calibration or devices do not allow it, see `Admission`.
        """
        self._admission.check_operator(check_job(job).operator_name)
        known = self._store.same(job)
        if known is not None:
            return self._queue.as_of_now(known)
        self._admission.check_part(job)
        self._admission.check_calibration(job)
        wish = dict(job.attributes).get(AUTO_START, str(self._settings.auto_start)).strip().lower()
        may_start = wish in ("true", "1", "yes")
        with self._queue.lock:
            if may_start and self._queue.would_begin(job):
                self._admission.check_ready()
            record = self._store.submit(job, may_start, self._settings.queue_max)
            self._on_change(record)
            self._queue.run_next()
            return self._queue.as_of_now(self._store.get(job.job_id))

    def get(self, job_id: str) -> JobRecord:
        """Returns a job; an empty id means the running one, or else the last.

        Raises:
            JobUnknownError: There is no such job.
        """
        if job_id:
            return self._queue.as_of_now(self._queue.known(job_id))
        found = self._queue.active or self._store.current() or next(iter(self._store.list(1)), None)
        if found is None:
            raise JobUnknownError(
                "the running or last job was asked for; the cell has had none yet"
            )
        return self._queue.as_of_now(found)

    def list(
        self,
        limit: int = 0,
        before: str = "",
        states: Iterable[int] = (),
        include_cleared: bool = False,
    ) -> tuple[JobRecord, ...]:
        """Returns jobs, newest first; arguments as of `JobStore.list`, the limit at most 500."""
        most = min(limit or LONGEST_LIST, LONGEST_LIST)
        return self._store.list(most, before, states, include_cleared)

    def command(self, job_id: str, command: int, reason: str, operator_name: str = "") -> JobRecord:
        """Carries a command out, or begins to; what takes time is seen in the job's state later.

        Args:
            job_id: The job.
            command: A number of `JobCommand`.
            reason: Why; kept in the history.
            operator_name: Who asks.

        Raises:
            JobTextError: Reason or operator can't be kept.
            JobOperatorError: The operator is not in the cell's list.
            JobUnknownError: There is no such job.
            JobCommandError: Not in this state.
            SkinplanError: The cell can't start the job, see `Admission`.
        """
        check_command(operator_name, reason)
        self._admission.check_operator(operator_name)
        with self._queue.lock:
            record = self._queue.known(job_id)
            state = apply_command(record, command)
            asked = JobCommand(command)
            text = _sentence(asked, reason, operator_name)
            _log.info("job %s: %s", job_id, text)
            if asked is JobCommand.CLEAR:
                return self._store.clear(job_id, text)
            active = self._queue.active
            if active is not None and active.job.job_id == job_id:
                return self._command_active(record, asked, text)
            if asked is JobCommand.START:
                self._check_start(record.job)
            return self._command_waiting(record, state, asked, text)

    def _check_start(self, job: Job) -> None:
        self._admission.check_calibration(job)
        if self._queue.would_begin(job):
            self._admission.check_ready()

    def _command_waiting(
        self, record: JobRecord, state: JobState, asked: JobCommand, text: str
    ) -> JobRecord:
        aborted = state is JobState.ABORTED
        changed = replace(
            record,
            state=state,
            error_code=self._settings.aborted_code if aborted else 1,
            error=text if aborted else "",
            # As in job control: what was cancelled is in the list no more.
            cleared=asked is JobCommand.CANCEL,
        )
        self._on_change(self._store.update(changed, text))
        self._queue.run_next()
        return self._store.get(record.job.job_id)

    def _command_active(self, record: JobRecord, asked: JobCommand, text: str) -> JobRecord:
        if asked is JobCommand.ABORT:
            self._abort(text)
        else:
            self._queue.control.ask(Request(_EVENTS[asked], message=text))
        return record

    def _abort(self, text: str) -> None:
        """Who aborts a job because a node has died is told so by the node's name and code."""
        dead = self._dead_node()
        if dead is None:
            self._queue.control.abort(self._settings.aborted_code, text)
        else:
            self._queue.control.abort(NODE_LOST, f"node {dead} was lost; {text}", dead)


def _sentence(command: JobCommand, reason: str, operator_name: str) -> str:
    text = f"the command {command.name} was given"
    text += f" by {operator_name}" if operator_name else ""
    return f"{text}: {reason}" if reason else text
