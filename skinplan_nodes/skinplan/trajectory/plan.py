"""From scan path points to timed joint trajectories at a station (M2.4)."""

import itertools
import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

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
from skinplan.robot.dexterity import Dexterity
from skinplan.robot.reach import Views
from skinplan.robot.tracker import TrackerSight
from skinplan.scan_path.model import ScanPath
from skinplan.stations.model import SkippedPoint, StationPlan
from skinplan.strategies import chosen
from skinplan.trajectory.ants_order import ants_order
from skinplan.trajectory.assemble import TIMINGS, collision_edges, timed_segments
from skinplan.trajectory.graph import Problem, StationGraph
from skinplan.trajectory.model import Segment, StationTrajectory
from skinplan.trajectory.order import published_order
from skinplan.trajectory.search import NO_MOTION, Search, Way
from skinplan.trajectory.states import find_states
from skinplan.trajectory.timing import Limits
from skinplan.trajectory.tour_order import tour_order
from skinplan.trajectory.transit import Transit
from skinplan.trajectory.visit import VisitOrder, VisitTask
from skinplan.transforms import Array, apply, inverse, require_transform

_LOG = logging.getLogger(__name__)
_REPAIRS = 12
_POSE_DIGITS = 10
_REORDERS = 6  # at most so often an order strategy is asked again with more known
_TCP_ACCELERATION = 3.0  # about what the arm gives the scanner [m/s^2]: prices turns in a tour

Order = Callable[[VisitTask], VisitOrder]
Progress = Callable[[float, str], None]

STRATEGIES: dict[str, Order] = {
    "published": published_order,
    "tour": tour_order,
    "ants": ants_order,
}


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
    T_map_tracker: Array | None = None,
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
        T_arm_base_map: Shop in the arm base, shape (4, 4) [m]: where the cell's obstacles and the
            tracker are; None = they are left out.
        T_map_tracker: Tracker in the shop, shape (4, 4) [m]; None = the cell's.

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
    chosen("timing", settings.timing, TIMINGS)
    points = _require_points(path, points)
    tell = _rising(progress)
    T_arm_base_workpiece = _rounded(T_arm_base_workpiece, "T_arm_base_workpiece")
    if T_arm_base_map is not None:
        T_arm_base_map = _rounded(T_arm_base_map, "T_arm_base_map")
    if T_map_tracker is not None:
        T_map_tracker = _rounded(T_map_tracker, "T_map_tracker")
    world = CollisionWorld(cell, mesh, T_arm_base_workpiece, T_arm_base_map)
    tell(0.05, "inverse kinematics")
    views = Views.placed(
        path.positions[points], path.directions[points], path.targets[points], T_arm_base_workpiece
    )
    problem = _problem(world, views, settings, cell, start, tell, is_cancelled)
    states = find_states(
        world,
        problem.dexterity,
        views,
        settings.tilt_max_rad,
        problem.home,
        *_sight(cell, mesh, T_arm_base_workpiece, T_arm_base_map, T_map_tracker),
        require_wanted=problem.require_wanted,
    )
    if not len(states.view):
        raise NoTrajectoryError(
            f"station {station_id}: none of the {len(points)} points can be scanned; "
            f"the first one: {states.reasons.get(0, 'no point was asked for')}"
        )
    tell(0.2, "joint branches")
    graph = StationGraph(problem, states)
    task = _visit_task(path, points, graph, settings, T_arm_base_workpiece)
    limits = Limits(problem.velocity, problem.acceleration, settings.tcp_speed_m_s)
    made = _timed_way(task, order_of, limits, settings.timing, station_id, tell)
    result = _result(made, points, states.reasons, settings, station_id)
    tell(1.0, "done")
    return result


def _sight(
    cell: CellConfig,
    mesh: SurfaceMesh,
    T_arm_base_workpiece: Array,
    T_arm_base_map: Array | None,
    T_map_tracker: Array | None,
) -> tuple[TrackerSight | None, Array | None]:
    """What hides the scanner from the tracker, and the arm's place in the shop (4, 4) [m]."""
    if T_arm_base_map is None:
        return None, None
    T_map_arm = inverse(T_arm_base_map)
    return TrackerSight(cell, mesh, T_map_arm @ T_arm_base_workpiece, T_map_tracker), T_map_arm


