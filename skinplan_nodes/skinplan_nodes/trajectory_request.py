"""What a request for trajectories asks: one station, or all stations of a plan."""

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from numpy.typing import NDArray
from skinplan_msgs.srv import PlanTrajectories

from skinplan.errors import InputError, ScanPathInvalidError
from skinplan.stations.model import StationPlan
from skinplan.transforms import Array
from skinplan_nodes.conversions import (
    pose_stamped_from_msg,
    start_from_msg,
    station_plan_from_msg,
)


@dataclass(frozen=True, eq=False)
class StationRequest:
    """One station.

    Attributes:
        station_id: Its number.
        points: Indices of the points to scan, shape (p,).
        T_arm_base_workpiece: Part in the arm base, shape (4, 4) [m].
        start: Joint positions to start from, shape (6,) [rad]; None = home.
        T_map_workpiece: Part in the shop, shape (4, 4) [m]; None = as in the part file.
        T_map_tracker: Tracker in the shop, shape (4, 4) [m]; None = the cell's.
    """

    station_id: int
    points: NDArray[np.int64]
    T_arm_base_workpiece: Array
    start: Array | None
    T_map_workpiece: Array | None
    T_map_tracker: Array | None


@dataclass(frozen=True, eq=False)
class StationsRequest:
    """All stations of a plan, the base at its nominal poses.

    Attributes:
        plan: The stations.
        T_map_workpiece: Part in the shop, shape (4, 4) [m].
    """

    plan: StationPlan
    T_map_workpiece: Array


def described(request: PlanTrajectories.Request) -> str:
    """Says in a few words what is asked for."""
    if request.stations.stations:
        return f"planning {len(request.stations.stations)} stations"
    return f"planning station {request.station_id}"


def requested_stations(request: PlanTrajectories.Request) -> StationRequest | StationsRequest:
    """Takes a request apart; its part and path are not looked at but for the number of points.

    Raises:
        InputError: A pose in another frame or none at all, station numbers that are not different,
            or fields that say something about one station when all are asked for.
        ScanPathInvalidError: Points that are none of the path's, or not each once.
        JointsInvalidError: Joints that do not fit the arm.
    """
    return _all(request) if request.stations.stations else _one(request)


def _one(request: PlanTrajectories.Request) -> StationRequest:
    what = f"station {request.station_id}"
    found = StationRequest(
        station_id=request.station_id,
        T_arm_base_workpiece=pose_stamped_from_msg(
            request.pose, "arm_base", "pose of the workpiece for one station"
        ),
        start=start_from_msg(request.start),
        T_map_workpiece=_in_map(request.map_pose, "map_pose"),
        T_map_tracker=_in_map(request.tracker, "tracker"),
        points=_points(what, request.points, len(request.path.points)),
    )
    if len(found.points) == 0:
        raise ScanPathInvalidError(
            f"{what}: 0 points were asked for; at least 1 is accepted, or stations to plan all of"
        )
    return found


def _all(request: PlanTrajectories.Request) -> StationsRequest:
    given = {
        "station_id": request.station_id != 0,
        "points": len(request.points) > 0,
        "start": bool(request.start.name or len(request.start.position)),
        "tracker": request.tracker.header.frame_id != "",
        "map_pose": request.map_pose.header.frame_id != "",
    }
    wrong = [name for name, is_given in given.items() if is_given]
    if wrong:
        raise InputError(
            f"all of {len(request.stations.stations)} stations were asked for; {', '.join(given)} "
            f"must be left empty then, found {', '.join(wrong)}"
        )
    T_map_workpiece = pose_stamped_from_msg(
        request.pose, "map", "pose of the workpiece for all stations"
    )
    plan = station_plan_from_msg(request.stations)
    _require_different_stations(plan)
    for station in plan.stations:
        _points(f"station {station.id}", station.points, len(request.path.points))
    every = np.concatenate([station.points for station in plan.stations])
    found, times = np.unique(every, return_counts=True)
    if (times > 1).any():
        raise ScanPathInvalidError(
            f"stations: every point at one station is accepted, point {found[times > 1][0]} is at "
            f"{times.max()} of them"
        )
    return StationsRequest(plan, T_map_workpiece)


def _require_different_stations(plan: StationPlan) -> None:
    number, times = Counter(station.id for station in plan.stations).most_common(1)[0]
    if times > 1:
        raise InputError(
            f"stations: every id once is accepted, {number} is the id of {times} of them"
        )


def _points(what: str, points: Any, count: int) -> NDArray[np.int64]:
    found = np.array(points, dtype=np.int64)
    if len(found) and (found.max() >= count or len(np.unique(found)) < len(found)):
        raise ScanPathInvalidError(
            f"{what}: indices of the path's {count} points, each once, are accepted, found "
            f"{len(found)} up to {found.max()}"
        )
    return found


def _in_map(msg: PoseStamped, what: str) -> Array | None:
    """Returns a pose that may be left out: without a frame."""
    return pose_stamped_from_msg(msg, "map", what) if msg.header.frame_id else None
