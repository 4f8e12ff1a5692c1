"""From scan path points to timed joint trajectories at a station (M2.4)."""

import itertools
import logging
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import (
    NoTrajectoryError,
    ScanPathInvalidError,
    StartStateError,
)
from skinplan.mesh.model import SurfaceMesh
from skinplan.part.model import ScanSettings
from skinplan.robot.cell import CellConfig
from skinplan.robot.collision import CollisionWorld
from skinplan.robot.reach import Views, reach
from skinplan.scan_path.model import ScanPath
from skinplan.stations.model import SkippedPoint, StationPlan
from skinplan.strategies import chosen
from skinplan.trajectory.assemble import collision_edges, timed_segments
from skinplan.trajectory.model import Segment, StationTrajectory
from skinplan.trajectory.order import published_order
from skinplan.trajectory.search import Problem, Search, Way
from skinplan.trajectory.timing import Limits
from skinplan.trajectory.visit import VisitOrder, VisitTask
from skinplan.transforms import Array, apply, inverse, require_transform

_LOG = logging.getLogger(__name__)
_REPAIRS = 12

Order = Callable[[VisitTask], VisitOrder]
Progress = Callable[[float, str], None]

STRATEGIES: dict[str, Order] = {"published": published_order}


def plan_station_trajectory(
    path: ScanPath,
    points: NDArray[np.int64],
    T_arm_base_workpiece: Array,
    mesh: SurfaceMesh,
    settings: ScanSettings,
    cell: CellConfig,
    station_id: int = 0,
    start: Array | None = None,
    progress: Progress | None = None,
    is_cancelled: Callable[[], bool] | None = None,
    T_arm_base_map: Array | None = None,
) -> StationTrajectory:
    """Plans everything that the arm does at one station.

    Args:
        path: The scan path.
        points: Indices of the points to scan here, shape (p,).
        T_arm_base_workpiece: Part in the arm base, shape (4, 4) [m].
        mesh: The part, in the workpiece frame.
        settings: Scan settings.
        cell: The cell.
        station_id: Number of the station.
        start: Joint positions that the arm is in, shape (6,) [rad]; None = home.
        progress: Told the share done and what is being done.
        is_cancelled: Asked now and then.
        T_arm_base_map: Shop in the arm base, shape (4, 4) [m]: where the cell's obstacles are;
            None = they are left out.

    Returns:
        Segments from the start to home; each begins where the one before ends, at rest. Points that
        are not scanned are listed with the reason.

    Raises:
        ScanPathInvalidError: Indices that are none of the path's.
        StrategyUnknownError: No order strategy of that name.
        StartStateError: The start is out of limits or in collision.
        NoTrajectoryError: No point can be scanned.
        CancelledError: The caller asked to stop.
    """
    order_of = chosen("order", settings.order_strategy, STRATEGIES)
    points = _require_points(path, points)
    tell = _rising(progress)
    world = CollisionWorld(
        cell,
        mesh,
        require_transform(T_arm_base_workpiece, "T_arm_base_workpiece"),
        T_arm_base_map,
    )
    problem = _problem(world, settings, cell, path, points, start, tell, is_cancelled)
    tell(0.05, "inverse kinematics")
    views = Views.placed(
        path.positions[points], path.directions[points], path.targets[points], T_arm_base_workpiece
    )
    problem = replace(problem, reference=views.reference)
    reached = reach(world, views, settings.tilt_max_rad, problem.home)
    seen = np.unique(reached.view)
    if not len(seen):
        raise NoTrajectoryError(
            f"station {station_id}: none of the {len(points)} points can be scanned; "
            f"the first one: {reached.reasons.get(0, 'no point was asked for')}"
        )
    ends = world.arm.forward_scanner(np.stack([problem.start, problem.home]))[:, :3, 3]
    begin, end = apply(inverse(T_arm_base_workpiece), ends)
    order = order_of(VisitTask(path, points[seen], settings.row_interval_m, begin, end))
    tell(0.2, "joint branches")
    search = Search(problem, np.searchsorted(points, order.points), reached)
    limits = Limits(problem.velocity, problem.acceleration, settings.tcp_speed_m_s)
    way, segments = _timed_way(search, world, points, limits, station_id, tell)
    reasons = {
        int(points[view]): reason for view, reason in (reached.reasons | way.dropped).items()
    }
    skipped = tuple(SkippedPoint(point, reasons[point]) for point in sorted(reasons))
    result = StationTrajectory(station_id, tuple(segments), skipped)
    _LOG.info(
        "station %d: %d points, %d skipped, %d breaks, scan %.1f s, transit %.1f s",
        station_id, len(way.points), len(skipped), result.breaks, result.scan_s, result.transit_s,
    )  # fmt: skip
    tell(1.0, "done")
    return result


