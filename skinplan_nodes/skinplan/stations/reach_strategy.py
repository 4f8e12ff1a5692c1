"""Strategy ``reach``: the fewest places from which the arm really reaches everything.

Candidates stand on a floor grid beside the part, free of collision with base, pedestal and the arm
at home, and where the camera will locate the part. What each reaches is found by `ReachEngine`;
what it reaches although the base stops beside its goal by `eroded`. The smallest set that covers
all that some candidate reaches so is found with proof; of all such sets the one with least travel
and most margin is taken. Points that are reached only from an undisturbed base are covered where a
chosen station does, and are no reason for a further one.
"""

import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from skinplan.cover.minimum import minimum_cover
from skinplan.errors import (
    CancelledError,
    LimitsExcludeError,
    NoCandidatesError,
    NothingReachedError,
    TrackerBlindError,
)
from skinplan.robot.batch import ReachEngine
from skinplan.robot.records import NO_IK, REACHED, ReachTable
from skinplan.robot.tracker import TrackerSight
from skinplan.stations.candidate_map import of_grid
from skinplan.stations.floor_grid import FloorGrid, floor_grid
from skinplan.stations.least_travel import least_travel
from skinplan.stations.left_out import reasons_of_left_out
from skinplan.stations.problem import Proposal, StationProblem, StationReach
from skinplan.stations.robust import eroded, grid_step, widened
from skinplan.stations.standing import apply_each
from skinplan.transforms import Array, apply, inverse, rotate

_LOG = logging.getLogger(__name__)
_TIME_LIMIT_S = 20.0
_WORTH = 0.6  # candidates are tried first that promise this share of the best at their place along
FINE_SHARES = (0.5, 1.0)  # tilts tried for the chosen stations, in shares of the largest


@dataclass(frozen=True, eq=False)
class _Tried:
    """Candidates and what they reach."""

    grid: FloorGrid
    codes: NDArray[np.int16]
    nearness: NDArray[np.int8]
    singularity: NDArray[np.float32]
    robust: NDArray[np.bool_]
    table: ReachTable  # of the last batch: knows the codes in words

    @property
    def reached(self) -> NDArray[np.bool_]:
        return self.codes == REACHED


def reach_stations(problem: StationProblem) -> Proposal:
    """Chooses the stations.

    Raises:
        NoCandidatesError: No place for the base is free of collision.
        MarkersUnseenError: From none that is, or that reaches a point, the part can be located.
        TrackerBlindError: The tracker sees the scanner nowhere.
        LimitsExcludeError: The joint limits exclude everything.
        NothingReachedError: No point is reached from anywhere.
        CancelledError: The caller asked to stop.
    """
    engine = engine_for(problem, (1.0,), problem.cell.base_error_m > 0.0)
    problem.tell(0.02, "candidates")
    grid, free, blind = _free_grid(problem, engine)
    promising = engine.promising(free.poses)
    worth = _worth_trying(free, promising.sum(axis=1))
    tried = _try(problem, engine, free.take(worth))
    if not tried.robust.any(axis=0).all():
        # What no good candidate reaches may be reached by one that promises little.
        tried = _try_others(problem, engine, free, worth, promising, tried)
    if not tried.reached.any():
        if reasons_of_left_out(problem, engine, blind.poses, np.arange(len(problem.path))):
            raise problem.unseen(blind.poses)
        raise _nothing_reached(problem, tried)
    covers = tried.robust if tried.robust.any() else tried.reached
    problem.tell(0.85, "choosing stations")
    cover = minimum_cover(csr_matrix(covers.T), _TIME_LIMIT_S)
    along = tried.grid.poses[:, :2, 3] @ tried.grid.along
    chosen = least_travel(covers, cover.chosen, along, _margins(tried.singularity, covers))
    _LOG.info(
        "%d of %d candidates, at least %g needed", len(chosen), len(covers), cover.lower_bound
    )
    poses = tried.grid.poses[chosen]
    problem.tell(0.9, "records of the chosen stations")
    table = engine_for(problem, FINE_SHARES, False).table(poses, keep_joints=True)
    reached = table.reached | tried.reached[chosen]
    missing = np.flatnonzero(~reached.any(axis=0))
    reasons = _reasons(tried, reached) | reasons_of_left_out(problem, engine, blind.poses, missing)
    return Proposal(
        tuple(poses),
        tried.grid.along,
        len(tried.grid),
        int(cover.lower_bound),
        cover.proven,
        cover.uncoverable,
        StationReach(table.reached, tried.robust[chosen] & table.reached, table, reasons),
        of_grid(grid, free, tried.grid, covers.sum(axis=1), _word(problem), blind),
    )


