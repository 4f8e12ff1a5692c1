"""Where a surface ends: the open border of a mesh, and of a cloud.

A flat part tells by its border, and by nothing else, where it lies along itself.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skinplan.inspection.closest import edge_neighbours
from skinplan.mesh.model import SurfaceMesh
from skinplan.transforms import Array

# Distance between the points that stand for the border [m].
_STEP_M = 0.001
# The outermost point of a stretch of border should lie about so far inside [m]; stretches are no
# shorter and no longer than this [m], and there are so many at least.
_INSET_M = 5e-5
_SHORTEST_M, _LONGEST_M, _FEWEST = 0.01, 0.05, 40
# Neighbours that tell whether a point lies at the end of the cloud, and the angle without any of
# them that says so.
_NEIGHBOURS = 24
_OPEN_RAD = np.deg2rad(135.0)
_BATCH = 50_000


@dataclass(frozen=True, eq=False)
class BorderRows:
    """Cloud points at the end of the cloud, with the border of the part beside them.

    Attributes:
        points: shape (n, 3) [m].
        outward: Unit vectors out of the part, in its surface, shape (n, 3).
        beyond: How far each point lies beyond the border, shape (n,) [m].
        reach: Largest distance of a point from its border, in any direction, shape (n,) [m].
    """

    points: Array
    outward: Array
    beyond: Array
    reach: Array


class Border:
    """The open border of a mesh, holes included.

    Args:
        mesh: The part, workpiece frame.
    """

    def __init__(self, mesh: SurfaceMesh) -> None:
        face, corner = np.nonzero(edge_neighbours(mesh) < 0)
        corners = mesh.corners[face]
        row = np.arange(len(face))
        first, second = corners[row, (corner + 1) % 3], corners[row, (corner + 2) % 3]
        along = second - first
        length = np.linalg.norm(along, axis=1)
        # Out of the part: away from the third corner, perpendicular to the edge.
        outward = np.cross(along, mesh.face_normals[face])
        good = (length > 0.0) & (np.linalg.norm(outward, axis=1) > 0.0)
        first, along, length, outward = first[good], along[good], length[good], outward[good]
        self.length_m = float(length.sum())
        count = np.maximum(1, np.ceil(length / _STEP_M).astype(np.int64))
        owner = np.repeat(np.arange(len(length)), count)
        share = (np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[
            owner
        ]
        self.points = first[owner] + share[:, None] * along[owner]
        unit = outward / np.linalg.norm(outward, axis=1, keepdims=True)
        self.outward = unit[owner]

    @property
    def empty(self) -> bool:
        """Whether there is no open border."""
        return len(self.points) == 0

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.points)

    def stretch_m(self, density_per_m2: float) -> float:
        """Returns how long stretches of border should be for a cloud of that density [m]."""
        most = min(_LONGEST_M, self.length_m / _FEWEST)
        wanted = 1.0 / max(density_per_m2 * _INSET_M, 1e-12)
        return max(_SHORTEST_M, min(wanted, most))

    def rows(self, points: Array, reach_m: float) -> BorderRows:
        """Lays points at the end of a cloud on the border.

        Args:
            points: Workpiece frame, shape (n, 3) [m].
            reach_m: Points farther from the border than this are left out [m].
        """
        distance, near = self._tree.query(points, distance_upper_bound=reach_m)
        found = np.isfinite(distance)
        points, near = points[found], near[found]
        away = points - self.points[near]
        beyond = np.einsum("ij,ij->i", away, self.outward[near])
        return BorderRows(points, self.outward[near], beyond, distance[found])

    def near(self, points: Array, reach_m: float) -> NDArray[np.bool_]:
        """Says which points lie near the border, shape (n,); many points, little memory."""
        found = np.zeros(len(points), dtype=bool)
        low, high = self.points.min(axis=0) - reach_m, self.points.max(axis=0) + reach_m
        for begin in range(0, len(points), _BATCH):
            part = points[begin : begin + _BATCH]
            inside = np.flatnonzero(np.all((part >= low) & (part <= high), axis=1))
            distance, _ = self._tree.query(part[inside], distance_upper_bound=reach_m, workers=2)
            found[begin + inside] = np.isfinite(distance)
        return found

    def outermost(self, points: Array, reach_m: float, stretch_m: float) -> BorderRows:
        """Returns the outermost point of each stretch of the border.

        Args:
            points: Points near the border, workpiece frame, shape (n, 3) [m].
            reach_m: Largest distance from the border [m].
            stretch_m: About the length of a stretch [m].
        """
        cells = np.floor(self.points / stretch_m).astype(np.int64)
        stretch = np.unique(cells, axis=0, return_inverse=True)[1].reshape(-1)
        distance, near = self._tree.query(points, distance_upper_bound=reach_m)
        found = np.flatnonzero(np.isfinite(distance))
        near = near[found]
        away = points[found] - self.points[near]
        beyond = np.einsum("ij,ij->i", away, self.outward[near])
        order = np.lexsort((-beyond, stretch[near]))
        _, first = np.unique(stretch[near][order], return_index=True)
        chosen = order[first]
        return BorderRows(
            points[found[chosen]],
            self.outward[near[chosen]],
            beyond[chosen],
            distance[found[chosen]],
        )


def cloud_ends(points: Array) -> NDArray[np.bool_]:
    """Says which points lie at the end of the surface that a cloud shows.

    Seen along the normal of the plane through its neighbours, such a point has none of them over a
    wide angle.

    Args:
        points: Spread about evenly, shape (n, 3) [m].

    Returns:
        shape (n,).
    """
    ends = np.zeros(len(points), dtype=bool)
    count = min(_NEIGHBOURS + 1, len(points))
    if count < 4:
        return ends
    tree = cKDTree(points)
    for begin in range(0, len(points), _BATCH):
        part = slice(begin, begin + _BATCH)
        _, near = tree.query(points[part], k=count, workers=2)
        around = points[near[:, 1:]] - points[part][:, None]
        _, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
        u = np.einsum("nki,ni->nk", around, axes[:, :, 2])
        v = np.einsum("nki,ni->nk", around, axes[:, :, 1])
        angle = np.sort(np.arctan2(v, u), axis=1)
        gap = np.diff(angle, axis=1, append=angle[:, :1] + 2.0 * np.pi).max(axis=1)
        ends[part] = gap > _OPEN_RAD
    return ends
