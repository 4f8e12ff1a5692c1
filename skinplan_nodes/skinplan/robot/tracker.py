"""Does the tracker see the scanner? Scan data pass from the scanner to the tracker only (M1.1).

The scanner carries targets on a ring about its view axis, through its origin
(`TrackerSettings`). A pose counts as seen when enough targets are in the tracker's range and cone
and have a free line of sight: not hidden by the part, by the arm's capsules, by base and pedestal,
or by an obstacle of the cell. The scanner's own sphere hides no target, as they stand out from it.
"""

from collections.abc import Callable
from copy import copy
from functools import partial

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import InputError
from skinplan.mesh.model import SurfaceMesh
from skinplan.robot.bodies import SCANNER_LINK, Bodies
from skinplan.robot.cell import CellConfig, Obstacle
from skinplan.robot.cell_check import PEDESTAL_RADIUS_M, base_box, moved, pedestal_axis
from skinplan.robot.shapes import segment_box_distances, segment_distances
from skinplan.scanner.rays import RayCaster
from skinplan.transforms import Array, apply, inverse, require_transform

_START_M = 0.002  # rays start so far from the target

Codes = NDArray[np.int64]
_ARM, _BASE = 4, 5  # what hides the scanner, as number in `TrackerSight.names`
Concerned = tuple[Codes, NDArray[np.bool_]]  # poses, and which of their targets are hidden
Test = Callable[[Codes, Array, Array], Concerned]


