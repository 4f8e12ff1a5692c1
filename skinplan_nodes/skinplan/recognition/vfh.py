"""The viewpoint feature histogram of Rusu et al. (2010), 308 bins.

With the centroid c and the mean normal u of a cloud, each point p with normal n gives, in the frame
``u, v = (p - c) / |p - c| x u, w = u x v`` (v made a unit vector), the angles

    theta = atan2(w . n, u . n),   alpha = v . n,   phi = u . (p - c) / |p - c|

and the distance |p - c|. Their histograms of 45 bins each are the shape component; 128 bins of the
cosine between n and the direction from the centroid to the camera are the viewpoint component.
"""

import numpy as np

from skinplan.errors import InputError
from skinplan.inspection.points import checked_points
from skinplan.transforms import Array

SHAPE_BINS, VIEW_BINS = 45, 128
BINS = 4 * SHAPE_BINS + VIEW_BINS
#: Where each histogram stands: theta, alpha, phi, distance, viewpoint.
SECTIONS = tuple(slice(k * SHAPE_BINS, (k + 1) * SHAPE_BINS if k < 4 else BINS) for k in range(5))


def vfh(points: Array, normals: Array, viewpoint: Array, size_m: float | None = None) -> Array:
    """Computes the descriptor.

    Args:
        points: shape (n, 3) [m].
        normals: Unit vectors, shape (n, 3).
        viewpoint: Where the camera stands, shape (3,) [m].
        size_m: Distances are counted in 45 steps up to this; larger ones in the last. None = up to
            the farthest point: then the descriptor does not change with the size.

    Returns:
        Shape (308,): theta, alpha, phi, distance (45 bins each), viewpoint (128), each of sum 100.
        Points on the axis through the centroid have no angles and are left out.

    Raises:
        InputError: Shapes, no points, normals whose mean vanishes (a closed surface), or a size
            that is not positive.
    """
    cloud, up = checked_points(points), checked_points(normals)
    if cloud.shape != up.shape or len(cloud) < 2:
        raise InputError(
            f"a descriptor was asked for; 2 points and as many normals are accepted, found "
            f"{len(cloud)} and {len(up)}"
        )
    centre, mean = cloud.mean(axis=0), up.mean(axis=0)
    length = float(np.linalg.norm(mean))
    if length < 1e-6:
        raise InputError(
            "a descriptor was asked for; a surface seen from one side is accepted, the normals "
            "found cancel out"
        )
    theta, alpha, phi, distance = _features(cloud - centre, up, mean / length)
    whole = float(distance.max()) if size_m is None else size_m
    if not whole > 0.0:
        raise InputError(f"a positive size of the distances is accepted, found {whole} m")
    toward = checked_points(np.asarray(viewpoint, dtype=float).reshape(1, -1))[0] - centre
    cosine = up @ (toward / max(float(np.linalg.norm(toward)), 1e-12))
    shape = (theta / (2.0 * np.pi) + 0.5, (alpha + 1.0) / 2.0, (phi + 1.0) / 2.0, distance / whole)
    parts = [_histogram(each, SHAPE_BINS) for each in shape]
    return np.concatenate([*parts, _histogram((cosine + 1.0) / 2.0, VIEW_BINS)])


def _features(offset: Array, normals: Array, u: Array) -> tuple[Array, Array, Array, Array]:
    distance = np.linalg.norm(offset, axis=1)
    across = np.cross(offset, u)
    width = np.linalg.norm(across, axis=1)
    # On the axis v has no direction.
    kept = width > 1e-9 * max(float(distance.max()), 1e-12)
    if not kept.any():
        raise InputError(
            "a descriptor was asked for; a surface is accepted, all points lie on one line"
        )
    offset, normals, distance = offset[kept], normals[kept], distance[kept]
    v = across[kept] / width[kept, None]
    w = np.cross(u, v)
    theta = np.arctan2(np.einsum("ij,ij->i", w, normals), normals @ u)
    alpha = np.einsum("ij,ij->i", v, normals)
    return theta, alpha, offset @ u / distance, distance


def _histogram(shares: Array, bins: int) -> Array:
    number = np.clip(np.floor(shares * bins).astype(np.int64), 0, bins - 1)
    return np.asarray(100.0 / len(shares) * np.bincount(number, minlength=bins))