def _visit_task(
    path: ScanPath,
    points: NDArray[np.int64],
    graph: StationGraph,
    settings: ScanSettings,
    T_arm_base_workpiece: Array,
) -> VisitTask:
    """What an order strategy has to order: the points that some joint position scans."""
    problem = graph.problem
    ends = problem.world.arm.forward_scanner(np.stack([problem.start, problem.home]))[:, :3, 3]
    begin, end = apply(inverse(T_arm_base_workpiece), ends)
    return VisitTask(
        path,
        points[np.unique(graph.states.view)],
        settings.row_interval_m,
        begin,
        end,
        among=points,
        graph=graph,
        effort_s=settings.tour_effort_s,
        tcp_turn_s=settings.tcp_speed_m_s / _TCP_ACCELERATION,
    )


def _result(
    made: "_Made",
    points: NDArray[np.int64],
    unseen: Mapping[int, str],
    settings: ScanSettings,
    station_id: int,
) -> StationTrajectory:
    """Says what is driven, and why the other points are not."""
    reasons = {**unseen, **made.way.dropped}
    skipped = tuple(SkippedPoint(int(points[v]), reasons[v]) for v in sorted(reasons))
    rated = settings.order_strategy, made.order.cost, made.order.bound
    result = StationTrajectory(station_id, tuple(made.segments), skipped, *rated)
    _LOG.info(
        "station %d: %d points, %d skipped, %d breaks, scan %.1f s, transit %.1f s",
        station_id, len(made.way.points), len(skipped), result.breaks, result.scan_s,
        result.transit_s,
    )  # fmt: skip
    return result


@dataclass(frozen=True, eq=False)
class _Made:
    way: Way
    segments: list[Segment]
    order: VisitOrder


def _timed_way(
    task: VisitTask,
    order_of: Order,
    limits: Limits,
    timing: str,
    station_id: int,
    tell: Progress,
) -> _Made:
    """Searches a way and times it, anew without the edges that collide between their ends.

    Raises:
        NoTrajectoryError: No point is left.
    """
    graph = task.graph
    assert graph is not None
    dropped: dict[int, str] = {}
    for repair in itertools.count():
        graph.problem.require_wanted()
        order, way = _ordered_way(task, order_of, dropped)
        if not len(way.points):
            raise NoTrajectoryError(
                f"station {station_id}: no collision-free motion to any of the {len(task.points)} "
                "points"
            )
        tell(0.6 + 0.4 * min(repair / _REPAIRS, 1.0), "timing")
        world = graph.problem.world
        segments, places = timed_segments(world.arm, way, task.among, limits, timing)
        bad = collision_edges(world, segments, places)
        if not bad:
            break
        for edge in bad:
            graph.forbid(way.pair(edge), not isinstance(way.edges[edge], Transit))
            if repair >= _REPAIRS:  # other ways were tried often enough: the point goes
                dropped[int(way.points[min(edge, len(way.points) - 1)])] = NO_MOTION
        task = replace(task, known=task.among[way.points], effort_s=0.0)
    return _Made(way, segments, order)


def _ordered_way(
    task: VisitTask, order_of: Order, dropped: dict[int, str]
) -> tuple[VisitOrder, Way]:
    """Orders and searches in turns: the order strategy is asked again while more is known."""
    assert task.graph is not None
    search = Search(task.graph)
    best: tuple[VisitOrder, Way] | None = None
    for _ in range(_REORDERS):
        order = order_of(task)
        way = search.run(np.searchsorted(task.among, order.points), dropped)
        rank = (len(way.dropped), round(way.cost_s, 6))
        if best is not None and rank >= (len(best[1].dropped), round(best[1].cost_s, 6)):
            break
        same = task.known is not None and np.array_equal(order.points, task.known)
        best = order, way
        if same:
            break
        task = replace(task, known=order.points, effort_s=0.3 * task.effort_s)
    assert best is not None
    return best


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
                plan.T_map_tracker,
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


def _rounded(T: Array, name: str) -> Array:
    """A pose without its last digits: a message does not keep them, and ties hang on them.

    The rotation nearest to the rounded one is taken: the inverse kinematics ask for an exact one.
    """
    result = np.round(require_transform(T, name), _POSE_DIGITS) + 0.0
    left, _, right = np.linalg.svd(result[:3, :3])
    result[:3, :3] = left @ right
    return result


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
    views: Views,
    settings: ScanSettings,
    cell: CellConfig,
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
        dexterity=Dexterity(arm),
        reference=views.reference,
        home=home,
        start=begin,
        tcp_speed=settings.tcp_speed_m_s,
        velocity=arm.velocity,
        acceleration=cell.acceleration_max_rad_s2,
        seed=0,
        progress=lambda share: tell(0.2 + 0.4 * share, "transitions"),
        is_cancelled=is_cancelled or (lambda: False),
    )
