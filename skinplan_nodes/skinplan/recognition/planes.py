"""The plane that most points lie on (RANSAC, then least squares), and what stands over it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import InputError, NoCloudError
from skinplan.inspection.points import checked_points, evenly
from skinplan.transforms import Array

_TRIED_POINTS = 4000


@dataclass(frozen=True, eq=False)
class Plane:
    """Points p with ``normal @ p = offset_m``.

    Attributes:
        normal: Unit vector, shape (3,).
        offset_m: Distance from the origin along it [m].
        inlier_ratio: Share of the points on it [1].
        rms_m: Root mean square distance of these [m].
    """

    normal: Array
    offset_m: float
    inlier_ratio: float
    rms_m: float

    def heights(self, points: Array) -> Array:
        """Signed distance of points, shape (n, 3) [m], along the normal, shape (n,) [m]."""
        return np.asarray(points @ self.normal - self.offset_m)


def find_plane(
    points: Array,
    toward: Array,
    seed: int = 0,
    distance_m: float = 0.0005,
    tries: int = 300,
    inlier_ratio_min: float = 0.1,
) -> Plane:
    """Finds the plane with most points near it.

    Args:
        points: shape (n, 3) [m].
        toward: The normal looks to this side, e.g. to the camera: a point, shape (3,) [m].
        seed: Of the random triples.
        distance_m: Points this near lie on the plane [m].
        tries: Number of triples.
        inlier_ratio_min: With a smaller share of the points there is no plane [1].

    Returns:
        The plane, by least squares through its points.

    Raises:
        NoCloudError: Too few points.
        InputError: Points that are not finite, or no plane among them.
    """
    cloud = checked_points(points)
    if len(cloud) < 3:
        raise NoCloudError(f"a plane was asked for; 3 points are accepted, found {len(cloud)}")
    middle = cloud.mean(axis=0)
    few = cloud[evenly(len(cloud), _TRIED_POINTS)] - middle
    normal, offset = _best_triple(few, np.random.default_rng(seed), distance_m, tries)
    centred = cloud - middle
    # Least squares over the points found; the second round over those of the better plane.
    for _ in range(3):
        near = np.abs(centred @ normal - offset) < distance_m
        if np.count_nonzero(near) < max(3, inlier_ratio_min * len(cloud)):
            raise InputError(
                f"a plane was asked for; {100 * near.mean():.1f} % of the points lie on the best "
                f"one, at least {100 * inlier_ratio_min:.1f} % are accepted"
            )
        normal, offset = _least_squares(centred[near])
    if normal @ (np.asarray(toward) - middle) - offset < 0.0:
        normal, offset = -normal, -offset
    away = centred @ normal - offset
    near = np.abs(away) < distance_m
    rms = float(np.sqrt(np.mean(away[near] ** 2)))
    return Plane(normal, float(offset + normal @ middle), float(near.mean()), rms)


def between(heights: Array, low_m: float, high_m: float) -> NDArray[np.bool_]:
    """Conditional filter: says which heights lie between two bounds, shape (n,)."""
    return (heights > low_m) & (heights < high_m)


def _best_triple(
    points: Array, rng: np.random.Generator, distance_m: float, tries: int
) -> tuple[Array, float]:
    corners = points[rng.integers(0, len(points), (tries, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals, corners = normals[lengths > 1e-12], corners[lengths > 1e-12]
    if len(normals) == 0:
        raise InputError("a plane was asked for; points that do not lie on one line are accepted")
    normals /= lengths[lengths > 1e-12, None]
    offsets = np.einsum("ij,ij->i", normals, corners[:, 0])
    counts = np.count_nonzero(np.abs(points @ normals.T - offsets) < distance_m, axis=0)
    best = int(np.argmax(counts))
    return normals[best], float(offsets[best])


def _least_squares(points: Array) -> tuple[Array, float]:
    middle = points.mean(axis=0)
    offset = points - middle
    _, vectors = np.linalg.eigh(offset.T @ offset)
    normal = vectors[:, 0]
    return normal, float(normal @ middle)
