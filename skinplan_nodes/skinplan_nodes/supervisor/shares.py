"""How much of a job is done in each of its states. Needs no ROS."""

from dataclasses import replace

from skinplan_nodes.supervisor.machine import State
from skinplan_nodes.supervisor.progress import Progress
from skinplan_nodes.supervisor.steps import Steps

_STATIONS_BEGIN, _STATIONS_SHARE = 0.12, 0.82
_FIRST = {
    State.STARTING: 0.0,
    State.DRIVING: 0.01,
    State.IDENTIFYING: 0.02,
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
# Numbers of the steps: those before the stations, then so many at each station, then the rest.
_STEPS = {
    State.STARTING: 1,
    State.DRIVING: 2,
    State.IDENTIFYING: 3,
    State.LOCALIZING: 3,
    State.PLANNING_PATH: 4,
    State.PLANNING_STATIONS: 5,
}
_STEPS_AT_STATION = {
    State.DRIVING: 1,
    State.LOCALIZING: 2,
    State.PLANNING_TRAJECTORY: 3,
    State.MOVING: 4,
    State.SCANNING: 4,
}
_STEPS_AFTER = {State.INSPECTING: 1, State.FINISHING: 1, State.CLOSING: 2, State.ABORTING: 2}


def share_of(state: State, progress: Progress, steps: Steps) -> Progress:
    """Returns the progress at the begin of a state, with share and time left."""
    place = steps.place
    if state is State.PLANNING_PATH and place.rescan > progress.rescan:
        progress = _scanned_again(progress, place.rescan)
    progress = _numbered(state, progress, place.plan is not None)
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


def _numbered(state: State, progress: Progress, planned: bool) -> Progress:
    """Returns the progress with the number of its step; a job that stands still keeps it."""
    before, count = max(_STEPS.values()), max(progress.station_count, 1)
    at_stations = max(_STEPS_AT_STATION.values())
    total = before + at_stations * count + max(_STEPS_AFTER.values())
    if state in _STEPS_AFTER:
        done = progress if state is State.ABORTING else replace(progress, time_left_s=0.0)
        return done.at_step(before + at_stations * count + _STEPS_AFTER[state], total)
    if planned and state in _STEPS_AT_STATION and progress.station:
        stations = at_stations * (progress.station - 1)
        return progress.at_step(before + stations + _STEPS_AT_STATION[state], total)
    return progress.at_step(_STEPS[state], total) if state in _STEPS else progress


def _scanned_again(progress: Progress, rescan: int) -> Progress:
    """Returns the progress at the begin of a re-scan: its steps follow on the last inspection."""
    steps = max(_STEPS_AT_STATION.values()) * max(progress.station_count, 1)
    more = max(_STEPS.values()) + steps + _STEPS_AFTER[State.INSPECTING]
    before = progress.steps_before + more + 1 - _STEPS[State.PLANNING_PATH]
    return replace(progress, rescan=rescan, station_count=0, later_s=(), steps_before=before)
