"""Passes with wide spacing, and the candidate poses on them (strategy ``coverage``)."""

import math

import numpy as np
from numpy.typing import NDArray

from skinplan.mesh.model import SurfaceMesh
from skinplan.scan_path.averages import AveragedSurface
from skinplan.scan_path.cut import Polylines, cut_mesh
from skinplan.scan_path.frame import RowFrame
from skinplan.scan_path.poses import Poses
from skinplan.scan_path.rows import joined_curves, scannable_faces
from skinplan.transforms import Array

Indices = NDArray[np.int64]

# The outer passes, and the ends of each, keep this share of r_f from the edge: the scanner sees the
# edge from inside the part, where the arm reaches more easily and nothing is overrun.
INSET_RATIO = 0.4
# Poses on a pass stand this share of r_f apart.
STEP_RATIO = 0.2
# A pass goes on behind a gap shorter than this share of r_f.
_GAP_RATIO = 0.5
# Passes farther apart than this share of r_f leave a strip between them that neither sees.
_WIDEST_RATIO = 1.7


class PassCutter:
    """Cuts a part into passes."""

    def __init__(
        self,
        mesh: SurfaceMesh,
        surface: AveragedSurface,
        frame: RowFrame,
        radius_m: float,
        standoff_m: float,
    ) -> None:
        """Prepares a part.

        Args:
            mesh: The part.
            surface: Its averages: the passes follow them.
            frame: Directions of the passes.
            radius_m: r_f [m].
            standoff_m: d_best [m].
        """
        self._mesh, self._surface, self._frame = mesh, surface, frame
        self._radius, self._standoff = radius_m, standoff_m
        self._use = scannable_faces(mesh, frame.base)
        across = mesh.vertices[mesh.faces[self._use].ravel()] @ frame.across
        self._low, self._high = (
            (float(across.min()), float(across.max())) if len(across) else (0.0, 0.0)
        )

    @property
    def fewest(self) -> int:
        """Number of passes below which strips are left between them, at least 1."""
        between = self._high - self._low - 2.0 * self._inset(self._high - self._low)
        return 1 + max(0, math.ceil(between / (_WIDEST_RATIO * self._radius) - 1e-6))

    @property
    def length_m(self) -> float:
        """Length of the fewest passes and of the way from each to the next [m]."""
        lines = self._lines(self.fewest)
        step = np.linalg.norm(np.diff(lines.points, axis=0), axis=1)
        same = np.ones(len(step), dtype=bool)
        same[lines.starts[1:-1] - 1] = False
        return float(step[same].sum()) + self._high - self._low

    def cut(self, count: int) -> Poses:
        """Returns candidate poses on evenly spaced passes.

        Args:
            count: Number of cutting planes, at least 1. A pass that a hole cuts in two has two
                numbers.
        """
        lines = self._lines(count)
        targets: list[Array] = []
        numbers: list[Indices] = []
        for piece in joined_curves(lines, _GAP_RATIO * self._radius):
            points = self._spread(lines.points[piece])
            numbers.append(np.full(len(points), len(numbers), dtype=np.int64))
            targets.append(points)
        if not targets:
            return Poses.none()
        points, normals = self._surface.at(np.concatenate(targets))
        return Poses.looking(points, normals, self._standoff, np.concatenate(numbers))

    def _lines(self, count: int) -> Polylines:
        return cut_mesh(
            self._mesh, self._mesh.vertex_normals, self._use, self._frame, self._offsets(count)
        )

    def _inset(self, length_m: float) -> float:
        return min(INSET_RATIO * self._radius, length_m / 2)

    def _offsets(self, count: int) -> Array:
        if count == 1:
            return np.array([(self._low + self._high) / 2])
        inset = self._inset(self._high - self._low)
        return np.linspace(self._low + inset, self._high - inset, count)

    def _spread(self, points: Array) -> Array:
        """Spreads points over a curve by their place along the pass: a wall adds no length."""
        # At an overhang a curve steps back; the place along the pass never does.
        rising = np.maximum.accumulate(points @ self._frame.along)
        inset = self._inset(float(rising[-1] - rising[0]))
        low, high = float(rising[0]) + inset, float(rising[-1]) - inset
        steps = round((high - low) / (STEP_RATIO * self._radius))
        wanted = np.linspace(low, high, steps + 1) if steps else np.array([(low + high) / 2])
        return np.stack([np.interp(wanted, rising, axis) for axis in points.T], axis=1)
