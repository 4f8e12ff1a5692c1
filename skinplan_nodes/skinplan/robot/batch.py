"""What the arm reaches from many stations: records of all pairs of stations and points.

Coarse to fine: pairs that are too far apart are dropped; the straight view is tried first, tilted
ones only where it fails. Of each view an exact closed-form test (`WristFilter`) tells whether it
has a solution that is not singular; only then all branches are solved, and of those the ones within
limits are tried for collision and for the tracker's sight in the order of their distance from
singular positions, until one is free.

With the scanner on tool z roll only turns the last joint: it rests at its home position. Base
heading only turns a vertical first joint, so it adds no reach and is not searched here.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import CancelledError, InputError
from skinplan.mesh.model import SurfaceMesh
from skinplan.robot.branches import BranchSolver
from skinplan.robot.cell import CellConfig
from skinplan.robot.collision import CollisionWorld
from skinplan.robot.records import FIRST_PAIR, LIMITS, NO_IK, REACHED, SINGULAR, ReachTable
from skinplan.robot.tracker import TrackerSight
from skinplan.robot.view_options import ViewOptions
from skinplan.robot.wrist_filter import SINGULAR as ONLY_SINGULAR
from skinplan.robot.wrist_filter import SOME
from skinplan.transforms import Array, apply, inverse, require_transform

_LOG = logging.getLogger(__name__)
_PAIRS = 30_000  # pairs of stations and points in work at once: bounds memory
_ITEMS = 2_000  # views solved at once: fits the processor's cache
_RANKS = (slice(0, 1), slice(1, 3), slice(3, 8))  # branches tried at once, the best one first

Indices = NDArray[np.int64]


@dataclass(eq=False)
class _Work:
    """The table while it is filled."""

    codes: NDArray[np.int16]
    options: NDArray[np.int16]
    singularity: NDArray[np.float32]
    limit_margin: NDArray[np.float32]
    q: Array | None


class ReachEngine:
    """Finds what stations reach of one part, at one place.

    Attributes:
        world: Arm, base and part.
        options: How each view may be taken.
        sight: The tracker; None = it is not asked.
    """

    def __init__(
        self,
        cell: CellConfig,
        mesh: SurfaceMesh | None,
        T_map_workpiece: Array,
        views: tuple[Array, Array, Array],
        tilt_max_rad: float,
        sight: TrackerSight | None = None,
        tilt_shares: tuple[float, ...] = (1.0,),
        roll_rad: float | None = None,
        first_joint_margin_rad: float = 0.0,
    ) -> None:
        """Prepares the views.

        Args:
            cell: The cell.
            mesh: The part, workpiece frame; None = nothing to collide with.
            T_map_workpiece: Part in the shop, shape (4, 4) [m].
            views: Scanner origins, unit view directions and targets in the workpiece frame, each of
                shape (n, 3) [m].
            tilt_max_rad: Largest tilt about the target [rad].
            sight: The tracker; None = every pose counts as seen.
            tilt_shares: Tilts after the straight view, in shares of the largest, 16 sides each.
            roll_rad: Roll about the view axis [rad]; None = free.
            first_joint_margin_rad: The first joint keeps so far from its limits: it takes up a
                heading error of the base [rad].

        Raises:
            InputError: Views that are not finite or do not fit together.
        """
        self._T_map_workpiece = require_transform(T_map_workpiece, "T_map_workpiece")
        shapes = {np.shape(view) for view in views}
        if len(shapes) != 1 or np.ndim(views[0]) != 2 or np.shape(views[0])[1] != 3:
            raise InputError(f"views of one shape (n, 3) are accepted, found {sorted(shapes)}")
        if not all(np.all(np.isfinite(view)) for view in views):
            raise InputError("views of finite numbers are accepted, found NaN or infinity")
        self.world = CollisionWorld(cell, mesh, np.eye(4), np.eye(4))
        self.sight = sight
        arm = self.world.arm
        self.options = ViewOptions.of(
            arm, views, self._T_map_workpiece, tilt_max_rad, tilt_shares, roll_rad
        )
        self.solver = BranchSolver(
            arm, np.array(cell.home_rad), self.options.roll_is_free, first_joint_margin_rad
        )
        self._cell = cell
        self._far = float(arm.lever_arms()[0])
        self._positions = apply(self._T_map_workpiece, np.asarray(views[0], dtype=float))
        T = self.options.T_map_tool0
        # What the tracker can't see whatever the arm does: a test for each view, not each station.
        self._hidden = np.zeros(T.shape[:2], dtype=np.int64)
        if sight is not None:
            scanners = (T @ arm.T_tool0_scanner).reshape(-1, 4, 4)
            hidden = sight.pose_codes(scanners).reshape(T.shape[:2])
            first = FIRST_PAIR + len(self.world.names) - 2
            self._hidden = np.where(hidden > 0, first + hidden, REACHED)
        self._centres = T[..., :3, :3] @ self.solver.filter.centre_tool0 + T[..., :3, 3]
        self._axes = T[..., :3, :3] @ self.solver.filter.axis_tool0

    @property
    def far_m(self) -> float:
        """No view farther from the first joint than this is reached [m]."""
        return self._far

    def promising(self, T_map_base: Array) -> NDArray[np.bool_]:
        """Tells which straight views have a solution from where that is not singular, (s, n).

        Neither limits nor collisions nor the tracker are asked: it costs next to nothing.

        Args:
            T_map_base: Poses of the base, shape (s, 4, 4) [m].
        """
        T_map_arm = T_map_base @ self._cell.T_base_link_arm_base
        result = np.zeros((len(T_map_base), len(self._positions)), dtype=bool)
        step = max(1, _PAIRS // max(1, result.shape[1]))
        for start in range(0, len(result), step):
            station, point = self._near(T_map_arm, np.arange(start, min(start + step, len(result))))
            grades = self._grades(T_map_arm, station, point, np.arange(1))
            result[station, point] = grades[:, 0] == SOME
        return result

    def table(
        self,
        T_map_base: Array,
        keep_joints: bool = False,
        progress: Callable[[float], None] | None = None,
        is_cancelled: Callable[[], bool] | None = None,
    ) -> ReachTable:
        """Finds the records of all pairs.

        Args:
            T_map_base: Poses of the base, shape (s, 4, 4) [m].
            keep_joints: Keep the joint positions of every record.
            progress: Told the share done.
            is_cancelled: Asked now and then.

        Raises:
            InputError: Poses of a wrong shape or not finite.
            CancelledError: The caller asked to stop.
        """
        poses = np.asarray(T_map_base, dtype=float)
        if poses.ndim != 3 or poses.shape[1:] != (4, 4) or not np.all(np.isfinite(poses)):
            raise InputError(f"finite poses of shape (s, 4, 4) are accepted, found {poses.shape}")
        shape = (len(poses), len(self._positions))
        work = _Work(
            np.full(shape, NO_IK, dtype=np.int16),
            np.full(shape, -1, dtype=np.int16),
            np.full(shape, np.nan, dtype=np.float32),
            np.full(shape, np.nan, dtype=np.float32),
            np.full((*shape, 6), np.nan) if keep_joints else None,
        )
        T_map_arm = poses @ self._cell.T_base_link_arm_base
        step = max(1, _PAIRS // max(1, shape[1]))
        for start in range(0, shape[0], step):
            if is_cancelled is not None and is_cancelled():
                raise CancelledError("the search for what stations reach was cancelled")
            self._fill(work, T_map_arm, np.arange(start, min(start + step, shape[0])))
            if progress is not None:
                progress(min(1.0, (start + step) / shape[0]))
        rolls = self.options.rolls
        return ReachTable(
            work.codes,
            work.options,
            work.singularity,
            work.limit_margin,
            work.q,
            self.options.tilts,
            np.full(len(rolls), np.nan) if self.options.roll_is_free else rolls,
            tuple(self.world.names[1:]),
            None if self.sight is None else tuple(self.sight.names[1:]),
        )

    def _fill(self, work: _Work, T_map_arm: Array, stations: Indices) -> None:
        station, point = self._near(T_map_arm, stations)
        straight = self.options.straight
        for first, last in ((0, straight), (straight, len(self.options.tilts))):
            if not len(station) or first == last:
                return
            grades = self._grades(T_map_arm, station, point, np.arange(first, last))
            only = np.any(grades == ONLY_SINGULAR, axis=1) & (work.codes[station, point] == NO_IK)
            work.codes[station[only], point[only]] = SINGULAR
            some, hidden = grades == SOME, self._hidden[first:last, point].T
            row, option = np.nonzero(some & (hidden > 0))
            work.codes[station[row], point[row]] = hidden[row, option]
            self._try_options(work, T_map_arm, station, point, some & (hidden == 0), first)
            left = work.codes[station, point] != REACHED
            station, point = station[left], point[left]

    def _near(self, T_map_arm: Array, stations: Indices) -> tuple[Indices, Indices]:
        """Pairs of stations and points that are not too far apart."""
        first = T_map_arm[stations, :3, :3] @ self.world.arm.first_axis
        gaps = self._positions[None] - (first + T_map_arm[stations, :3, 3])[:, None]
        row, point = np.nonzero(np.einsum("spi,spi->sp", gaps, gaps) <= self._far**2)
        return stations[row], point

    def _grades(
        self, T_map_arm: Array, station: Indices, point: Indices, options: Indices
    ) -> NDArray[np.int8]:
        """Which options of pairs have solutions (`WristFilter.grade`), shape (m, o)."""
        result = np.empty((len(station), len(options)), dtype=np.int8)
        turn = T_map_arm[station, :3, :3]
        place = T_map_arm[station, :3, 3]
        for column, option in enumerate(options):
            centres = ((self._centres[option, point] - place)[:, None] @ turn)[:, 0]
            axes = (self._axes[option, point][:, None] @ turn)[:, 0]
            result[:, column] = self.solver.filter.grade(centres, axes)
        return result

    def _try_options(
        self,
        work: _Work,
        T_map_arm: Array,
        station: Indices,
        point: Indices,
        possible: NDArray[np.bool_],
        first: int,
    ) -> None:
        """Tries the possible options of pairs one after another until each pair is reached."""
        rank = np.cumsum(possible, axis=1)
        for number in range(1, int(rank[:, -1].max(initial=0)) + 1):
            now = np.flatnonzero((rank[:, -1] >= number) & (work.codes[station, point] != REACHED))
            option = first + np.argmax(rank[now] >= number, axis=1)
            for start in range(0, len(now), _ITEMS):
                chunk = slice(start, start + _ITEMS)
                pairs = now[chunk]
                self._try(work, T_map_arm, station[pairs], point[pairs], option[chunk])

    def _try(
        self, work: _Work, T_map_arm: Array, station: Indices, point: Indices, option: Indices
    ) -> None:
        """Solves one option of each pair and notes what came of it."""
        T_arm_map = inverse(T_map_arm[station])
        found = self.solver.solve(T_arm_map @ self.options.T_map_tool0[option, point])
        codes = np.where(found.any_within, SINGULAR, LIMITS).astype(np.int64)
        codes[~found.any_solution] = NO_IK
        best = np.full((len(station), 6), np.nan)
        T_part_arm = inverse(T_arm_map @ self._T_map_workpiece)
        for ranks in _RANKS:
            usable = found.usable[:, ranks] & (codes != REACHED)[:, None]
            row, rank = np.nonzero(usable)
            q = found.q[row, rank + ranks.start]
            new = self._blocked(q, T_part_arm[row], T_map_arm[station[row]])
            # Of each pose the first free branch counts, or the trouble that is nearest to success.
            order = np.lexsort((rank, -self._nearness(new), row))
            first = order[np.flatnonzero(np.diff(row[order], prepend=-1))]
            row, new, q = row[first], new[first], q[first]
            better = self._nearness(new) > self._nearness(codes[row])
            codes[row[better]] = new[better]
            free = new == REACHED
            best[row[free]] = q[free]
        reached = np.flatnonzero(codes == REACHED)
        agrees = self.solver.confirmed(
            best[reached], (T_arm_map @ self.options.T_map_tool0[option, point])[reached]
        )
        codes[reached[~agrees]] = NO_IK
        self._note(work, station, point, option, codes, best)

    def _blocked(self, q: Array, T_part_arm: Array, T_map_arm: Array) -> Indices:
        """Codes of joint positions: `REACHED`, or what is in the way."""
        segments, T_arm_scanner = self.world.bodies.placed(q)
        pairs = self.world.segment_codes(segments, T_part_arm, T_map_arm)
        codes = np.where(pairs > 0, FIRST_PAIR - 1 + pairs, REACHED)
        free = np.flatnonzero(pairs == 0)
        if self.sight is not None and len(free):
            hidden = self.sight.codes(
                self.world.bodies, segments[free], T_arm_scanner[free], T_map_arm[free]
            )
            first = FIRST_PAIR + len(self.world.names) - 2
            codes[free] = np.where(hidden > 0, first + hidden, REACHED)
        return np.asarray(codes, dtype=np.int64)

    def _nearness(self, codes: Indices) -> Indices:
        """Rank of codes: how near a pair is to success (`ReachTable.nearness`)."""
        hidden = codes >= FIRST_PAIR + len(self.world.names) - 1
        rank = np.where(hidden, 4, np.minimum(codes, FIRST_PAIR) - 1)
        return np.asarray(np.where(codes == REACHED, 5, rank), dtype=np.int64)

    def _note(
        self,
        work: _Work,
        station: Indices,
        point: Indices,
        option: Indices,
        codes: Indices,
        best: Array,
    ) -> None:
        before = work.codes[station, point].astype(np.int64)
        better = self._nearness(codes) > self._nearness(before)
        s, p = station[better], point[better]
        work.codes[s, p] = codes[better]
        reached = codes == REACHED
        s, p, q = station[reached], point[reached], best[reached]
        work.options[s, p] = option[reached]
        work.singularity[s, p] = self.solver.dexterity.measure(q)
        work.limit_margin[s, p] = self.solver.limit_margin(q)
        if work.q is not None:
            work.q[s, p] = q
