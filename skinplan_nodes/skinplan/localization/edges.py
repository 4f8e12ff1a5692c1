"""Corners of markers as intersections of lines fitted to their edges.

A corner finder that looks at the corner alone is drawn inwards by blur, and so makes the marker
look farther away (0.15 px at 1 m on rendered images, where this module is within 0.02 px). A
straight edge keeps its place under blur, and many places along it average the noise. How far the
places scatter about the line says how well the line, and so each corner, is known.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from skinplan.localization.camera import project_rays, undistorted
from skinplan.localization.model import CameraModel
from skinplan.transforms import Array

# Places along every edge, as share of its length: away from the corners, where blur mixes edges.
_ALONG = np.linspace(0.1, 0.9, 33)
# Half length of the profile across the edge: half a cell of the marker, within these bounds.
_ACROSS_CELLS = 0.5
_ACROSS_PX = (1.5, 4.0)
# Places on a profile, and how many at either end give the level of black and of white.
_TICKS = np.linspace(-1.0, 1.0, 33)
_LEVEL_TICKS = 3
_LEAST_GAIN = 0.5
# Least difference between black and white [grey levels].
_LEAST_STEP = 25.0
_LEAST_POINTS = 0.25
# The first round only comes near the edges: every so many places, and ticks.
_COARSE_ALONG, _COARSE_TICKS = 3, 2
# Edge points farther from the line are outliers: so many times the median distance.
_OUTLIER = 4.5
_LEAST_BOUND_PX = 0.05
# A refined corner farther away than this from the detector's is no improvement but a mistake.
_TRUST_PX = 2.5
_ROUNDS = 3
# How well the corners of a marker are known whose edges can't be fitted [px].
_UNFITTED_PX = 0.3
# Places along an edge with independent noise.
_INDEPENDENT_PER_PX = 0.6
# What remains of the corners' error however many images are taken: the pixels' own size, the
# texture of the print; and, where the blur is as wide as a cell, what the next cells mix in.
CORNER_FLOOR_PX = 0.009
_MIXED_PX = 0.55
_MAP_WIDTH = 1024
# Shorter profiles do not reach the levels of black and white [px].
_LEAST_REACH_PX = 3.0
# The place of a sharper edge among the pixels looks like skew [px].
_LEAST_WIDTH_PX = 0.6
# Grey values, difference between the levels, which are good, half length.
_Profiles = tuple[NDArray[np.float32], Array, NDArray[np.bool_], Array]
_BEFORE, _AFTER = [3, 0, 1, 2], [1, 2, 3, 0]


@dataclass(frozen=True, eq=False)
class RefinedCorners:
    """Corners of markers along their edges.

    Attributes:
        corners: shape (m, 4, 2) [px]; those of a marker whose edges can't be fitted stay.
        covariance: Random part of their error, shape (m, 8, 8) [px^2].
        floor_px: Part of it that does not get less with more images, shape (m,) [px].
        fitted: Which could be fitted, shape (m,).
        skew_px: Where half the light is reached, beyond the edge's place by the area under the
            profile, shape (m,) [px]; 0 = not fitted, or too small to tell.
    """

    corners: Array
    covariance: Array
    floor_px: Array
    fitted: NDArray[np.bool_]
    skew_px: Array


def refine_corners(
    grey: NDArray[np.uint8], corners: Array, cells: int, camera: CameraModel | None = None
) -> RefinedCorners:
    """Refines the corners of markers.

    Args:
        grey: shape (h, w).
        corners: To about two pixels, shape (m, 4, 2) [px].
        cells: Cells along the side of a marker, its border included.
        camera: Its distortion bends the edges; None = they are taken as straight in the image.
    """
    count = len(corners)
    refined = np.array(corners, dtype=float).reshape(count, 4, 2)
    covariance = np.tile(np.eye(8) * _UNFITTED_PX**2, (count, 1, 1))
    floor, usable = np.full(count, _UNFITTED_PX), np.zeros(count, dtype=bool)
    skew = np.zeros(count)
    for number in range(_ROUNDS if count else 0):
        points, good, shape = _edge_points(grey, refined, cells, near=number > 0)
        crossing, lines, fitted = _crossings(points, good, camera if number else None)
        moved = np.linalg.norm(crossing - corners, axis=2).max(axis=1)
        usable = fitted & (moved < _TRUST_PX)
        refined = np.where(usable[:, None, None], crossing, refined)
        if number == _ROUNDS - 1:
            spread = _corner_covariance(*lines, good)
            usable &= np.isfinite(spread).all(axis=(1, 2))
            covariance = np.where(usable[:, None, None], spread, covariance)
            tail, half = _profile_shape(*shape)
            floor = np.where(usable, np.hypot(CORNER_FLOOR_PX, _MIXED_PX * tail), floor)
            skew = np.where(usable, half, skew)
    return RefinedCorners(refined, covariance, floor, usable, skew)


def _edge_points(
    grey: NDArray[np.uint8], corners: Array, cells: int, *, near: bool
) -> tuple[Array, NDArray[np.bool_], _Profiles]:
    """Finds the edge's place on profiles across it.

    The area under the profile gives it: exact for any symmetric blur and any place of the edge
    between the pixels.

    Returns:
        Points, shape (m, 4, a, 2) [px], which are good, shape (m, 4, a), and the profiles, as
        `_profile_shape` takes them.
    """
    along = corners[:, _AFTER] - corners
    length = np.linalg.norm(along, axis=2, keepdims=True)
    across = np.stack([along[..., 1], -along[..., 0]], axis=-1) / np.maximum(length, 1e-9)
    reach = np.clip(_ACROSS_CELLS / cells * length.min(axis=1, keepdims=True), *_ACROSS_PX)
    places = _ALONG if near else _ALONG[::_COARSE_ALONG]
    base = corners[:, :, None] + along[:, :, None] * places[:, None]
    ticks = _TICKS if near else _TICKS[::_COARSE_TICKS]
    offset = (reach[..., None] * ticks)[..., None]
    values = looked_up(grey, base[..., None, :] + across[:, :, None, None] * offset)
    inner = values[..., :_LEVEL_TICKS].mean(axis=-1)
    outer = values[..., -_LEVEL_TICKS:].mean(axis=-1)
    step = outer - inner
    share = (outer - values.mean(axis=-1)) / np.maximum(step, 1.0)
    shift = (2.0 * share - 1.0) * reach
    good = (step > _LEAST_STEP) & (np.abs(shift) < reach)
    # Far from the edge, the ends of the profiles tell of other things.
    shift /= _gain(values, step, good) if near else 1.0
    points = base + across[:, :, None] * shift[..., None]
    return points, good, (values, step, good, reach[:, 0, 0])


def _gain(values: NDArray[np.float32], step: Array, good: NDArray[np.bool_]) -> Array:
    """Returns by how much of its way an edge shifts the area, shape (m, 1, 1).

    All of it where the profile's ends are level. Where the blur is as wide as the profile, the ends
    rise with the edge, and take a share away.
    """
    rise = values[..., _LEVEL_TICKS] - values[..., 0] + values[..., -1]
    rise -= values[..., -1 - _LEVEL_TICKS]
    weight = good / np.maximum(step, 1.0)
    share = _dot(weight, rise).sum(axis=1) / np.maximum(good.sum(axis=(1, 2)), 1)
    per_way = share / (_LEVEL_TICKS * (_TICKS[1] - _TICKS[0]))
    return np.maximum(1.0 - per_way, _LEAST_GAIN)[:, None, None]


def _profile_shape(
    values: NDArray[np.float32], step: Array, good: NDArray[np.bool_], reach: Array
) -> tuple[Array, Array]:
    """Looks at the mean profile across the edges of each marker, on which they lie in the middle.

    Returns:
        How much of the blur reaches beyond the profiles, by the steepest place of a step blurred by
        a Gaussian; and where the mean profile is at half of its height [px]; shape (m,) each.
    """
    weight = good / np.maximum(step, 1.0)
    count = np.maximum(good.sum(axis=(1, 2)), 1)
    mean = np.einsum("mea,meat->mt", weight, values) / count[:, None]
    per_px = np.diff(mean, axis=1).max(axis=1) / (reach * (_TICKS[1] - _TICKS[0]))
    width = 1.0 / (np.sqrt(2.0 * np.pi) * np.maximum(per_px, 1e-3))
    level = mean[:, :_LEVEL_TICKS].mean(axis=1) + mean[:, -_LEVEL_TICKS:].mean(axis=1)
    half = [np.interp(0.5 * at, row, _TICKS) for at, row in zip(level, mean, strict=True)]
    tells = (reach >= _LEAST_REACH_PX) & (width >= _LEAST_WIDTH_PX)
    skew = np.where(tells, np.array(half) * reach, 0.0)
    return np.exp(-0.5 * (reach / width) ** 2), skew


def looked_up(grey: NDArray[np.uint8], places: Array) -> NDArray[np.float32]:
    """Returns grey values at places, shape (..., 2) [px]; outside the image the nearest pixel's."""
    flat = places.reshape(-1, 2).astype(np.float32)
    rows = -(-len(flat) // _MAP_WIDTH)
    padded = np.zeros((rows * _MAP_WIDTH, 2), np.float32)
    padded[: len(flat)] = flat
    at = padded.reshape(rows, _MAP_WIDTH, 2)
    found = cv2.remap(
        grey, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return found.reshape(-1)[: len(flat)].reshape(places.shape[:-1]).astype(np.float32)


def _crossings(
    points: Array, good: NDArray[np.bool_], camera: CameraModel | None
) -> tuple[Array, tuple[Array, Array, Array], NDArray[np.bool_]]:
    """Intersects the lines through the edge points, without the bend of the distortion.

    Returns:
        Corners, shape (m, 4, 2) [px]; the same without distortion, the lines and the scatter about
        them, as `_corner_covariance` takes them; and which markers could be fitted, shape (m,).
    """
    if camera is None:
        straight = points
    else:
        focal = camera.K[0, 0]
        straight = undistorted(points.reshape(-1, 2), camera).reshape(points.shape) * focal
    lines, scatter, enough = _lines(straight, good)
    crossing = intersections(lines)
    fitted = enough.all(axis=1) & np.isfinite(crossing).all(axis=(1, 2))
    crossing = np.nan_to_num(crossing)
    corners = crossing
    if camera is not None:
        corners = project_rays(crossing / focal, camera)
        fitted &= np.isfinite(corners).all(axis=(1, 2))
    return corners, (crossing, lines, scatter), np.asarray(fitted, dtype=bool)


def _corner_covariance(
    corners: Array, lines: Array, scatter: Array, good: NDArray[np.bool_]
) -> Array:
    """Carries the scatter of the edge points over the two lines of each corner to the corners.

    A line through n points spread evenly over a span has independent errors of its offset and of
    its slope; places nearer to each other than about a pixel share their noise and count once.

    Returns:
        shape (m, 8, 8) [px^2].
    """
    length = np.linalg.norm(corners[:, _AFTER] - corners, axis=2)
    span = (_ALONG[-1] - _ALONG[0]) * length
    count = np.clip(span * _INDEPENDENT_PER_PX, 2.0, np.maximum(good.sum(axis=2), 2.0))
    offset = scatter[:, None] / np.sqrt(count)
    at_end = offset * np.sqrt(12.0) * 0.5 / (_ALONG[-1] - _ALONG[0])
    normal, before = lines[..., :2], lines[:, _BEFORE, :2]
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
        derivative[:, i, :, i, 1] = -solve[:, i, :, 1] * at_end[:, i, None]
    root = derivative.reshape(-1, 8, 8)
    return np.asarray(root @ root.swapaxes(1, 2))


def _lines(points: Array, good: NDArray[np.bool_]) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Fits lines n . p = c by total least squares, twice: without the outliers of the first fit.

    Returns:
        (n_x, n_y, c), shape (m, 4, 3), the scatter about the lines of each marker, shape (m,) [px],
        and whether there were enough points, shape (m, 4).
    """
    x, y = points[..., 0], points[..., 1]
    weights, middle = good.astype(float), points.shape[2] // 2
    for _ in range(2):
        total = np.maximum(weights.sum(axis=-1), 1e-9)
        at_x, at_y = _dot(weights, x) / total, _dot(weights, y) / total
        dx, dy = x - at_x[..., None], y - at_y[..., None]
        weighted = weights * dx
        xx, xy, yy = _dot(weighted, dx), _dot(weighted, dy), _dot(weights * dy, dy)
        # The longer axis of the scatter lies along the edge.
        angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
        normal_x, normal_y = -np.sin(angle), np.cos(angle)
        residual = np.abs(dx * normal_x[..., None] + dy * normal_y[..., None])
        used = weights
        usual = np.partition(residual, middle, axis=-1)[..., middle]
        bound = np.maximum(_OUTLIER * usual, _LEAST_BOUND_PX)
        weights = (good & (residual < bound[..., None])).astype(float)
    squares = _dot(used * residual, residual).sum(axis=1)
    free = np.maximum(used.sum(axis=(1, 2)) - 8.0, 1.0)
    lines = np.stack([normal_x, normal_y, normal_x * at_x + normal_y * at_y], axis=-1)
    return lines, np.sqrt(squares / free), weights.mean(axis=-1) >= _LEAST_POINTS


def _dot(a: NDArray[Any], b: NDArray[Any]) -> Array:
    """Returns sums over the last axis, shape (m, 4)."""
    return np.asarray(np.einsum("mea,mea->me", a, b))


def intersections(lines: Array) -> Array:
    """Returns the corner of each edge and the one before it, shape (m, 4, 2); NaN = parallel."""
    before = lines[:, _BEFORE]
    x, y, c = lines[..., 0], lines[..., 1], lines[..., 2]
    p, q, d = before[..., 0], before[..., 1], before[..., 2]
    depth = p * y - q * x
    depth = np.where(np.abs(depth) < 1e-9, np.nan, depth)
    return np.stack([d * y - q * c, p * c - d * x], axis=-1) / depth[..., None]