class TrackerSight:
    """The tracker at one place, beside the part.

    Attributes:
        names: What keeps the tracker from seeing the scanner; number 0 is nothing.
    """

    def __init__(
        self,
        cell: CellConfig,
        mesh: SurfaceMesh | None,
        T_map_workpiece: Array | None = None,
        T_map_tracker: Array | None = None,
    ) -> None:
        """Places the tracker.

        Args:
            cell: The cell.
            mesh: The part, workpiece frame; None = no part.
            T_map_workpiece: Part in the shop, shape (4, 4) [m]; needed with a part.
            T_map_tracker: Tracker in the shop, shape (4, 4) [m]; None = the cell's.
        """
        placed = cell.T_map_tracker if T_map_tracker is None else T_map_tracker
        self.T_map_tracker = require_transform(placed, "T_map_tracker")
        self._settings = cell.tracker
        self._cell = cell
        self._base_low, self._base_high = base_box(cell)
        self._pedestal = pedestal_axis(cell)
        self._mesh = mesh
        if mesh is not None:
            if T_map_workpiece is None:
                raise InputError("a part without T_map_workpiece: its place is needed too")
            self._T_part_map = inverse(require_transform(T_map_workpiece, "T_map_workpiece"))
            self._rays = RayCaster(mesh)
            self._bounds = mesh.bounds
        turns = 2.0 * np.pi * np.arange(self._settings.targets) / self._settings.targets
        ring = np.stack([np.zeros_like(turns), np.cos(turns), np.sin(turns)], axis=1)
        self._ring = self._settings.ring_radius_m * ring
        self.names = [
            "seen",
            "the scanner is out of the tracker's range",
            "the scanner is outside the tracker's cone",
            "the scanner is hidden from the tracker by the part",
            "the scanner is hidden from the tracker by the arm",
            "the scanner is hidden from the tracker by the base",
            *(f"the scanner is hidden from the tracker by {o.name}" for o in cell.obstacles),
        ]

    def placed(self, T_map_tracker: Array) -> "TrackerSight":
        """Returns the same with the tracker elsewhere, shape (4, 4) [m]."""
        other = copy(self)
        other.T_map_tracker = require_transform(T_map_tracker, "T_map_tracker")
        return other

    def targets(self, T_map_scanner: Array) -> Array:
        """Returns the targets in the shop, shape (n, t, 3) [m], of scanner poses, (n, 4, 4) [m]."""
        turned = self._ring @ T_map_scanner[:, :3, :3].swapaxes(1, 2)
        return np.asarray(turned + T_map_scanner[:, None, :3, 3])

    def codes(
        self, bodies: Bodies, segments: Array, T_arm_scanner: Array, T_map_arm: Array
    ) -> Codes:
        """Returns why the tracker does not see the scanner, as number in `names`, shape (n,).

        Args:
            bodies: Arm and scanner.
            segments: Their axes in the arm base, shape (n, b, 2, 3) [m].
            T_arm_scanner: Scanner in the arm base, shape (n, 4, 4) [m].
            T_map_arm: Arm base in the shop, shape (n, 4, 4) [m].
        """
        T_map_scanner = T_map_arm @ T_arm_scanner
        targets, centres = self.targets(T_map_scanner), T_map_scanner[:, :3, 3]
        # Most poses show enough targets already among every second one.
        result = self._codes(bodies, segments, targets[:, ::2], centres, T_map_arm)
        left = np.flatnonzero(result > 0)
        result[left] = self._codes(
            bodies, segments[left], targets[left], centres[left], T_map_arm[left]
        )
        return result

    def _codes(
        self, bodies: Bodies, segments: Array, targets: Array, centres: Array, T_map_arm: Array
    ) -> Codes:
        arm = partial(self._arm_test, bodies, segments, T_map_arm)
        tests = self._pose_tests()
        tests |= {_ARM: arm, _BASE: partial(self._base_test, T_map_arm)}
        return self._run(tests, targets, centres)

    def pose_codes(self, T_map_scanner: Array) -> Codes:
        """Returns `codes` as far as they do not depend on how the arm holds the scanner, (n,).

        Args:
            T_map_scanner: Scanner poses, shape (n, 4, 4) [m].
        """
        return self._run(
            self._pose_tests(), self.targets(T_map_scanner), np.asarray(T_map_scanner[:, :3, 3])
        )

    def _pose_tests(self) -> dict[int, Test]:
        """Tests by the number of what they find."""
        tests: dict[int, Test] = {1: self._range_test, 2: self._cone_test, 3: self._part_test}
        for number, obstacle in enumerate(self._cell.obstacles, _BASE + 1):
            tests[number] = partial(self._obstacle_test, obstacle)
        return tests

    def _run(self, tests: dict[int, Test], targets: Array, centres: Array) -> Codes:
        visible = np.ones(targets.shape[:2], dtype=bool)
        result = np.zeros(len(targets), dtype=np.int64)
        goal = self.T_map_tracker[:3, 3]
        lines = np.stack([centres, np.broadcast_to(goal, centres.shape)], axis=1)
        # Each test first asks which poses it can concern at all: a ray as thick as the ring.
        for number in sorted(tests):
            still = np.flatnonzero(result == 0)
            row, hidden = tests[number](still, lines[still], targets)
            visible[row] &= ~hidden
            few = visible[row].sum(axis=1) < self._settings.targets_least
            result[row[few]] = number
        return result

    def in_view(self, T_map_scanner: Array) -> NDArray[np.bool_]:
        """Tells for which scanner poses, (n, 4, 4) [m], enough targets are in range and cone."""
        targets = self.targets(T_map_scanner)
        seen = ~self._out_of_range(targets) & ~self._outside_cone(targets)
        return np.asarray(seen.sum(axis=1) >= self._settings.targets_least)

    def _out_of_range(self, targets: Array) -> NDArray[np.bool_]:
        distance = np.linalg.norm(targets - self.T_map_tracker[:3, 3], axis=2)
        settings = self._settings
        return (distance < settings.range_min_m) | (distance > settings.range_max_m)

    def _outside_cone(self, targets: Array) -> NDArray[np.bool_]:
        way = targets - self.T_map_tracker[:3, 3]
        ahead = way @ self.T_map_tracker[:3, 0]
        return np.asarray(ahead < np.linalg.norm(way, axis=2) * np.cos(self._settings.cone_rad))

    def _range_test(self, still: Codes, lines: Array, targets: Array) -> Concerned:
        distance = np.linalg.norm(lines[:, 0] - lines[:, 1], axis=1)
        settings, rim = self._settings, self._settings.ring_radius_m
        low, high = settings.range_min_m + rim, settings.range_max_m - rim
        row = still[(distance < low) | (distance > high)]
        return row, self._out_of_range(targets[row])

    def _cone_test(self, still: Codes, lines: Array, targets: Array) -> Concerned:
        way = lines[:, 0] - lines[:, 1]
        distance = np.linalg.norm(way, axis=1)
        lean = np.arccos(np.clip(way @ self.T_map_tracker[:3, 0] / distance, -1.0, 1.0))
        wide = np.arcsin(np.clip(self._settings.ring_radius_m / distance, 0.0, 1.0))
        row = still[lean + wide > self._settings.cone_rad]
        return row, self._outside_cone(targets[row])

    def _part_test(self, still: Codes, lines: Array, targets: Array) -> Concerned:
        if self._mesh is None:
            return still[:0], np.zeros((0, targets.shape[1]), dtype=bool)
        in_part = apply(self._T_part_map, lines)
        low, high = self._bounds
        rim = self._settings.ring_radius_m
        near = np.ones(len(lines), dtype=bool)
        for axis in range(3):  # where both ends lie beyond one face of the box nothing is between
            start, end = in_part[:, 0, axis], in_part[:, 1, axis]
            near &= (np.maximum(start + rim, end) >= low[axis]) & (
                np.minimum(start - rim, end) <= high[axis]
            )
        row = still[near]
        starts = apply(self._T_part_map, targets[row]).reshape(-1, 3)
        way = in_part[0, 1] - starts if len(row) else starts
        length = np.linalg.norm(way, axis=1)
        along = way / np.maximum(length, 1e-12)[:, None]
        hits = self._rays.occluded(starts + _START_M * along, along, length)
        return row, hits.reshape(len(row), targets.shape[1])

    def _arm_test(
        self,
        bodies: Bodies,
        segments: Array,
        T_map_arm: Array,
        still: Codes,
        lines: Array,
        targets: Array,
    ) -> Concerned:
        own = np.flatnonzero(bodies.order < SCANNER_LINK)
        in_map = moved(segments[still][:, own], T_map_arm[still])
        rim = self._settings.ring_radius_m
        # Balls about the bodies first: most are far from the line of sight.
        pose, body = np.nonzero(
            _point_distances(0.5 * (in_map[:, :, 0] + in_map[:, :, 1]), lines)
            < bodies.reach[own] + rim
        )
        gap = segment_distances(lines[pose], in_map[pose, body])
        near = gap < bodies.radii[own][body] + rim
        pose, body = pose[near], body[near]
        count = targets.shape[1]
        sights = self._sights(targets[still[pose]]).reshape(-1, 2, 3)
        axes = np.repeat(in_map[pose, body], count, axis=0)
        distance = segment_distances(sights, axes).reshape(len(pose), count)
        hidden = np.zeros((len(still), count), dtype=bool)
        np.logical_or.at(hidden, pose, distance < bodies.radii[own][body][:, None])
        row = np.unique(pose)
        return still[row], hidden[row]

    def _base_test(self, T_map_arm: Array, still: Codes, lines: Array, targets: Array) -> Concerned:
        T_base_map = inverse(T_map_arm[still] @ inverse(self._cell.T_base_link_arm_base))
        in_base = moved(lines[:, None], T_base_map)[:, 0]
        rim, post = self._settings.ring_radius_m, np.broadcast_to(self._pedestal, in_base.shape)
        near = segment_distances(in_base, post) < PEDESTAL_RADIUS_M + rim
        near |= segment_box_distances(in_base, self._base_low, self._base_high) < rim
        row = np.flatnonzero(near)
        sights = moved(self._sights(targets[still[row]]), T_base_map[row])
        flat = sights.reshape(-1, 2, 3)
        post = np.broadcast_to(self._pedestal, flat.shape)
        hidden = segment_box_distances(flat, self._base_low, self._base_high) <= 0.0
        hidden |= segment_distances(flat, post) < PEDESTAL_RADIUS_M
        return still[row], hidden.reshape(sights.shape[:2])

    def _obstacle_test(
        self, obstacle: Obstacle, still: Codes, lines: Array, targets: Array
    ) -> Concerned:
        T_box_map, half = inverse(obstacle.T_map_box), 0.5 * np.array(obstacle.size_m)
        gap = segment_box_distances(apply(T_box_map, lines), -half, half)
        row = still[gap < self._settings.ring_radius_m]
        sights = apply(T_box_map, self._sights(targets[row])).reshape(-1, 2, 3)
        hidden = segment_box_distances(sights, -half, half) <= 0.0
        return row, hidden.reshape(len(row), targets.shape[1])

    def _sights(self, targets: Array) -> Array:
        """Lines of sight, shape (n, t, 2, 3) [m], in the shop."""
        tracker = np.broadcast_to(self.T_map_tracker[:3, 3], targets.shape)
        return np.stack([targets, tracker], axis=2)


def _point_distances(points: Array, lines: Array) -> Array:
    """Distances of points, (n, b, 3) [m], from one line segment each row, (n, 2, 3); (n, b)."""
    start, way = lines[:, 0], lines[:, 1] - lines[:, 0]
    gap = points - start[:, None]
    along = (gap @ way[:, :, None])[:, :, 0] / np.einsum("ni,ni->n", way, way)[:, None]
    share = np.clip(along, 0.0, 1.0)
    gap -= share[:, :, None] * way[:, None]
    return np.asarray(np.sqrt(np.einsum("nbi,nbi->nb", gap, gap)))
