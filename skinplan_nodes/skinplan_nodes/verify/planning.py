"""Verifies the planners: the recorded requests again, the recorded answers beside the new ones."""

from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import PoseStamped
from skinplan_msgs.msg import PartReference, Status
from skinplan_msgs.srv import PlanScanPath, PlanStations, PlanTrajectories

from skinplan_nodes.conversions import pose_stamped_to_msg, transform_stamped_from_msg
from skinplan_nodes.verify.bench import VerifyBench
from skinplan_nodes.verify.compare import (
    StageResult,
    scan_path_differences,
    station_differences,
    trajectory_differences,
)
from skinplan_nodes.verify.recorded import RecordedRun

_TIMEOUT_S = 600.0


def verify_scan_path(bench: VerifyBench, run: RecordedRun, part: PartReference) -> StageResult:
    """Plans the scan path again."""
    result = StageResult("scan_path")
    plans = run.all("scan_path")
    if not plans:
        result.notes.append("no scan path was recorded")
        return result
    if len(plans) > 1:
        result.notes.append(
            f"{len(plans) - 1} further scan paths are of re-scans, whose clouds a bag does not have"
        )
    request = PlanScanPath.Request(part=part)
    answer = _asked(bench, result, PlanScanPath, "plan_scan_path", request)
    if answer is not None:
        result.compared += 1
        result.differences += scan_path_differences(plans[0].message, answer.path)
    return result


def verify_stations(bench: VerifyBench, run: RecordedRun, part: PartReference) -> StageResult:
    """Chooses the stations again, for the recorded scan path and place of the part."""
    result = StageResult("stations")
    for plan in run.all("station_plan")[:1]:
        pose = _map_pose(run, plan.at_ns)
        path = run.last("scan_path", plan.at_ns)
        if pose is None or path is None:
            result.notes.append("no scan path or place of the part was recorded before the plan")
            continue
        request = PlanStations.Request(part=part, path=path, pose=pose)
        answer = _asked(bench, result, PlanStations, "plan_stations", request)
        if answer is not None:
            result.compared += 1
            result.differences += station_differences(plan.message, answer.plan)
    if not run.all("station_plan"):
        result.notes.append("no stations were recorded")
    return result


def verify_trajectories(
    bench: VerifyBench,
    run: RecordedRun,
    part: PartReference,
    progress: Callable[[str], None],
) -> StageResult:
    """Makes the arm's motion again, station by station, from where it stood."""
    result = StageResult("trajectory")
    for at_ns, trajectory in run.planned_stations():
        progress(f"trajectory of station {trajectory.station_id}")
        request = _trajectory_request(run, part, at_ns, trajectory)
        if request is None:
            result.notes.append(
                f"station {trajectory.station_id}: its inputs were not recorded completely"
            )
            continue
        answer = _asked(bench, result, PlanTrajectories, "plan_trajectories", request)
        if answer is not None:
            result.compared += 1
            result.differences += trajectory_differences(trajectory, answer.trajectory)
    if not run.all("trajectory_plan"):
        result.notes.append("no trajectories were recorded")
    return result


def _trajectory_request(
    run: RecordedRun, part: PartReference, at_ns: int, trajectory: Any
) -> PlanTrajectories.Request | None:
    path, plan = run.last("scan_path", at_ns), run.last("station_plan", at_ns)
    pose, stations = run.last("part_pose", at_ns), run.all("station_plan")
    if path is None or plan is None or pose is None:
        return None
    planned_ns = max(item.at_ns for item in stations if item.at_ns <= at_ns)
    map_pose = _map_pose(run, planned_ns)
    points = {p for segment in trajectory.segments for p in segment.points}
    points |= {item.point for item in trajectory.skipped}
    request = PlanTrajectories.Request(
        part=part,
        path=path,
        station_id=trajectory.station_id,
        pose=PoseStamped(header=pose.header, pose=pose.pose.pose),
        points=sorted(points),
        start=run.joint_state(at_ns),
        map_pose=map_pose or PoseStamped(),
    )
    # All zero: no place of the tracker is known.
    if any((plan.tracker.orientation.x, plan.tracker.orientation.y, plan.tracker.orientation.z,
            plan.tracker.orientation.w)):  # fmt: skip
        request.tracker = PoseStamped(header=plan.header, pose=plan.tracker)
    return request


def _map_pose(run: RecordedRun, at_ns: int) -> PoseStamped | None:
    """Returns the part in the shop as the localiser told it on ``tf``."""
    found = run.transform("map", "workpiece", at_ns)
    if found is None:
        return None
    T_map_workpiece = transform_stamped_from_msg(found)[2]
    return pose_stamped_to_msg(T_map_workpiece, "map")


def _asked(bench: VerifyBench, result: StageResult, kind: Any, name: str, request: Any) -> Any:
    """Calls a planner; a refusal is a difference."""
    answer = bench.call(kind, name, request, _TIMEOUT_S)
    if answer.status.code != Status.OK:
        result.compared += 1
        result.differences.append(
            f"{result.name}: was planned then, is refused now: {answer.status.message}"
        )
        return None
    return answer
