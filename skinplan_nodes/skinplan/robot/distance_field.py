"""Bounds on the distance to a mesh from a grid: the filter in front of exact collision checks."""

import logging
from functools import lru_cache

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree
from trimesh.remesh import subdivide_to_size

from skinplan.mesh.model import SurfaceMesh
from skinplan.transforms import Array

_LOG = logging.getLogger(__name__)
_GRID_M = 0.02
_EDGE_M = 0.02
_REACH_M = 0.30  # the grid ends so far from the mesh; beyond, its bounding box is used
_MAX_SAMPLES = 200_000
_MAX_NODES = 2_000_000


class DistanceField:
    """Distance to a mesh, to a known error, at any number of points.

    With samples no farther than ``delta`` from any point of the mesh, the distance to the nearest
    sample is at most ``delta`` too long. Distance changes at most as fast as the point moves, so
    interpolation in cells of side g is wrong by at most ``sqrt(3)/2 g``. Hence ``true >= value -
    error`` and ``true <= value + error``.

    Attributes:
        error: Largest error of `distance` up to `reach` [m].
        reach: Distances beyond this are only known to be at least this [m].
        samples: Points on the mesh, shape (m, 3) [m].
        spacing: No point of the mesh is farther from the nearest sample than this [m].
    """

    def __init__(self, mesh: SurfaceMesh) -> None:
        samples, delta = _samples(mesh)
        self.samples, self.spacing = samples, delta
        self._low, self._high = mesh.bounds[0], mesh.bounds[1]
        extent = self._high - self._low + 2.0 * _REACH_M
        self._step = max(_GRID_M, float((np.prod(extent) / _MAX_NODES) ** (1.0 / 3.0)))
        self._origin = self._low - _REACH_M
        counts = np.ceil(extent / self._step).astype(int) + 1
        axes = [self._origin[a] + self._step * np.arange(counts[a]) for a in range(3)]
        nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        nearest, _ = cKDTree(samples).query(nodes, distance_upper_bound=_REACH_M)
        self._values = np.minimum(nearest, _REACH_M).reshape(counts).astype(np.float32)
        self.error = delta + 0.5 * np.sqrt(3.0) * self._step + 1e-5
        self.reach = _REACH_M
        _LOG.debug(
            "distance field: %s nodes, %d samples, error %.3f m",
            counts.tolist(),
            len(samples),
            self.error,
        )

    def distance(self, points: Array) -> Array:
        """Returns distances to the mesh to within `error`, (n,) [m]; from `reach` on lower bounds.

        Args:
            points: In the mesh's frame, shape (n, 3) [m].
        """
        places = (points - self._origin) / self._step
        inside = map_coordinates(self._values, places.T, order=1, mode="nearest")
        outside = np.linalg.norm(
            np.maximum(np.maximum(self._low - points, points - self._high), 0.0), axis=1
        )
        return np.asarray(np.where(outside >= _REACH_M, outside, inside))


@lru_cache(maxsize=4)
def distance_field(mesh: SurfaceMesh) -> DistanceField:
    """Returns the mesh's distance field; built once per mesh object."""
    return DistanceField(mesh)


def _samples(mesh: SurfaceMesh) -> tuple[Array, float]:
    """Points on the mesh, and how far any point of it is from the nearest of them at most [m]."""
    longest = float(np.linalg.norm(mesh.corners - np.roll(mesh.corners, 1, axis=1), axis=2).max())
    # Coarser for large parts: 0.43 s^2 is the area of an equilateral triangle of side s.
    edge = max(_EDGE_M, float(np.sqrt(mesh.area / (0.2 * _MAX_SAMPLES))))
    points = mesh.vertices[np.unique(mesh.faces)]
    if longest > edge:
        points, _ = subdivide_to_size(mesh.vertices, mesh.faces, max_edge=edge, max_iter=40)
        longest = edge
    delta = longest / np.sqrt(
        3.0
    )  # the centre of an equilateral triangle is the farthest from its corners
    if len(points) > _MAX_SAMPLES:
        cell = 0.004
        _, kept = np.unique(np.floor(points / cell).astype(np.int64), axis=0, return_index=True)
        points, delta = points[np.sort(kept)], delta + cell * np.sqrt(3.0)
    return points, float(delta)
