"""Which capsules come too near to the part: a distance field decides most, coal the rest."""

import numpy as np
from numpy.typing import NDArray

from skinplan.mesh.model import SurfaceMesh
from skinplan.robot.arm import Body
from skinplan.robot.distance_field import distance_field
from skinplan.robot.exact import touches
from skinplan.transforms import Array

_SAMPLE_M = 0.04  # spacing of the points on capsule axes at which the field is read


class PartClearance:
    """The part as an obstacle for a fixed set of capsules."""

    def __init__(self, mesh: SurfaceMesh, bodies: tuple[Body, ...], margin_m: float) -> None:
        """Prepares the sample points.

        Args:
            mesh: The part, in its own frame.
            bodies: The capsules; only their lengths and radii are used.
            margin_m: Distance to be kept [m].
        """
        self._mesh, self._bodies, self._margin = mesh, bodies, margin_m
        self._field = distance_field(mesh)
        self._keep = np.array([body.radius for body in bodies]) + margin_m
        lengths = [float(np.linalg.norm(body.ends[1] - body.ends[0])) for body in bodies]
        self._counts = [max(1, int(np.ceil(length / _SAMPLE_M))) for length in lengths]
        self._slack = 0.5 * np.array(lengths) / np.array(self._counts)

    def hits(self, segments: Array, numbers: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Tells which capsules come nearer than the margin.

        Args:
            segments: Axes in the part's frame, shape (n, b, 2, 3) [m].
            numbers: Numbers of the bodies, shape (b,).

        Returns:
            shape (n, b); behind the first body found in a row the others may be left undecided.
        """
        least = np.stack(
            [self._least(segments[:, k], int(body)) for k, body in enumerate(numbers)], axis=1
        )
        keep, error = self._keep[numbers], self._field.error
        hits = least + error < keep
        unsure = (least - error - self._slack[numbers] < keep) & ~hits
        unsure[hits.any(axis=1)] = False
        for row, k in zip(*np.nonzero(unsure), strict=True):
            if not hits[row].any():
                body = self._bodies[int(numbers[k])]
                hits[row, k] = touches(self._mesh, body, segments[row, k], self._margin)
        return np.asarray(hits)

    def _least(self, axes: Array, body: int) -> Array:
        """Least field value at the samples of one body's axes, (n, 2, 3) [m], shape (n,)."""
        count = self._counts[body]
        share = ((np.arange(count) + 0.5) / count)[:, None]
        points = axes[:, None, 0] + share * (axes[:, None, 1] - axes[:, None, 0])
        return np.asarray(
            self._field.distance(points.reshape(-1, 3)).reshape(-1, count).min(axis=1)
        )
