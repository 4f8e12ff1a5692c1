"""The states of a job on the cell, as one table. Needs no ROS.

`TABLE` says which state follows on which for every event, `LIMITS` how long a state may last at
most. The job's thread walks along it (`mission`), the diagram in ``docs/supervisor.md`` is drawn
from it (`diagram`), and a test asks it for completeness: every state has a time-out, every failure
leads somewhere, and from everywhere a job can come to its end.
"""

from collections.abc import Iterable
from enum import StrEnum

from skinplan.jobs.model import JobState


class State(StrEnum):
    """Where a job is; the value stands in the journal and in the diagram."""

    STARTING = "starting"
    DRIVING = "driving"
    IDENTIFYING = "identifying"
    LOCALIZING = "localizing"
    PLANNING_PATH = "planning_path"
    PLANNING_STATIONS = "planning_stations"
    PLANNING_TRAJECTORY = "planning_trajectory"
    MOVING = "moving"
    SCANNING = "scanning"
    INSPECTING = "inspecting"
    FINISHING = "finishing"
    STOPPING = "stopping"
    PAUSED = "paused"
    WAITING = "waiting"
    RECOVERING = "recovering"
    RESTORING = "restoring"
    CLOSING = "closing"
    ABORTING = "aborting"
    ENDED = "ended"
    ABORTED = "aborted"


class Event(StrEnum):
    """What leads from state to state."""

    # A step came to its end.
    DONE = "done"
    MOVE = "move"
    SCAN = "scan"
    NEXT_STATION = "next station"
    ALL_SCANNED = "all scanned"
    AT_STATION = "at a station"
    TO_BE_CHECKED = "part to be checked"
    MISSING = "area missing"
    COMPLETE = "complete"
    # Where a stopped job waits.
    HELD_PAUSED = "paused"
    HELD_OPERATOR = "operator has to look"
    HELD_AUTOMATIC = "recovers by itself"
    HELD_STOP = "stopped for good"
    # Where a restored job goes on.
    AGAIN_START = "back to start"
    AGAIN_DRIVE = "back to drive"
    AGAIN_LOCALIZE = "back to localize"
    AGAIN_IDENTIFY = "back to identify"
    AGAIN_PATH = "back to path"
    AGAIN_STATIONS = "back to stations"
    AGAIN_TRAJECTORY = "back to trajectory"
    AGAIN_INSPECT = "back to inspect"
    AGAIN_FINISH = "back to finish"
    # Failures and commands.
    FAULT = "fault"
    NODE_LOST = "node lost"
    TIMED_OUT = "timed out"
    FAILED = "failed"
    PAUSE = "pause"
    RESUME = "resume"
    STOP = "stop"
    ABORT = "abort"


#: What may happen in any state, at any moment; every state has an answer to each of them.
FAILURES = (
    Event.FAULT,
    Event.NODE_LOST,
    Event.TIMED_OUT,
    Event.FAILED,
    Event.PAUSE,
    Event.STOP,
    Event.ABORT,
)
#: Nothing follows on these.
FINAL = (State.ENDED, State.ABORTED)
#: In these the devices work, or could.
WORKING = (
    State.STARTING,
    State.DRIVING,
    State.IDENTIFYING,
    State.LOCALIZING,
    State.PLANNING_PATH,
    State.PLANNING_STATIONS,
    State.PLANNING_TRAJECTORY,
    State.MOVING,
    State.SCANNING,
    State.INSPECTING,
    State.FINISHING,
    State.RESTORING,
)
#: In these a job is Interrupted (ISA-95).
INTERRUPTED = (State.STOPPING, State.PAUSED, State.WAITING, State.RECOVERING)

_STOPS = (Event.FAULT, Event.NODE_LOST, Event.TIMED_OUT, Event.PAUSE, Event.STOP)
_ENDS = (Event.FAILED, Event.ABORT)

Table = dict[tuple[State, Event], State]


def _on(state: State, **following: State) -> Table:
    return {(state, Event[name]): after for name, after in following.items()}


def _always(state: State, events: Iterable[Event], after: State) -> Table:
    return {(state, event): after for event in events}


def _table() -> Table:
    found: Table = {}
    for state in WORKING:
        found |= _always(state, _STOPS, State.STOPPING) | _always(state, _ENDS, State.ABORTING)
    next_segment = {"MOVE": State.MOVING, "SCAN": State.SCANNING}
    after_station = {"NEXT_STATION": State.DRIVING, "ALL_SCANNED": State.INSPECTING}
    for state in (State.PLANNING_TRAJECTORY, State.MOVING, State.SCANNING):
        found |= _on(state, **next_segment, **after_station)
    return (
        found
        | _on(State.STARTING, DONE=State.DRIVING)
        | _on(State.DRIVING, DONE=State.LOCALIZING, TO_BE_CHECKED=State.IDENTIFYING)
        | _on(State.IDENTIFYING, DONE=State.LOCALIZING)
        | _on(State.LOCALIZING, DONE=State.PLANNING_PATH, AT_STATION=State.PLANNING_TRAJECTORY)
        | _on(State.PLANNING_PATH, DONE=State.PLANNING_STATIONS, COMPLETE=State.FINISHING)
        | _on(State.PLANNING_STATIONS, DONE=State.DRIVING, COMPLETE=State.FINISHING)
        | _on(State.INSPECTING, MISSING=State.PLANNING_PATH, COMPLETE=State.FINISHING)
        # The result is asked for: a stop changes nothing about it.
        | _on(State.FINISHING, DONE=State.CLOSING, STOP=State.FINISHING)
        | _restoring()
        | _held()
        | _ending()
    )


