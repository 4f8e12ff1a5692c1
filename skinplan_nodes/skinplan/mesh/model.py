"""The mesh types that the rooms exchange."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from skinplan.transforms import Array


@dataclass(frozen=True, eq=False)
class SurfaceMesh:
    """A triangle mesh of an open skin in the workpiece frame.

    Attributes:
        vertices: shape (v, 3) [m].
        faces: shape (f, 3), vertex numbers, counter-clockwise seen from outside (the side that is
            scanned).
        sha256: Hash of the file that it came from, lower-case hex; empty when it came from none.
    """

    vertices: Array
    faces: NDArray[np.int64]
    sha256: str = ""

    @cached_property
    def corners(self) -> Array:
        """Corner points of the faces, shape (f, 3, 3) [m]."""
        return self.vertices[self.faces]

    @cached_property
    def _crosses(self) -> Array:
        a, b, c = self.corners[:, 0], self.corners[:, 1], self.corners[:, 2]
        return np.cross(b - a, c - a)

    @cached_property
    def face_areas(self) -> Array:
        """Areas of the faces, shape (f,) [m^2]."""
        return 0.5 * np.linalg.norm(self._crosses, axis=1)

    @cached_property
    def face_normals(self) -> Array:
        """Outward unit normals of the faces, shape (f, 3); zero for faces without area."""
        lengths = np.linalg.norm(self._crosses, axis=1, keepdims=True)
        return np.divide(
            self._crosses, lengths, out=np.zeros_like(self._crosses), where=lengths > 0
        )

    @cached_property
    def vertex_normals(self) -> Array:
        """Area-weighted outward unit normals of the vertices, shape (v, 3); zero without faces."""
        sums = np.zeros_like(self.vertices)
        for corner in range(3):
            for axis in range(3):
                sums[:, axis] += np.bincount(
                    self.faces[:, corner],
                    weights=self._crosses[:, axis],
                    minlength=len(self.vertices),
                )
        lengths = np.linalg.norm(sums, axis=1, keepdims=True)
        return np.divide(sums, lengths, out=np.zeros_like(sums), where=lengths > 0)

    @cached_property
    def centroids(self) -> Array:
        """Centroids of the faces, shape (f, 3) [m]."""
        return self.corners.mean(axis=1)

    @property
    def area(self) -> float:
        """Area [m^2]."""
        return float(self.face_areas.sum())

    @property
    def bounds(self) -> Array:
        """Lower and upper corner of the axis-aligned box, shape (2, 3) [m]."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])


@dataclass(frozen=True, eq=False)
class Segmentation:
    """The parts of a mesh where curvature changes abruptly (M2.2 step 2).

    Attributes:
        face_region: shape (f,), 0 = flat continuous surface, 1.. = number of the complex region.
        smoothed: The mesh without small features; same faces, moved vertices. Its normals guide
            sampling.
    """

    face_region: NDArray[np.int64]
    smoothed: SurfaceMesh

    @property
    def regions(self) -> int:
        """Number of complex regions."""
        return int(self.face_region.max(initial=0))


@dataclass(frozen=True)
class Finding:
    """One thing that the mesh doctor found.

    Attributes:
        name: Short fixed name, e.g. ``duplicate faces``.
        count: How many.
        action: ``repaired``, ``refused`` or ``noted``.
        detail: What it is and what was done, one sentence.
        where: Up to three places, the worst first: points in the mesh's frame [m].
    """

    name: str
    count: int
    action: str
    detail: str
    where: tuple[tuple[float, float, float], ...] = ()
