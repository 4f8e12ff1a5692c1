"""Depth images as rays with a depth each, and what a part at some pose lets them see."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import NoCloudError
from skinplan.inspection.points import evenly
from skinplan.scanner.rays import RayCaster
from skinplan.transforms import Array, apply, inverse, rotate

# Points of several images whose rays differ by less than this belong to one pixel (tangent).
_PIXEL = 5e-4
# Surfaces more oblique than this to the ray say nothing reliable about the depth (cosine).
_GRAZING = float(np.cos(np.deg2rad(80.0)))


@dataclass(frozen=True, eq=False)
class DepthRays:
    """One depth per ray, averaged over images.

    Attributes:
        directions: Unit vectors, optical frame, shape (n, 3).
        depth: Along the optical axis, shape (n,) [m].
        sigma: Standard deviation of the depth, shape (n,) [m].
    """

    directions: Array
    depth: Array
    sigma: Array

    @classmethod
    def of(cls, points: Array, noise_at_1m_m: float, fewest: int) -> "DepthRays":
        """Averages the points of each pixel.

        Args:
            points: Of several images from one stand, optical frame, shape (n, 3) [m].
            noise_at_1m_m: Standard deviation of a depth of 1 m; grows with its square [m].
            fewest: So many rays at least.

        Raises:
            NoCloudError: Fewer rays.
        """
        before = points[points[:, 2] > 0.0]
        tangents = before[:, :2] / before[:, 2:]
        pixels = np.round(tangents / _PIXEL).astype(np.int64)
        _, number, count = np.unique(pixels, axis=0, return_inverse=True, return_counts=True)
        if len(count) < fewest:
            raise NoCloudError(
                f"{len(count)} pixels have a depth where the part may be, at least {fewest} are "
                "needed"
            )
        number = number.ravel()
        mean = np.stack([np.bincount(number, tangents[:, k]) / count for k in range(2)], axis=1)
        depth = np.bincount(number, before[:, 2]) / count
        ways = np.column_stack([mean, np.ones(len(count))])
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        return cls(ways, depth, noise_at_1m_m * depth**2 / np.sqrt(count))

    def thinned(self, count: int) -> "DepthRays":
        """About so many of the rays, spread evenly."""
        chosen = evenly(len(self.depth), count)
        return DepthRays(self.directions[chosen], self.depth[chosen], self.sigma[chosen])

    @property
    def points(self) -> Array:
        """Where the rays end, optical frame, shape (n, 3) [m]."""
        return np.asarray(self.directions / self.directions[:, 2:] * self.depth[:, None])


@dataclass(frozen=True, eq=False)
class Rendered:
    """What the rays should see of a part at a pose; not all of them meet it.

    Attributes:
        hit: Whether a ray meets the part, not too obliquely, shape (n,).
        residual: Measured depth minus that of the part, shape (n,) [m]; 0 without a hit.
        points: Where it is met, workpiece frame, shape (n, 3) [m].
        slopes: Change of the depth by a shift of the part, workpiece frame, shape (n, 3) [1].
    """

    hit: NDArray[np.bool_]
    residual: Array
    points: Array
    slopes: Array

    def jacobian(self, pivot: Array, size_m: float) -> Array:
        """Change of the depth by a motion of the part in its own frame, shape (n, 6) [1].

        Args:
            pivot: What it is turned about, workpiece frame, shape (3,) [m].
            size_m: Turns are counted in this length [m].
        """
        turned = np.cross(self.points - pivot, self.slopes) / size_m
        return np.hstack([turned, self.slopes])


def render(
    rays: DepthRays, caster: RayCaster, normals: Array, T_camera_workpiece: Array
) -> Rendered:
    """Casts the rays at the part.

    Args:
        rays: Of the camera.
        caster: The part.
        normals: Of its faces, shape (m, 3).
        T_camera_workpiece: Where it is taken to be, shape (4, 4) [m].
    """
    T_workpiece_camera = inverse(T_camera_workpiece)
    eye = apply(T_workpiece_camera, np.zeros((1, 3)))
    ways = rotate(T_workpiece_camera, rays.directions)
    distance, faces = caster.hits(np.repeat(eye, len(ways), axis=0), ways)
    normal = normals[faces]
    cosine = np.einsum("ij,ij->i", normal, ways)
    hit = (faces >= 0) & (np.abs(cosine) > _GRAZING)
    distance = np.where(hit, distance, 1.0)
    along = rays.directions[:, 2]
    residual = np.where(hit, rays.depth - distance * along, 0.0)
    slopes = normal * (np.where(hit, along, 0.0) / np.where(hit, cosine, 1.0))[:, None]
    return Rendered(hit, residual, eye + distance[:, None] * ways, slopes)
