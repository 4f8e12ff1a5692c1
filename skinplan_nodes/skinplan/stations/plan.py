"""Where the base stands, and what it scans from there (M2.3)."""

import logging
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from skinplan.contact.strategy import axial_radial
from skinplan.errors import NoCandidatesError, NothingReachedError, ScanPathInvalidError
from skinplan.mesh.model import SurfaceMesh
from skinplan.part.model import ScanSettings
from skinplan.robot.cell import CellConfig
from skinplan.robot.collision import CollisionWorld
from skinplan.scan_path.model import ScanPath
from skinplan.stations.assign import assign
from skinplan.stations.candidate_map import BLIND, CandidateMap
from skinplan.stations.candidates import floor_frame, make_candidates, refined_centre
from skinplan.stations.cover import WANTED_SPACING_RATIO, choose
from skinplan.stations.left_out import reasons_of_left_out
from skinplan.stations.marker_view import MarkerView
from skinplan.stations.model import SkippedPoint, Station, StationPlan
from skinplan.stations.problem import Progress, Proposal, StationProblem, StationReach
from skinplan.stations.reach_strategy import FINE_SHARES, engine_for, reach_stations
from skinplan.stations.rectangle import workspace_rectangle
from skinplan.stations.tracker_proposal import with_proposed_tracker
from skinplan.strategies import chosen
from skinplan.transforms import Array, apply, inverse, planar, require_transform, rotate

_LOG = logging.getLogger(__name__)


def rectangles(problem: StationProblem) -> Proposal:
    """The paper's method: rectangles on projected points, NMS, eq (6), eq (7)."""
    path, T_map_workpiece = problem.path, problem.T_map_workpiece
    settings, cell = problem.settings, problem.cell
    rectangle = workspace_rectangle(cell, settings.standoff_m)
    floor = apply(T_map_workpiece, path.positions)[:, :2]
    heading = floor_frame(floor, rotate(T_map_workpiece, path.directions))
    turn = planar(0.0, 0.0, heading)[:2, :2]
    points = floor @ turn  # floor frame: first axis along the heading, second to the left
    candidates = make_candidates(points, rectangle)
    offset = turn @ cell.T_base_link_arm_base[:2, 3]

    def base_pose(centre: Array) -> Array:
        # The arm axis stands beside the rectangle: the base so that its arm does.
        x, y = turn @ (centre - np.array([0.0, rectangle.offset_m])) - offset
        return planar(x, y, heading)

    places = np.array([base_pose(centre) for centre in candidates.centres])
    blind = _blind(problem, places)
    if blind.all():
        raise problem.unseen(places)
    covers = candidates.covers & ~blind[:, None]
    choice = choose(covers, candidates.centres, WANTED_SPACING_RATIO * rectangle.length_m)
    poses = []
    for number in choice.chosen:
        centre = refined_centre(points[covers[number]], candidates.centres[number], rectangle)
        if _blind(problem, base_pose(centre)[None])[0]:
            centre = candidates.centres[number]
        poses.append((float(centre[0]), base_pose(centre)))
    poses.sort(key=lambda pose: pose[0])
    return Proposal(
        tuple(pose for _, pose in poses),
        turn[:, 0],
        len(candidates.centres),
        choice.lower_bound,
        choice.proven,
        np.flatnonzero(~covers.any(axis=0)),
        candidates_seen=CandidateMap(
            places,
            np.where(blind, BLIND, covers.sum(axis=1)),
            "covers",
            rectangle,
        ),
        left_out=places[blind],
    )


def _blind(problem: StationProblem, poses: Array) -> NDArray[np.bool_]:
    """Which poses are left out for what the camera sees there, shape (c,)."""
    if problem.markers is None:
        return np.zeros(len(poses), dtype=bool)
    return ~problem.markers.suffices(problem.cell, problem.T_map_workpiece, poses)


#: Strategies by name. One that leaves `Proposal.reach` out has it found at its poses.
STRATEGIES: dict[str, Callable[[StationProblem], Proposal]] = {
    "axial_radial": axial_radial,
    "reach": reach_stations,
    "rectangles": rectangles,
}


def plan_stations(
    path: ScanPath,
    T_map_workpiece: Array,
    mesh: SurfaceMesh,
    settings: ScanSettings,
    cell: CellConfig,
    progress: Progress | None = None,
    is_cancelled: Callable[[], bool] | None = None,
    markers: MarkerView | None = None,
) -> StationPlan:
    """Plans the stations and gives every point to one that the arm really reaches it from.

    Args:
        path: The scan path, workpiece frame.
        T_map_workpiece: Part in the shop, shape (4, 4) [m].
        mesh: The part, workpiece frame.
        settings: Scan settings; ``station_strategy`` names one of `STRATEGIES`.
        cell: The cell.
        progress: Told the share done and what is being done.
        is_cancelled: Asked now and then.
        markers: What the camera is to see of the part from each station; None = the part's place is
            known without, then no station is left out for it.

    Returns:
        The plan; points that no station reaches are listed with the reason at the station nearest
        to them.

    Raises:
        StrategyUnknownError: No station strategy of that name.
        ScanPathInvalidError: A path without points, or with ones that are not finite.
        NoCandidatesError: No place for the base is free of collision.
        MarkersUnseenError: From none that is free, or reaches a point, the part can be located.
        NothingReachedError: The arm reaches no point from any station.
        CancelledError: The caller asked to stop.
    """
    strategy = chosen("station", settings.station_strategy, STRATEGIES)
    _require_path(path)
    T_map_workpiece = require_transform(T_map_workpiece, "T_map_workpiece")
    if markers is not None and not markers.fixture.markers:
        markers = None
    problem = StationProblem(
        path, T_map_workpiece, mesh, settings, cell, progress or _silent, is_cancelled, markers
    )
    if cell.propose_tracker:
        cell = with_proposed_tracker(problem, lambda other: _planned(strategy, other))
        problem = replace(problem, cell=cell)
    plan = replace(_planned(strategy, problem), T_map_tracker=cell.T_map_tracker)
    _LOG.info(
        "%d stations of %d candidates, %.1f %% of %d points reached",
        len(plan.stations), plan.candidates, 100.0 * plan.reached_ratio, len(path),
    )  # fmt: skip
    problem.tell(1.0, "done")
    return plan


