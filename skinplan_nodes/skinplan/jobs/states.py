"""Which state follows on which: ISA-95 job control as OPC 10031-4 has it.

======================= ===========================================================
command                 effect
======================= ===========================================================
START                   NotAllowedToStart -> AllowedToStart
PAUSE                   Running -> Interrupted
RESUME                  Interrupted -> Running
STOP                    Running, Interrupted -> Ended (at once; what was measured is kept)
ABORT                   everything that is not over -> Aborted
CANCEL                  NotAllowedToStart, AllowedToStart -> Aborted (never began)
CLEAR                   Ended, Aborted: the job is forgotten, the state stays
======================= ===========================================================

The cell itself makes AllowedToStart -> Running when it takes the job, Running -> Interrupted and
back when a failure can be overcome, and Running -> Ended or Aborted at its end.
"""

from skinplan.errors import JobCommandError
from skinplan.jobs.model import JobCommand, JobRecord, JobState

_NOT_ALLOWED = JobState.NOT_ALLOWED_TO_START
_ALLOWED = JobState.ALLOWED_TO_START

COMMANDS: dict[JobCommand, dict[JobState, JobState]] = {
    JobCommand.START: {_NOT_ALLOWED: _ALLOWED},
    JobCommand.PAUSE: {JobState.RUNNING: JobState.INTERRUPTED},
    JobCommand.RESUME: {JobState.INTERRUPTED: JobState.RUNNING},
    JobCommand.STOP: {JobState.RUNNING: JobState.ENDED, JobState.INTERRUPTED: JobState.ENDED},
    JobCommand.ABORT: {
        _NOT_ALLOWED: JobState.ABORTED,
        _ALLOWED: JobState.ABORTED,
        JobState.RUNNING: JobState.ABORTED,
        JobState.INTERRUPTED: JobState.ABORTED,
    },
    JobCommand.CANCEL: {_NOT_ALLOWED: JobState.ABORTED, _ALLOWED: JobState.ABORTED},
    JobCommand.CLEAR: {JobState.ENDED: JobState.ENDED, JobState.ABORTED: JobState.ABORTED},
}

TRANSITIONS: dict[JobState, frozenset[JobState]] = {
    _NOT_ALLOWED: frozenset({_ALLOWED, JobState.ABORTED}),
    _ALLOWED: frozenset({_NOT_ALLOWED, JobState.RUNNING, JobState.ABORTED}),
    JobState.RUNNING: frozenset({JobState.INTERRUPTED, JobState.ENDED, JobState.ABORTED}),
    JobState.INTERRUPTED: frozenset({JobState.RUNNING, JobState.ENDED, JobState.ABORTED}),
    JobState.ENDED: frozenset(),
    JobState.ABORTED: frozenset(),
}


def is_over(state: JobState) -> bool:
    """Whether nothing follows on the state."""
    return not TRANSITIONS[state]


def apply_command(record: JobRecord, command: JobCommand | int) -> JobState:
    """Returns the state that a command leads to.

    Args:
        record: The job as it is.
        command: The command.

    Returns:
        The new state. CLEAR gives the same state: the caller removes the job.

    Raises:
        JobCommandError: No such command, or not in this state.
    """
    try:
        asked = JobCommand(command)
    except ValueError as error:
        names = ", ".join(f"{c.name} ({c.value})" for c in JobCommand)
        raise JobCommandError(f"command {command} was asked for; accepted are {names}") from error
    allowed = COMMANDS[asked]
    if record.state not in allowed:
        raise JobCommandError(
            f"{asked.name} was asked for job {record.job.job_id}, which is {record.state.title}; "
            f"accepted in {', '.join(state.title for state in allowed)}"
        )
    return allowed[record.state]


def check_transition(job_id: str, before: JobState, after: JobState) -> None:
    """Lets only transitions through that job control knows; no change is one of them.

    Raises:
        JobCommandError: There is no such transition.
    """
    if after != before and after not in TRANSITIONS[before]:
        follows = (
            ", ".join(sorted(state.title for state in TRANSITIONS[before])) or "nothing: it is over"
        )
        raise JobCommandError(
            f"job {job_id} was to go from {before.title} to {after.title}; on {before.title} "
            f"follows {follows}"
        )
