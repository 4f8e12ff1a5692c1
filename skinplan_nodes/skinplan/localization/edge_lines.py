"""Lines through the points of edges, and what their scatter says of the corners between them."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skinplan.localization.camera import project_rays, undistorted
from skinplan.localization.model import CameraModel
from skinplan.transforms import Array

#: Edge i runs from corner i to corner AFTER[i]; the edge before it ends there.
BEFORE, AFTER = [3, 0, 1, 2], [1, 2, 3, 0]
# Share of an edge's places that have to lie on its line, and how many count at least.
_LEAST_POINTS, _LEAST_COUNT = 0.25, 3.0
# Edge points farther from the line are outliers: so many times the median distance.
_OUTLIER = 6.0
_LEAST_BOUND_PX = 0.05
# What the lines scatter more than their points say, the outliers left out and the levels of each
# profile among it; measured on rendered images, see docs/localization.md.
_BEYOND_POINTS = 1.04
# Weights by scatters that are themselves estimated are too large on an average: by 2 over their
# degrees of freedom of one marker, by 4 of many.
_BY_ESTIMATE = 3.0


@dataclass(frozen=True, eq=False)
class Lines:
    """Lines through edge points.

    Attributes:
        lines: (n_x, n_y, c) of n . p = c, shape (m, 4, 3).
        middle: Mean of the points, shape (m, 4, 2) [px].
        spread: Their standard deviation along the line, shape (m, 4) [px].
        count: How many of them are independent, shape (m, 4).
        scatter: About the lines of each marker, shape (m,) [px].
        enough: Whether there were enough points, shape (m, 4).
    """

    lines: Array
    middle: Array
    spread: Array
    count: Array
    scatter: Array
    enough: NDArray[np.bool_]


def narrowest_px(corners: Array) -> float:
    """Returns the shortest side of a marker with corners (4, 2) [px]."""
    along = corners - corners[BEFORE]
    return float(np.sqrt(np.einsum("ij,ij->i", along, along).min()))


def crossings(
    points: Array, good: NDArray[np.bool_], camera: CameraModel | None, fits: int = 2
) -> tuple[Array, tuple[Array, Lines], NDArray[np.bool_]]:
    """Intersects the lines through the edge points, without the bend of the distortion.

    Args:
        points: shape (m, 4, a, 2) [px].
        good: Which count, shape (m, 4, a).
        camera: Its distortion is taken away; None = there is none.
        fits: Every fit after the first is without the outliers of the one before.

    Returns:
        Corners, shape (m, 4, 2) [px]; the same without distortion and the lines, as
        `corner_covariance` takes them; and which markers could be fitted, shape (m,).
    """
    lines = fitted_lines(straightened(points, camera), good, fits)
    crossing = intersections(lines.lines)
    fitted = lines.enough.all(axis=1) & np.isfinite(crossing).all(axis=(1, 2))
    crossing = np.nan_to_num(crossing)
    corners = bent(crossing, camera)
    fitted &= np.isfinite(corners).all(axis=(1, 2))
    return corners, (crossing, lines), np.asarray(fitted, dtype=bool)


def straightened(points: Array, camera: CameraModel | None) -> Array:
    """Takes the distortion off points: pixels of a camera with square ones about (0, 0)."""
    if camera is None:
        return points
    return undistorted(points.reshape(-1, 2), camera).reshape(points.shape) * camera.K[0, 0]


def bent(points: Array, camera: CameraModel | None) -> Array:
    """Returns where points without distortion lie in the image; the inverse of `straightened`."""
    return points if camera is None else project_rays(points / camera.K[0, 0], camera)


def without(lines: Lines, hidden: NDArray[np.bool_], corners: Array, unknown_px: float) -> Lines:
    """Puts lines through corners in the place of hidden ones, of which nothing is known.

    Args:
        lines: Of which some could not be fitted.
        hidden: Which, shape (m, 4).
        corners: shape (m, 4, 2) [px].
        unknown_px: How badly they are known [px].
    """
    along = corners[:, AFTER] - corners
    length = np.maximum(np.hypot(along[..., 0], along[..., 1]), 1e-9)
    normal = np.stack([along[..., 1], -along[..., 0]], axis=-1) / length[..., None]
    offset = np.sum(normal * corners, axis=-1, keepdims=True)
    given = np.concatenate([normal, offset], axis=-1)
    middle = corners + 0.5 * along
    count = (lines.scatter[:, None] / unknown_px) ** 2
    return Lines(
        np.where(hidden[..., None], given, lines.lines),
        np.where(hidden[..., None], middle, lines.middle),
        np.where(hidden, 0.5 * length, lines.spread),
        np.where(hidden, count, lines.count),
        lines.scatter,
        lines.enough | hidden,
    )


def corner_covariance(corners: Array, lines: Lines) -> Array:
    """Carries the scatter of the edge points over the two lines of each corner to the corners.

    A line has independent errors of its place in the middle of its points and of its slope.

    Returns:
        shape (m, 8, 8) [px^2].
    """
    offset = lines.scatter[:, None] / np.sqrt(lines.count)
    normal, before = lines.lines[..., :2], lines.lines[:, BEFORE, :2]
    along = np.stack([normal[..., 1], -normal[..., 0]], axis=-1)
    lever = offset / np.maximum(lines.spread, 1e-9)
    at_start = lever * np.sum(along * (corners - lines.middle), axis=-1)
    at_end = lever * np.sum(along * (corners[:, AFTER] - lines.middle), axis=-1)
    # Inverse of the two normals as rows; parallel ones give no finite covariance.
    depth = before[..., 0] * normal[..., 1] - before[..., 1] * normal[..., 0]
    solve = np.empty((*depth.shape, 2, 2))
    solve[..., 0, 0], solve[..., 1, 0] = normal[..., 1], -normal[..., 0]
    solve[..., 0, 1], solve[..., 1, 1] = -before[..., 1], before[..., 0]
    solve /= np.where(np.abs(depth) < 1e-9, np.nan, depth)[..., None, None]
    # Corner i lies at the start of edge i and at the end of the edge before it.
    derivative = np.zeros((len(corners), 4, 2, 4, 2))
    for i in range(4):
        last = (i - 1) % 4
        derivative[:, i, :, last, 0] = solve[:, i, :, 0] * offset[:, last, None]
        derivative[:, i, :, last, 1] = solve[:, i, :, 0] * at_end[:, last, None]
        derivative[:, i, :, i, 0] = solve[:, i, :, 1] * offset[:, i, None]
        derivative[:, i, :, i, 1] = solve[:, i, :, 1] * at_start[:, i, None]
    root = derivative.reshape(-1, 8, 8)
    return np.asarray(root @ root.swapaxes(1, 2))


def fitted_lines(points: Array, good: NDArray[np.bool_], fits: int) -> Lines:
    """Fits lines n . p = c by total least squares."""
    x, y = points[..., 0], points[..., 1]
    weights, middle = good.astype(float), points.shape[2] // 2
    for _ in range(fits):
        total = np.maximum(weights.sum(axis=-1), 1e-9)
        at_x, at_y = dot(weights, x) / total, dot(weights, y) / total
        dx, dy = x - at_x[..., None], y - at_y[..., None]
        weighted = weights * dx
        xx, xy, yy = dot(weighted, dx), dot(weighted, dy), dot(weights * dy, dy)
        # The longer axis of the scatter lies along the edge.
        angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
        normal_x, normal_y = -np.sin(angle), np.cos(angle)
        residual = np.abs(dx * normal_x[..., None] + dy * normal_y[..., None])
        used = weights
        usual = np.partition(residual, middle, axis=-1)[..., middle]
        bound = np.maximum(_OUTLIER * usual, _LEAST_BOUND_PX)
        weights = (good & (residual < bound[..., None])).astype(float)
    squares = dot(used * residual, residual)
    spread = np.sqrt(np.maximum(xx + yy - squares, 0.0) / total)
    step = np.hypot(x[..., -1] - x[..., 0], y[..., -1] - y[..., 0]) / (x.shape[-1] - 1)
    count = np.maximum(total * _independent(step), _LEAST_COUNT)
    free = np.maximum((total * (1.0 - 2.0 / count)).sum(axis=1), 1.0)
    growth = 1.0 + _BY_ESTIMATE / np.maximum((count - 2.0).sum(axis=1), 1.0)
    return Lines(
        np.stack([normal_x, normal_y, normal_x * at_x + normal_y * at_y], axis=-1),
        np.stack([at_x, at_y], axis=-1),
        spread,
        count,
        _BEYOND_POINTS * np.sqrt(growth * squares.sum(axis=1) / free),
        weights.mean(axis=-1) >= _LEAST_POINTS,
    )


def _independent(step_px: Array) -> Array:
    """Returns which share of places along an edge have noise of their own, by their distance.

    A value between pixels is made of two in a row: a triangle of two pixels' base. Two places share
    what their triangles share, a cubic of their distance, nothing from two pixels on; nearer than
    one, two thirds of the pixels count.
    """
    shared = np.clip(2.0 - step_px, 0.0, 1.0) ** 3 / 2.0
    return np.asarray(np.minimum(step_px, 1.0) / (1.0 + shared))


def dot(a: NDArray[Any], b: NDArray[Any]) -> Array:
    """Returns sums over the last axis, shape (m, 4)."""
    return np.asarray(np.einsum("mea,mea->me", a, b))


def intersections(lines: Array) -> Array:
    """Returns the corner of each edge and the one before it, shape (m, 4, 2); NaN = parallel."""
    before = lines[:, BEFORE]
    x, y, c = lines[..., 0], lines[..., 1], lines[..., 2]
    p, q, d = before[..., 0], before[..., 1], before[..., 2]
    depth = p * y - q * x
    depth = np.where(np.abs(depth) < 1e-9, np.nan, depth)
    return np.stack([d * y - q * c, p * c - d * x], axis=-1) / depth[..., None]
