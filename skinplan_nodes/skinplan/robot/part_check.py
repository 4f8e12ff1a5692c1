"""Is the arm clear of the part and of the fixture behind it?"""

import numpy as np
from numpy.typing import NDArray

from skinplan.mesh.model import SurfaceMesh
from skinplan.robot.bodies import Bodies, first_hit, near_box
from skinplan.robot.cell_check import moved
from skinplan.robot.distance_field import distance_field
from skinplan.robot.exact import touches
from skinplan.robot.shapes import box_distances
from skinplan.transforms import Array

FIXTURE_DEPTH_M = 0.40
_SAMPLE_M = 0.05  # spacing of the points on capsule axes at which the distance field is read


class PartCheck:
    """All bodies against the part's mesh and the fixture box behind it.

    Attributes:
        names: Names of the pairs.
        exact_checks: How many body-mesh pairs the distance field could not decide so far.
    """

    def __init__(self, bodies: Bodies, mesh: SurfaceMesh, margin_m: float) -> None:
        self.exact_checks = 0
        self._bodies, self._mesh, self._margin = bodies, mesh, margin_m
        self._field = distance_field(mesh)
        self._low, self._high = mesh.bounds
        self._fixture_low = self._low - [0.0, 0.0, FIXTURE_DEPTH_M]
        self._fixture_high = np.array([self._high[0], self._high[1], self._low[2]])
        self._keep, self._reach = bodies.radii + margin_m, bodies.reach + margin_m
        self.names = [f"{name} with {t}" for t in ("fixture", "part") for name in bodies.names]
        lengths = 2.0 * (bodies.reach - bodies.radii)
        self._counts = np.maximum(1, np.ceil(lengths / _SAMPLE_M - 1e-9)).astype(np.int64)
        self._slack = 0.5 * lengths / self._counts

    def hits(self, segments: Array, T_part_arm: Array) -> NDArray[np.int64]:
        """Returns the number of the first pair that meets, from 1; 0 = none, shape (n,).

        Args:
            segments: Capsule axes in the arm base, shape (n, b, 2, 3) [m].
            T_part_arm: Arm base in the workpiece frame, shape (4, 4), or one each, (n, 4, 4) [m].
        """
        in_part = moved(segments, T_part_arm)
        fixture = self.fixture_hits(in_part)
        part = np.zeros_like(fixture)
        still = ~fixture.any(axis=1)
        part[still] = self.part_hits(in_part[still])
        return first_hit(np.concatenate([fixture, part], axis=1))

    def fixture_hits(self, in_part: Array) -> NDArray[np.bool_]:
        """Tells which capsules reach into the fixture box, shape (n, b)."""
        return near_box(in_part, self._keep, self._reach, self._fixture_low, self._fixture_high)

    def part_hits(self, in_part: Array) -> NDArray[np.bool_]:
        """Tells which capsules come too near to the mesh; of a row that has one, at least one."""
        middle = 0.5 * (in_part[:, :, 0] + in_part[:, :, 1])
        gap = box_distances(middle.reshape(-1, 3), self._low, self._high)
        near = np.asarray(gap.reshape(middle.shape[:2]) < self._reach)
        hits = np.zeros(near.shape, dtype=bool)
        row, body = np.nonzero(near)
        least = self._least_distance(in_part, row, body)
        sure = least + self._field.error < self._keep[body]
        hits[row[sure], body[sure]] = True
        decided = np.asarray(hits.any(axis=1))
        unsure = (least - self._field.error - self._slack[body] < self._keep[body]) & ~sure
        for one, which in zip(row[unsure], body[unsure], strict=True):
            if not decided[one]:
                self.exact_checks += 1
                ends = in_part[one, which]
                decided[one] = touches(self._mesh, self._bodies.items[which], ends, self._margin)
                hits[one, which] = decided[one]
        return hits

    def _least_distance(
        self, in_part: Array, row: NDArray[np.int64], body: NDArray[np.int64]
    ) -> Array:
        """Distance of the nearest of the points on each capsule's axis, by the distance field."""
        counts = self._counts[body]
        starts = np.cumsum(counts) - counts
        owner = np.repeat(np.arange(len(row)), counts)
        share = (np.arange(len(owner)) - starts[owner] + 0.5) / counts[owner]
        start, end = in_part[row, body, 0], in_part[row, body, 1]
        points = start[owner] + share[:, None] * (end - start)[owner]
        distance = self._field.distance(points)
        return np.minimum.reduceat(distance, starts) if len(row) else np.zeros(0)
