"""A plan on record: its hash, its JSON files, and the figures of ``summary.json``."""

import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skinplan.json_file import plain as plain
from skinplan.json_file import write_json as write_json
from skinplan.scan_path.model import FEATURE, ScanPath
from skinplan.scanner.figures import seen_ratio
from skinplan.scanner.model import CoverageFigures
from skinplan.scanner.sight import SIGHT_NAMES
from skinplan.stations.model import SkippedPoint, StationPlan
from skinplan.trajectory.model import SCAN, StationTrajectory
from skinplan.trajectory.pass_record import passes_document, passes_summary
from skinplan.transforms import Array, heading, quaternion

if TYPE_CHECKING:
    # Who writes a hash into a message does not plan.
    from skinplan.trajectory.certify import TimedCoverage
    from skinplan.trajectory.cycle import CycleTime

# Hashes are taken over whole micrometres, microradians and microseconds: far below what a device
# can tell, far above rounding.
_HASH_STEP = 1e-6
_DECIMALS = 6


def scan_path_hash(path: ScanPath) -> str:
    """Returns the SHA-256 of a scan path's points, kinds and groups, lower-case hex."""
    digest = hashlib.sha256(path.strategy.encode())
    for array in (path.positions, path.directions, path.targets, path.kinds, path.groups):
        _update(digest, array)
    return digest.hexdigest()


def station_hash(plan: StationPlan) -> str:
    """Returns the SHA-256 of the stations' poses and points, and of what was asked of them."""
    digest = hashlib.sha256(plan.strategy.encode())
    if not math.isnan(plan.marker_quality):
        _update(digest, np.array([plan.marker_quality]))
    for station in plan.stations:
        _update(digest, station.T_map_base_link)
        _update(digest, station.points)
    return digest.hexdigest()


def trajectory_hash(trajectories: Iterable[StationTrajectory]) -> str:
    """Returns the SHA-256 of all segments' kinds, times and joint positions, lower-case hex.

    Times count as they are after a message carried them, in whole nanoseconds: the receiver finds
    the sender's hash.
    """
    digest = hashlib.sha256()
    for trajectory in trajectories:
        for segment in trajectory.segments:
            digest.update(bytes([segment.kind]))
            _update(digest, _whole_microseconds(segment.times))
            _update(digest, segment.positions)
    return digest.hexdigest()


def combined_hash(hashes: Sequence[str]) -> str:
    """Returns the SHA-256 over several hashes in their order, lower-case hex."""
    return hashlib.sha256("".join(hashes).encode()).hexdigest()


def planning_summary(
    *,
    triangles: int,
    area_m2: float,
    mesh_sha256: str,
    path: ScanPath,
    coverage: CoverageFigures | None,
    station_plan: StationPlan | None,
    trajectories: Sequence[StationTrajectory],
    cycle: "CycleTime | None",
    planning_s: Mapping[str, float],
    timed: "TimedCoverage | None" = None,
) -> dict[str, Any]:
    """Returns the planning part of ``summary.json``; the keys that a plan and a run share.

    Args:
        triangles: Triangles of the mesh.
        area_m2: Area of the mesh [m^2].
        mesh_sha256: Hash of the mesh file.
        path: Scan path.
        coverage: Predicted coverage; None = not asked, then its key is left out.
        station_plan: Stations; None as above.
        trajectories: Of all stations.
        cycle: Cycle time figures; None as above, and there is no ``plan_hash``.
        planning_s: Wall time of the stages mesh, scan_path, coverage, stations, trajectory [s].
        timed: What the trajectories see; None as above.

    Returns:
        A document of plain numbers, strings, lists and dicts; NaN is written as None.
    """
    document: dict[str, Any] = {
        "mesh": {"triangles": triangles, "area_m2": area_m2, "sha256": mesh_sha256},
        "scan_path": {
            "strategy": path.strategy,
            "points": len(path),
            "row_points": path.row_points,
            "feature_points": path.feature_points,
            "regions": path.regions,
            "lower_bound": path.lower_bound,
            "left_out": len(path.left_out),
            "hash": scan_path_hash(path),
            **passes_summary(path.passes),
        },
    }
    if coverage is not None:
        document["coverage"] = _coverage_summary(coverage)
    if station_plan is not None:
        document["stations"] = _stations_summary(station_plan)
    if station_plan is not None and cycle is not None:
        skipped = [*station_plan.skipped, *(s for t in trajectories for s in t.skipped)]
        document["trajectory"] = {
            **_cycle_summary(cycle, skipped),
            "order": _order_summary(trajectories),
        }
        if timed is not None:
            document["trajectory"]["coverage"] = _timed_summary(timed)
        document["plan_hash"] = combined_hash(
            [scan_path_hash(path), station_hash(station_plan), trajectory_hash(trajectories)]
        )
    document["planning_s"] = {**planning_s, "total": float(sum(planning_s.values()))}
    return plain(document)


