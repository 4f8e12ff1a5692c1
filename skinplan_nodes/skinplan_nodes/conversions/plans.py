"""Stations and trajectories."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from geometry_msgs.msg import Pose, Quaternion
from skinplan_msgs import msg as messages

from skinplan.errors import InputError
from skinplan.plan_record import station_hash, trajectory_hash
from skinplan.stations.model import SkippedPoint, Station, StationPlan
from skinplan.trajectory.model import SCAN, TRANSIT, Segment, StationTrajectory
from skinplan.transforms import Array
from skinplan_nodes.conversions.geometry import (
    header_to_msg,
    pose_from_msg,
    pose_to_msg,
    require_frame,
)
from skinplan_nodes.conversions.joints import joint_trajectory_from_msg, joint_trajectory_to_msg

# Times of a trajectory travel in whole nanoseconds, those of its points as they are.
_TIME_TOLERANCE_S = 1e-6


@dataclass(frozen=True)
class PlanTimes:
    """Estimates that travel with the trajectories.

    Attributes:
        base_s: Base moves, settling and localisation [s].
        lower_bound_s: Swept length divided by the TCP speed limit [s].
    """

    base_s: float = float("nan")
    lower_bound_s: float = float("nan")


def station_to_msg(station: Station) -> messages.Station:
    """Converts a station."""
    return messages.Station(
        id=station.id, pose=pose_to_msg(station.T_map_base_link), points=station.points.tolist()
    )


def station_from_msg(msg: messages.Station) -> Station:
    """Returns a station.

    Raises:
        InputError: Its pose is none.
    """
    return Station(msg.id, pose_from_msg(msg.pose), np.array(msg.points, dtype=np.int64))


def skipped_to_msg(skipped: Sequence[SkippedPoint]) -> list[messages.SkippedPoint]:
    """Converts points that are left out."""
    return [messages.SkippedPoint(point=int(item.point), reason=item.reason) for item in skipped]


def skipped_from_msg(items: Sequence[messages.SkippedPoint]) -> tuple[SkippedPoint, ...]:
    """Returns points that are left out."""
    return tuple(SkippedPoint(item.point, item.reason) for item in items)


def station_plan_to_msg(plan: StationPlan, stamp_s: float = 0.0) -> messages.StationPlan:
    """Converts a station plan; its hash is made here."""
    return messages.StationPlan(
        header=header_to_msg("map", stamp_s),
        strategy=plan.strategy,
        stations=[station_to_msg(station) for station in plan.stations],
        candidates=plan.candidates,
        lower_bound=plan.lower_bound,
        proven_optimal=bool(plan.proven_optimal),
        reached_ratio=float(plan.reached_ratio),
        robust_ratio=float(plan.robust_ratio),
        marker_quality=float(plan.marker_quality),
        tracker=_tracker_to_msg(plan.T_map_tracker),
        skipped=skipped_to_msg(plan.skipped),
        plan_hash=station_hash(plan),
    )


def _tracker_to_msg(T_map_tracker: Array | None) -> Pose:
    if T_map_tracker is None:
        return Pose(orientation=Quaternion(w=0.0))
    return pose_to_msg(T_map_tracker)


def _tracker_from_msg(pose: Pose) -> Array | None:
    turn = pose.orientation
    known = any((turn.x, turn.y, turn.z, turn.w))
    return pose_from_msg(pose) if known else None


def station_plan_from_msg(msg: messages.StationPlan) -> StationPlan:
    """Returns a station plan.

    Raises:
        InputError: Another frame than map, or a pose that is none.
    """
    require_frame(msg.header, "map", "station plan")
    return StationPlan(
        strategy=msg.strategy,
        stations=tuple(station_from_msg(station) for station in msg.stations),
        candidates=msg.candidates,
        lower_bound=msg.lower_bound,
        proven_optimal=msg.proven_optimal,
        reached_ratio=msg.reached_ratio,
        robust_ratio=msg.robust_ratio,
        marker_quality=msg.marker_quality,
        T_map_tracker=_tracker_from_msg(msg.tracker),
        skipped=skipped_from_msg(msg.skipped),
    )


def segment_to_msg(segment: Segment) -> messages.TrajectorySegment:
    """Converts a piece of motion."""
    return messages.TrajectorySegment(
        kind=segment.kind,
        trajectory=joint_trajectory_to_msg(segment.times, segment.positions, segment.velocities),
        points=segment.points.tolist(),
        point_times=np.asarray(segment.point_s, dtype=float).tolist(),
        tcp_path=float(segment.tcp_path_m),
    )


def segment_from_msg(msg: messages.TrajectorySegment) -> Segment:
    """Returns a piece of motion.

    Raises:
        JointsInvalidError: Joints that do not fit the arm.
        InputError: An unknown kind, or times of the points that are none: another number than of
            points, not finite, falling, or outside the segment.
    """
    if msg.kind not in (TRANSIT, SCAN):
        raise InputError(f"segment: the kinds {TRANSIT} and {SCAN} are accepted, found {msg.kind}")
    times, positions, velocities = joint_trajectory_from_msg(msg.trajectory)
    points = np.array(msg.points, dtype=np.int64)
    point_s = _point_times(msg, float(times[-1]) if len(times) else 0.0)
    return Segment(msg.kind, times, positions, velocities, points, msg.tcp_path, point_s)


def _point_times(msg: messages.TrajectorySegment, duration_s: float) -> Array:
    found = np.array(msg.point_times, dtype=float)
    if len(found) != len(msg.points):
        raise InputError(
            f"segment: as many point_times as points are accepted, found {len(found)} for "
            f"{len(msg.points)} points"
        )
    good = (found >= -_TIME_TOLERANCE_S) & (found <= duration_s + _TIME_TOLERANCE_S)
    good[1:] &= found[1:] >= found[:-1]
    if not good.all():
        first = int(np.argmin(good))
        raise InputError(
            f"segment: point_times from 0 to its {duration_s:g} s that do not fall are accepted, "
            f"number {first} is {found[first]:g}"
        )
    return found


def station_trajectory_to_msg(trajectory: StationTrajectory) -> messages.StationTrajectory:
    """Converts what the arm does at one station."""
    return messages.StationTrajectory(
        station_id=trajectory.station_id,
        segments=[segment_to_msg(segment) for segment in trajectory.segments],
        skipped=skipped_to_msg(trajectory.skipped),
        scan_duration=float(trajectory.scan_s),
        transit_duration=float(trajectory.transit_s),
        breaks=trajectory.breaks,
        order=trajectory.order,
        order_cost=float(trajectory.order_cost),
        order_bound=float(trajectory.order_bound),
    )


def station_trajectory_from_msg(msg: messages.StationTrajectory) -> StationTrajectory:
    """Returns what the arm does at one station; errors as `segment_from_msg`."""
    return StationTrajectory(
        msg.station_id,
        tuple(segment_from_msg(segment) for segment in msg.segments),
        skipped_from_msg(msg.skipped),
        msg.order,
        msg.order_cost,
        msg.order_bound,
    )


def trajectory_plan_to_msg(
    trajectories: Sequence[StationTrajectory], times: PlanTimes | None = None, stamp_s: float = 0.0
) -> messages.TrajectoryPlan:
    """Converts the trajectories of several stations; their hash is made here."""
    known = times or PlanTimes()
    return messages.TrajectoryPlan(
        header=header_to_msg("arm_base", stamp_s),
        stations=[station_trajectory_to_msg(trajectory) for trajectory in trajectories],
        scan_duration=float(sum(t.scan_s for t in trajectories)),
        transit_duration=float(sum(t.transit_s for t in trajectories)),
        base_duration=known.base_s,
        lower_bound=known.lower_bound_s,
        plan_hash=trajectory_hash(trajectories),
    )


def trajectory_plan_from_msg(msg: messages.TrajectoryPlan) -> tuple[StationTrajectory, ...]:
    """Returns the trajectories of several stations.

    Raises:
        InputError: Another frame than arm_base; else as `segment_from_msg`.
    """
    require_frame(msg.header, "arm_base", "trajectory plan")
    return tuple(station_trajectory_from_msg(station) for station in msg.stations)
