"""How much of a job is done in each of its states. Needs no ROS."""

from skinplan_nodes.supervisor.machine import State
from skinplan_nodes.supervisor.progress import Progress
from skinplan_nodes.supervisor.steps import Steps

_STATIONS_BEGIN, _STATIONS_SHARE = 0.12, 0.82
_FIRST = {
    State.STARTING: 0.0,
    State.DRIVING: 0.01,
    State.LOCALIZING: 0.03,
    State.PLANNING_PATH: 0.06,
    State.PLANNING_STATIONS: 0.09,
    State.INSPECTING: 0.94,
    State.FINISHING: 0.96,
    State.CLOSING: 0.98,
}
# Shares of a station's time that are over when a state begins there.
_AT_STATION = {State.DRIVING: 0.0, State.LOCALIZING: 0.06, State.PLANNING_TRAJECTORY: 0.12}
_MOTION_BEGIN = 0.2


def share_of(state: State, progress: Progress, steps: Steps) -> Progress:
    """Returns the progress at the begin of a state, with share and time left."""
    place = steps.place
    count = 0 if place.plan is None else len(place.plan.stations)
    if not count or place.rescan or state not in (*_AT_STATION, State.MOVING, State.SCANNING):
        return progress.reached(_FIRST.get(state, progress.share))
    begin = _STATIONS_BEGIN + _STATIONS_SHARE * (place.station - 1) / count
    share = _STATIONS_SHARE / count
    if state in _AT_STATION:
        return progress.reached(begin + _AT_STATION[state] * share)
    segments = () if place.trajectory is None else place.trajectory.segments
    total_s = max(sum(segment.duration_s for segment in segments), 1e-9)
    done_s = sum(segment.duration_s for segment in segments[: place.segment])
    part = _MOTION_BEGIN + (1.0 - _MOTION_BEGIN) * done_s / total_s
    return progress.reached(begin + part * share).left(total_s - done_s)