def _restoring() -> Table:
    return _on(
        State.RESTORING,
        AGAIN_START=State.STARTING,
        AGAIN_DRIVE=State.DRIVING,
        AGAIN_LOCALIZE=State.LOCALIZING,
        AGAIN_IDENTIFY=State.IDENTIFYING,
        AGAIN_PATH=State.PLANNING_PATH,
        AGAIN_STATIONS=State.PLANNING_STATIONS,
        AGAIN_TRAJECTORY=State.PLANNING_TRAJECTORY,
        MOVE=State.MOVING,
        SCAN=State.SCANNING,
        # The stop came behind the last point of the way.
        NEXT_STATION=State.DRIVING,
        ALL_SCANNED=State.INSPECTING,
        AGAIN_INSPECT=State.INSPECTING,
        AGAIN_FINISH=State.FINISHING,
    )


def _held() -> Table:
    """The states of a job that stands still and is not over."""
    found = _on(
        State.STOPPING,
        HELD_PAUSED=State.PAUSED,
        HELD_OPERATOR=State.WAITING,
        HELD_AUTOMATIC=State.RECOVERING,
        HELD_STOP=State.FINISHING,
    )
    merged = (Event.FAULT, Event.NODE_LOST, Event.PAUSE, Event.STOP)
    found |= _always(State.STOPPING, merged, State.STOPPING)
    for state in (State.PAUSED, State.WAITING):
        found |= _always(state, (Event.FAULT, Event.NODE_LOST, Event.PAUSE), state)
    found |= _on(State.RECOVERING, DONE=State.RESTORING, PAUSE=State.PAUSED)
    found |= _on(State.RECOVERING, FAULT=State.STOPPING, NODE_LOST=State.RECOVERING)
    for state in (State.PAUSED, State.WAITING, State.RECOVERING):
        found |= _on(state, RESUME=State.RESTORING, STOP=State.FINISHING)
    for state in INTERRUPTED:
        found |= _always(state, (Event.TIMED_OUT, *_ENDS), State.ABORTING)
    return found


def _ending() -> Table:
    """Nothing moves any more; what fails here is noted and ends the job all the same."""
    found = _on(State.CLOSING, DONE=State.ENDED, TIMED_OUT=State.ENDED, FAILED=State.ENDED)
    found |= _on(State.CLOSING, ABORT=State.ABORTING)
    found |= _on(State.ABORTING, DONE=State.ABORTED, TIMED_OUT=State.ABORTED)
    found |= _on(State.ABORTING, FAILED=State.ABORTED, ABORT=State.ABORTING)
    ignored = (Event.FAULT, Event.NODE_LOST, Event.PAUSE, Event.STOP)
    for state in (State.CLOSING, State.ABORTING):
        found |= _always(state, ignored, state)
    return found


#: Which state follows on which.
TABLE: Table = _table()

#: How long each state may last: name of the figure in `Limits`, and whose clock it is on.
LIMITS: dict[State, tuple[str, str]] = {
    State.STARTING: ("starting_s", "wall"),
    State.DRIVING: ("driving_s", "cell"),
    State.IDENTIFYING: ("identifying_s", "wall"),
    State.LOCALIZING: ("localizing_s", "cell"),
    State.PLANNING_PATH: ("planning_s", "wall"),
    State.PLANNING_STATIONS: ("planning_s", "wall"),
    State.PLANNING_TRAJECTORY: ("planning_s", "wall"),
    State.MOVING: ("segment_s", "cell"),
    State.SCANNING: ("segment_s", "cell"),
    State.INSPECTING: ("inspecting_s", "wall"),
    State.FINISHING: ("inspecting_s", "wall"),
    State.STOPPING: ("stopping_s", "wall"),
    State.PAUSED: ("operator_s", "wall"),
    State.WAITING: ("operator_s", "wall"),
    State.RECOVERING: ("recovering_s", "wall"),
    State.RESTORING: ("restoring_s", "wall"),
    State.CLOSING: ("closing_s", "wall"),
    State.ABORTING: ("closing_s", "wall"),
}


def after(state: State, event: Event) -> State:
    """Returns the state that follows.

    Raises:
        KeyError: The table has no answer; the test of its completeness excludes that for failures.
    """
    return TABLE[state, event]


def ignored(state: State) -> frozenset[Event]:
    """Returns the failures and commands that change nothing about a state."""
    return frozenset(event for event in FAILURES if TABLE[state, event] is state)


def job_state(state: State) -> JobState:
    """Returns the ISA-95 state of a job in one of our states."""
    if state is State.ENDED:
        return JobState.ENDED
    if state is State.ABORTED:
        return JobState.ABORTED
    return JobState.INTERRUPTED if state in INTERRUPTED else JobState.RUNNING


def sub_state(state: State) -> str:
    """Returns the name that ``JobStatus.sub_state`` has for a state; empty when the job is over."""
    if state in FINAL:
        return ""
    if state is State.FINISHING:
        return State.INSPECTING.value
    return state.value.split("_", maxsplit=1)[0]