def _timed_way(
    search: Search,
    world: CollisionWorld,
    points: NDArray[np.int64],
    limits: Limits,
    station_id: int,
    tell: Progress,
) -> tuple[Way, list[Segment]]:
    """Searches a way and times it, anew without the edges that collide between their ends.

    Raises:
        NoTrajectoryError: No point is left.
    """
    for repair in itertools.count():
        way = search.run()
        if not len(way.points):
            raise NoTrajectoryError(
                f"station {station_id}: no collision-free motion to any of the {len(points)} points"
            )
        tell(0.6 + 0.4 * min(repair / _REPAIRS, 1.0), "timing")
        segments, places = timed_segments(world.arm, way, points, limits)
        bad = collision_edges(world, segments, places)
        if not bad:
            break
        for edge in bad:
            if repair < _REPAIRS:
                search.forbid(way, edge)
            else:  # other ways were tried often enough: the point goes, so that this ends
                search.drop_after(way, edge)
    return way, segments


def plan_trajectories(
    path: ScanPath,
    plan: StationPlan,
    T_map_workpiece: Array,
    mesh: SurfaceMesh,
    settings: ScanSettings,
    cell: CellConfig,
    progress: Progress | None = None,
    is_cancelled: Callable[[], bool] | None = None,
) -> tuple[StationTrajectory, ...]:
    """Plans all stations, the base at its nominal poses; arguments: `plan_station_trajectory`.

    A station where nothing can be scanned gives a trajectory without segments and all its points
    skipped.

    Raises:
        NoTrajectoryError: At no station anything can be scanned.
    """
    result = []
    tell = progress or (lambda share, text: None)
    for number, station in enumerate(plan.stations):

        def part(share: float, text: str, number: int = number) -> None:
            tell(
                (number + share) / len(plan.stations),
                f"station {number + 1} of {len(plan.stations)}: {text}",
            )

        T_arm_base_map = inverse(station.T_map_base_link @ cell.T_base_link_arm_base)
        try:
            trajectory = plan_station_trajectory(
                path,
                station.points,
                T_arm_base_map @ T_map_workpiece,
                mesh,
                settings,
                cell,
                station.id,
                None,
                part,
                is_cancelled,
                T_arm_base_map,
            )
        except NoTrajectoryError as error:
            _LOG.warning("%s", error)
            skipped = tuple(SkippedPoint(int(p), str(error)) for p in station.points)
            trajectory = StationTrajectory(station.id, (), skipped)
        result.append(trajectory)
    if not any(trajectory.segments for trajectory in result):
        raise NoTrajectoryError(f"at none of the {len(result)} stations any point can be scanned")
    return tuple(result)


def _rising(progress: Progress | None) -> Progress:
    """Progress that never goes back, although a repair repeats the search."""
    most = 0.0

    def tell(share: float, text: str) -> None:
        nonlocal most
        most = max(most, share)
        if progress is not None:
            progress(most, text)

    return tell


def _require_points(path: ScanPath, points: NDArray[np.int64]) -> NDArray[np.int64]:
    points = np.unique(np.asarray(points, dtype=np.int64))
    if not len(points):
        raise NoTrajectoryError(
            "a trajectory was asked for no points at all; at least one is accepted"
        )
    if points[0] < 0 or points[-1] >= len(path):
        raise ScanPathInvalidError(
            f"points 0..{len(path) - 1} are accepted, found {points[0]}..{points[-1]}"
        )
    return points


def _problem(
    world: CollisionWorld,
    settings: ScanSettings,
    cell: CellConfig,
    path: ScanPath,
    points: NDArray[np.int64],
    start: Array | None,
    tell: Progress,
    is_cancelled: Callable[[], bool] | None,
) -> Problem:
    arm = world.arm
    home = arm.require_joints(np.atleast_2d(cell.home_rad))[0]
    begin = home if start is None else arm.require_joints(np.atleast_2d(start))[0]
    for name, q in (("home", home), ("start", begin)):
        if not arm.within_limits(q):
            raise StartStateError(
                f"the {name} position {np.round(q, 3).tolist()} is out of the joint limits"
            )
        pair = world.pair(q)
        if pair is not None:
            raise StartStateError(
                f"the {name} position {np.round(q, 3).tolist()} is in collision: {pair}"
            )
    return Problem(
        world=world,
        reference=np.array([1.0, 0.0, 0.0]),
        home=home,
        start=begin,
        tcp_speed=settings.tcp_speed_m_s,
        velocity=arm.velocity,
        acceleration=cell.acceleration_max_rad_s2,
        progress=lambda share: tell(0.2 + 0.4 * share, "transitions"),
        is_cancelled=is_cancelled or (lambda: False),
    )