def write_plan_files(
    folder: Path,
    path: ScanPath | None = None,
    station_plan: StationPlan | None = None,
    trajectories: Sequence[StationTrajectory] | None = None,
    joint_names: Sequence[str] = (),
    T_map_workpiece: Array | None = None,
    coverage: CoverageFigures | None = None,
) -> None:
    """Writes the JSON files of a plan: those whose parts are given.

    They are ``scan_path.json``, ``coverage.json``, ``stations.json`` and ``trajectories.json``.

    Args:
        folder: Created when it is missing.
        path: Scan path, workpiece frame.
        station_plan: Stations, map frame.
        trajectories: Joint trajectories of the stations.
        joint_names: Names of their joints, in the order of the columns.
        T_map_workpiece: Where the stations were planned for, shape (4, 4) [m].
        coverage: Predicted coverage.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if path is not None:
        write_json(folder / "scan_path.json", _path_document(path))
    if coverage is not None:
        write_json(folder / "coverage.json", _coverage_document(coverage))
    if station_plan is not None:
        write_json(folder / "stations.json", _stations_document(station_plan, T_map_workpiece))
    if trajectories is not None:
        write_json(folder / "trajectories.json", _trajectories_document(trajectories, joint_names))


def _whole_microseconds(times: Array) -> Any:
    return np.rint(np.rint(times * 1e9) / 1e3).astype(np.int64)


def _update(digest: Any, array: Any) -> None:
    values = np.asarray(array)
    if values.dtype.kind == "f":
        values = np.rint(values / _HASH_STEP)
    digest.update(np.ascontiguousarray(values, dtype="<i8").tobytes())


def _coverage_summary(coverage: CoverageFigures) -> dict[str, Any]:
    document: dict[str, Any] = {
        "area_ratio": coverage.area_ratio,
        "feature_area_ratio": coverage.feature_area_ratio,
        "rows_only_area_ratio": coverage.rows_only_area_ratio,
        "rows_only_feature_area_ratio": coverage.rows_only_feature_area_ratio,
    }
    if coverage.regions:
        whole = coverage.regions[0]
        document |= {
            "least_views": coverage.least_views,
            "often_seen_area_ratio": whole.often_seen_ratio,
            "seeable_area_ratio": whole.seeable_ratio,
            "area_ratio_of_seeable": whole.seen_of_seeable_ratio,
            "often_seen_area_ratio_of_seeable": whole.often_seen_of_seeable_ratio,
            "largest_axis_incidence_rad": whole.axis_rad[2],
            "area_ratio_within_ray_incidence": whole.ray_within_limit_ratio,
        }
    return document


def _stations_summary(plan: StationPlan) -> dict[str, Any]:
    return {
        "strategy": plan.strategy,
        "count": len(plan.stations),
        "candidates": plan.candidates,
        "lower_bound": plan.lower_bound,
        "proven_optimal": plan.proven_optimal,
        "reached_ratio": plan.reached_ratio,
        "robust_ratio": plan.robust_ratio,
        "marker_quality": plan.marker_quality,
        "tracker": None if plan.T_map_tracker is None else _pose_document(plan.T_map_tracker),
    }


def _cycle_summary(cycle: "CycleTime", skipped: Sequence[SkippedPoint]) -> dict[str, Any]:
    return {
        "scan_s": cycle.scan_s,
        "transit_s": cycle.transit_s,
        "base_s": cycle.base_s,
        "cycle_s": cycle.cycle_s,
        "lower_bound_s": cycle.lower_bound_s,
        "breaks": cycle.breaks,
        "tcp_path_m": cycle.tcp_path_m,
        "jerk_rad_s3": cycle.jerk_rad_s3,
        "stations": [asdict(station) for station in cycle.stations],
        "skipped": _skipped_document(skipped),
    }


def _timed_summary(timed: "TimedCoverage") -> dict[str, Any]:
    found = timed.coverage
    return {
        "area_ratio": found.area_ratio,
        "feature_area_ratio": found.feature_area_ratio,
        "area_ratio_of_seeable": found.area_ratio_of_seeable,
        "feature_area_ratio_of_seeable": found.feature_area_ratio_of_seeable,
        "often_seen_area_ratio": seen_ratio(
            found.samples,
            found.views,
            np.ones(len(found.views), dtype=bool),
            found.least_views,
        ),
        "frames": timed.frames,
        "frames_hidden": timed.hidden,
    }


def _order_summary(trajectories: Sequence[StationTrajectory]) -> dict[str, Any]:
    """Sums over the stations where a figure is known; the gap over those where both are."""
    names = {t.order: None for t in trajectories if t.order}
    both = [t for t in trajectories if math.isfinite(t.order_cost) and math.isfinite(t.order_bound)]
    return {
        "strategy": ", ".join(names) or None,
        "cost": _known_sum(t.order_cost for t in trajectories),
        "bound": _known_sum(t.order_bound for t in trajectories),
        "gap": _order_gap(sum(t.order_cost for t in both), sum(t.order_bound for t in both)),
    }


def _order_document(trajectory: StationTrajectory) -> dict[str, Any]:
    cost, bound = trajectory.order_cost, trajectory.order_bound
    return {
        "strategy": trajectory.order or None,
        "cost": cost,
        "bound": bound,
        "gap": _order_gap(cost, bound),
    }


def _known_sum(values: Iterable[float]) -> float | None:
    known = [value for value in values if math.isfinite(value)]
    return sum(known) if known else None


def _order_gap(cost: float, bound: float) -> float | None:
    return cost / bound - 1.0 if bound > 0.0 else None


def _skipped_document(skipped: Iterable[SkippedPoint]) -> list[dict[str, Any]]:
    return [{"point": int(s.point), "reason": s.reason} for s in skipped]


def _path_document(path: ScanPath) -> dict[str, Any]:
    rows = zip(path.positions, path.directions, path.targets, path.kinds, path.groups, strict=True)
    return {
        "frame": "workpiece",
        "strategy": path.strategy,
        "regions": path.regions,
        "hash": scan_path_hash(path),
        "lower_bound": path.lower_bound,
        **passes_document(path.passes),
        "left_out": [
            {"target": np.round(left.target, _DECIMALS), "reason": left.reason}
            for left in path.left_out
        ],
        "points": [
            {
                "position": np.round(position, _DECIMALS),
                "direction": np.round(direction, _DECIMALS),
                "target": np.round(target, _DECIMALS),
                "kind": "feature" if kind == FEATURE else "row",
                "group": group,
            }
            for position, direction, target, kind, group in rows
        ],
    }


def _coverage_document(coverage: CoverageFigures) -> dict[str, Any]:
    regions = []
    for region in coverage.regions:
        document = asdict(region)
        areas = document.pop("areas_m2")
        regions.append({**document, "area_by_state_m2": dict(zip(SIGHT_NAMES, areas, strict=True))})
    return {**_coverage_summary(coverage), "regions": regions}


def _stations_document(plan: StationPlan, T_map_workpiece: Array | None) -> dict[str, Any]:
    place = {}
    if T_map_workpiece is not None:
        place = {"workpiece": _pose_document(T_map_workpiece)}
    return {
        "frame": "map",
        **_stations_summary(plan),
        "hash": station_hash(plan),
        **place,
        "stations": [
            {
                "id": station.id,
                "pose": {
                    "x_m": station.T_map_base_link[0, 3],
                    "y_m": station.T_map_base_link[1, 3],
                    "heading_rad": heading(station.T_map_base_link),
                },
                "points": station.points,
            }
            for station in plan.stations
        ],
        "skipped": _skipped_document(plan.skipped),
    }


def _pose_document(T: Array) -> dict[str, Any]:
    return {"position_m": T[:3, 3], "quaternion": quaternion(T)}


def _trajectories_document(
    trajectories: Sequence[StationTrajectory], joint_names: Sequence[str]
) -> dict[str, Any]:
    return {
        "frame": "arm_base",
        "hash": trajectory_hash(trajectories),
        "joint_names": list(joint_names),
        "stations": [
            {
                "station": trajectory.station_id,
                "order": _order_document(trajectory),
                "segments": [
                    {
                        "kind": "scan" if segment.kind == SCAN else "transit",
                        "duration_s": segment.duration_s,
                        "tcp_path_m": segment.tcp_path_m,
                        "points": segment.points,
                        "times_s": np.round(segment.times, _DECIMALS),
                        "positions_rad": np.round(segment.positions, _DECIMALS),
                    }
                    for segment in trajectory.segments
                ],
                "skipped": _skipped_document(trajectory.skipped),
            }
            for trajectory in trajectories
        ],
    }