def engine_for(
    problem: StationProblem, tilt_shares: tuple[float, ...], disturbed: bool
) -> ReachEngine:
    """Prepares the search for what stations reach.

    Args:
        problem: What stations are wanted for.
        tilt_shares: Tilts tried after the straight view, in shares of the largest.
        disturbed: Allow for the base's heading error (`robust`).
    """
    cell = problem.cell
    return ReachEngine(
        widened(cell) if disturbed else cell,
        problem.mesh,
        problem.T_map_workpiece,
        problem.views,
        problem.settings.tilt_max_rad,
        TrackerSight(cell, problem.mesh, problem.T_map_workpiece),
        tilt_shares,
        first_joint_margin_rad=cell.base_error_rad if disturbed else 0.0,
    )


def _free_grid(
    problem: StationProblem, engine: ReachEngine
) -> tuple[FloorGrid, FloorGrid, FloorGrid]:
    """The grid, its places where base and arm at home can be, and those left out for the camera."""
    cell, T_map_workpiece = problem.cell, problem.T_map_workpiece
    grid = floor_grid(
        apply(T_map_workpiece, problem.path.positions),
        rotate(T_map_workpiece, problem.path.directions),
        cell.T_base_link_arm_base[:2, 3],
        engine.far_m,
        grid_step(cell),
    )
    found = problem.standing(grid.poses)
    free, blind, blocked = found.free, found.blind, found.blocked
    T_map_arm = grid.poses @ cell.T_base_link_arm_base
    home = np.tile(cell.home_rad, (len(grid), 1))
    clear = np.flatnonzero(free | blind)
    codes = np.zeros(len(grid), dtype=np.int64)
    codes[clear] = engine.world.codes(
        home[clear], inverse(T_map_workpiece) @ T_map_arm[clear], T_map_arm[clear]
    )
    if not np.any(free & (codes == 0)):
        if np.any(blind & (codes == 0)):
            raise problem.unseen(grid.poses[blind & (codes == 0)])
        if len(clear):
            blocked = engine.world.names[int(np.bincount(codes[clear]).argmax())]
            blocked += " with the arm at home"
        raise NoCandidatesError(
            f"none of the {len(grid)} places for the base within the arm's reach of the part is "
            f"free: {blocked}; a place on the floor that is clear of the part is needed"
        )
    return grid, grid.take(free & (codes == 0)), grid.take(blind & (codes == 0))


