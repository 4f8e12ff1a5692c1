"""The part as a wide field of view sees it: heights and normals averaged over discs."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skinplan.mesh.model import SurfaceMesh
from skinplan.scan_path.frame import LEAST_FACING
from skinplan.scanner.samples import sample_surface
from skinplan.transforms import Array

# Averages are taken over samples this share of the radius apart.
_SAMPLE_RATIO = 0.1
_BATCH = 4096


class AveragedSurface:
    """Averages of the side of a part that faces the scanner.

    A scanner that follows them moves evenly over grooves and bumps smaller than its field of view.
    """

    def __init__(self, mesh: SurfaceMesh, base: Array, radius_m: float) -> None:
        """Samples a part.

        Args:
            mesh: The part.
            base: Mean outward normal of the part, shape (3,).
            radius_m: Radius of the field of view [m].
        """
        samples = sample_surface(mesh, _SAMPLE_RATIO * radius_m)
        facing = samples.normals @ base > LEAST_FACING
        self._points, self._normals = samples.points[facing], samples.normals[facing]
        self._tree = cKDTree(self._points.reshape(-1, 3))
        self._base, self._radius = base, radius_m

    def at(self, places: Array) -> tuple[Array, Array]:
        """Finds the averaged surface near places on the part.

        Args:
            places: shape (n, 3) [m].

        Returns:
            The places moved along the averaged normal to the mean height of the surface within
            half the radius, shape (n, 3) [m], and the mean normals within the radius, unit, shape
            (n, 3); the base normal where nothing is near.
        """
        points, normals = np.empty_like(places), np.empty_like(places)
        for begin in range(0, len(places), _BATCH):
            part = slice(begin, begin + _BATCH)
            points[part], normals[part] = self._averages(places[part])
        return points, normals

    def _averages(self, places: Array) -> tuple[Array, Array]:
        pairs = cKDTree(places).sparse_distance_matrix(
            self._tree, self._radius, output_type="ndarray"
        )
        pairs = pairs[np.lexsort((pairs["j"], pairs["i"]))]
        normals = _sums(pairs["i"], self._normals[pairs["j"]], len(places))
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = np.where(lengths > 1e-9, normals / np.maximum(lengths, 1e-9), self._base)
        near = pairs[pairs["v"] <= self._radius / 2]
        count = np.maximum(np.bincount(near["i"], minlength=len(places)), 1)[:, None]
        offset = self._points[near["j"]] - places[near["i"]]
        mean = _sums(near["i"], offset, len(places)) / count
        height = np.einsum("ij,ij->i", mean, normals)[:, None]
        return places + height * normals, normals


def _sums(owner: NDArray[np.int64], values: Array, count: int) -> Array:
    return np.stack(
        [np.bincount(owner, weights=values[:, axis], minlength=count) for axis in range(3)], axis=1
    )