def _planned(
    strategy: Callable[[StationProblem], Proposal], problem: StationProblem
) -> StationPlan:
    problem.tell(0.0, "candidates")
    proposal = strategy(problem)
    if proposal.reach is None:
        proposal = _with_true_reach(problem, proposal)
    return _assigned(problem, proposal)


def _silent(share: float, text: str) -> None:
    """Progress that nobody wants."""


def _assigned(problem: StationProblem, proposal: Proposal) -> StationPlan:
    """Gives every point to a station; the table's rows follow the stations."""
    found = proposal.reach
    assert found is not None
    # Where a station reaches a point also beside its goal, none that does not takes it.
    firm = found.reached if found.robust is None else found.robust
    usable = np.where(firm.any(axis=0), firm, found.reached)
    along = apply(problem.T_map_workpiece, problem.path.positions)[:, :2] @ proposal.along
    places = np.array([pose[:2, 3] @ proposal.along for pose in proposal.poses])
    owner = assign(usable, places, along)
    if np.all(owner < 0):
        raise NothingReachedError(
            f"the arm reaches none of the {len(problem.path)} points from any of "
            f"{len(proposal.poses)} stations; the first point: {found.reasons.get(0, 'unknown')}"
        )
    used = [number for number in range(len(proposal.poses)) if np.any(owner == number)]
    stations = tuple(
        Station(new, proposal.poses[old], np.flatnonzero(owner == old).astype(np.int64))
        for new, old in enumerate(used)
    )
    skipped = tuple(
        SkippedPoint(int(p), found.reasons.get(int(p), "unknown"))
        for p in np.flatnonzero(owner < 0)
    )
    robust = float(np.mean(found.robust.any(axis=0))) if found.robust is not None else float("nan")
    return StationPlan(
        problem.settings.station_strategy, stations, proposal.candidates, proposal.lower_bound,
        proposal.proven_optimal, 1.0 - len(skipped) / len(problem.path), skipped, robust,
        None if found.table is None else found.table.rows(used),
        None if found.robust is None else found.robust[used],
        proposal.candidates_seen, marker_quality=problem.marker_quality,
    )  # fmt: skip


def _with_true_reach(problem: StationProblem, proposal: Proposal) -> Proposal:
    """Finds what the poses that are free really reach, and the reasons where they do not."""
    engine = engine_for(problem, FINE_SHARES, False)
    poses, left_out = _free_poses(problem, proposal, engine.world)
    table = engine.table(
        poses,
        keep_joints=True,
        progress=lambda share: problem.tell(0.2 + 0.7 * share, "reach of the stations"),
        is_cancelled=problem.is_cancelled,
    )
    nearest = np.argmax(table.nearness, axis=0)
    missing = np.flatnonzero(~table.reached.any(axis=0))
    reasons = {
        int(point): _reason(
            table.reason(int(table.codes[nearest[point], point])), point in proposal.uncovered
        )
        for point in missing
    } | reasons_of_left_out(problem, engine, left_out, missing)
    reach = StationReach(table.reached, None, table, reasons)
    return replace(proposal, poses=tuple(poses), reach=reach)


def _free_poses(
    problem: StationProblem, proposal: Proposal, world: CollisionWorld
) -> tuple[Array, Array]:
    """The poses of a proposal that are free, and the places left out only for the camera's view.

    Raises:
        NoCandidatesError: None is free.
    """
    cell, count = problem.cell, len(proposal.poses)
    poses = np.concatenate([np.array(proposal.poses).reshape(-1, 4, 4), proposal.left_out])
    found = problem.standing(poses)
    blocked = found.blocked
    T_map_arm = poses @ cell.T_base_link_arm_base
    home = np.tile(cell.home_rad, (len(poses), 1))
    codes = world.codes(home, inverse(problem.T_map_workpiece) @ T_map_arm, T_map_arm)
    proposed = np.arange(len(poses)) < count
    for number in np.flatnonzero(proposed & found.free & (codes > 0)):
        blocked = f"collision of {world.names[codes[number]]}"
    free, blind = proposed & found.free & (codes == 0), found.blind & (codes == 0)
    if not free.any():
        if blind.any():
            raise problem.unseen(poses[blind])
        raise NoCandidatesError(f"none of the {count} places for the base is free: {blocked}")
    for pose in poses[proposed & ~free]:
        _LOG.warning("station at %s left out: %s", np.round(pose[:2, 3], 3).tolist(), blocked)
    return poses[free], poses[blind]


def _reason(reason: str, uncovered: bool) -> str:
    return f"{reason} (no candidate covers it)" if uncovered else reason


def _require_path(path: ScanPath) -> None:
    if not len(path):
        raise ScanPathInvalidError(
            "stations were asked for a scan path without points; at least one point is accepted"
        )
    for name in ("positions", "directions", "targets"):
        values = getattr(path, name)
        if values.shape != (len(path), 3) or not np.all(np.isfinite(values)):
            raise ScanPathInvalidError(
                f"scan path {name}: finite numbers of shape ({len(path)}, 3) are accepted"
            )