def _worth_trying(grid: FloorGrid, counts: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which candidates promise about as much as the best one at the same place along the part."""
    column = grid.cells[:, 0] - grid.cells[:, 0].min()
    best = np.zeros(column.max() + 1, dtype=np.int64)
    np.maximum.at(best, column, counts)
    return np.asarray((counts > 0) & (counts >= _WORTH * best[column]))


def _try(problem: StationProblem, engine: ReachEngine, grid: FloorGrid) -> _Tried:
    table = engine.table(
        grid.poses,
        progress=lambda share: problem.tell(0.1 + 0.6 * share, "reach of the candidates"),
        is_cancelled=problem.is_cancelled,
    )
    robust = eroded(table.reached, grid.cells) if _disturbed(problem) else table.reached
    return _Tried(grid, table.codes, table.nearness, table.singularity, robust, table)


def _try_others(
    problem: StationProblem,
    engine: ReachEngine,
    free: FloorGrid,
    worth: NDArray[np.bool_],
    promising: NDArray[np.bool_],
    tried: _Tried,
) -> _Tried:
    """Tries those left out that promise, or whose neighbours promise, a point not yet covered."""
    missing = np.flatnonzero(~tried.robust.any(axis=0))
    useful = np.asarray(promising[:, missing].any(axis=1))
    alone = eroded(~useful[:, None], free.cells)[:, 0]
    more = np.asarray(~worth & (useful | ~alone) & promising.any(axis=1))
    if not more.any():
        return tried
    if problem.is_cancelled is not None and problem.is_cancelled():
        raise CancelledError("station planning was cancelled")
    table = engine.table(free.poses[more], is_cancelled=problem.is_cancelled)
    order = np.concatenate([np.flatnonzero(worth), np.flatnonzero(more)])
    sort = np.argsort(order, kind="stable")
    grid = free.take(order[sort])
    codes = np.concatenate([tried.codes, table.codes])[sort]
    nearness = np.concatenate([tried.nearness, table.nearness])[sort]
    singularity = np.concatenate([tried.singularity, table.singularity])[sort]
    robust = eroded(codes == REACHED, grid.cells) if _disturbed(problem) else codes == REACHED
    return _Tried(grid, codes, nearness, singularity, robust, table)


def _word(problem: StationProblem) -> str:
    return "robustly reaches" if _disturbed(problem) else "reaches"


def _disturbed(problem: StationProblem) -> bool:
    return problem.cell.base_error_m > 0.0


def _margins(singularity: NDArray[np.float32], covers: NDArray[np.bool_]) -> Array:
    """Mean singularity measure of what each candidate covers, in [0, 1], shape (c,)."""
    total = np.where(covers, np.nan_to_num(singularity), 0.0).sum(axis=1)
    return np.asarray(total / np.maximum(1, covers.sum(axis=1)), dtype=float)


def _reasons(tried: _Tried, reached: NDArray[np.bool_]) -> dict[int, str]:
    """Why points are not reached, at the candidate that comes nearest to reaching each."""
    result: dict[int, str] = {}
    for point in np.flatnonzero(~reached.any(axis=0)):
        best = int(np.argmax(tried.nearness[:, point]))
        code = int(tried.codes[best, point])
        where = tried.grid.poses[best, :2, 3]
        place = f"at best, from ({where[0]:.2f}, {where[1]:.2f}) m"
        if code == REACHED:
            result[int(point)] = f"reached only while the base stands exactly on its goal, {place}"
        else:
            result[int(point)] = f"{tried.table.reason(code)} ({place})"
    return result


def _nothing_reached(problem: StationProblem, tried: _Tried) -> NothingReachedError:
    """The error that says what most keeps the arm from the points."""
    codes = np.full(1, NO_IK)
    if len(tried.grid):
        nearest = tried.nearness.argmax(axis=0)
        codes = tried.codes[nearest, np.arange(tried.codes.shape[1])].astype(np.int64)
    most = tried.table.reason(int(np.bincount(codes).argmax()))
    rank = int(tried.nearness.max(initial=0))
    kinds = {2: LimitsExcludeError, 4: TrackerBlindError}
    place = apply_each(problem.cell.T_map_tracker[None], np.zeros(3))[0]
    seen = f"; the tracker stands at {np.round(place, 2).tolist()} m" if rank == 4 else ""
    return kinds.get(rank, NothingReachedError)(
        f"the arm reaches none of the {len(problem.path)} points from any of the {len(tried.grid)} "
        f"places where the base can stand: {most}{seen}; a part within reach is needed"
    )
