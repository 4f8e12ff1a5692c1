"""Corners of markers as intersections of lines fitted to their edges.

A corner finder that looks at the corner alone is drawn inwards by blur, and so makes the marker
look farther away (0.15 px at 1 m on rendered images, where this module is within 0.02 px). A
straight edge keeps its place under blur, and many places along it average the noise.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from skinplan.localization.camera import project, undistorted
from skinplan.localization.model import CameraModel
from skinplan.transforms import Array

# Places along every edge, as share of its length: away from the corners, where blur mixes edges.
_ALONG = np.linspace(0.1, 0.9, 33)
# Half length of the profile across the edge: half a cell of the marker, within these bounds.
_ACROSS_SHARE = 0.07
_ACROSS_PX = (1.5, 4.0)
# Places on a profile, and how many at either end give the level of black and of white.
_TICKS = np.linspace(-1.0, 1.0, 33)
_LEVEL_TICKS = 3
# Least difference between black and white [grey levels].
_LEAST_STEP = 25.0
_LEAST_POINTS = 8
_LEAST_BOUND_PX = 0.05
# A refined corner farther away than this from the detector's is no improvement but a mistake.
_TRUST_PX = 2.5
_ROUNDS = 2
_MAP_WIDTH = 1024


def refine_corners(
    grey: NDArray[np.uint8], corners: Array, camera: CameraModel | None = None
) -> Array:
    """Refines the corners of markers.

    Args:
        grey: shape (h, w).
        corners: To about a pixel, shape (m, 4, 2) [px].
        camera: Its distortion bends the edges; None = they are taken as straight in the image.

    Returns:
        Refined corners, shape (m, 4, 2) [px]; those of a marker whose edges can't be fitted stay.
    """
    if len(corners) == 0:
        return corners
    refined = corners
    for _ in range(_ROUNDS):
        points, good = _edge_points(grey, refined)
        crossing, fitted = _crossings(points, good, camera)
        moved = np.linalg.norm(crossing - corners, axis=2).max(axis=1)
        usable = fitted & (moved < _TRUST_PX)
        refined = np.where(usable[:, None, None], crossing, refined)
    return refined


def _edge_points(grey: NDArray[np.uint8], corners: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Finds the edge's place on profiles across it.

    The area under the profile gives it: exact for any symmetric blur and any place of the edge
    between the pixels.

    Returns:
        Points, shape (m, 4, a, 2) [px], and which are good, shape (m, 4, a).
    """
    along = np.roll(corners, -1, axis=1) - corners
    length = np.linalg.norm(along, axis=2, keepdims=True)
    across = np.stack([along[..., 1], -along[..., 0]], axis=-1) / np.maximum(length, 1e-9)
    reach = np.clip(_ACROSS_SHARE * length.min(axis=1, keepdims=True), *_ACROSS_PX)
    base = corners[:, :, None] + along[:, :, None] * _ALONG[:, None]
    offset = (reach[..., None] * _TICKS)[..., None]
    values = _looked_up(grey, base[..., None, :] + across[:, :, None, None] * offset)
    inner = values[..., :_LEVEL_TICKS].mean(axis=-1)
    outer = values[..., -_LEVEL_TICKS:].mean(axis=-1)
    share = (outer - values.mean(axis=-1)) / np.maximum(outer - inner, 1.0)
    shift = (2.0 * share - 1.0) * reach
    good = (outer - inner > _LEAST_STEP) & (np.abs(shift) < reach)
    return base + across[:, :, None] * shift[..., None], good


def _looked_up(grey: NDArray[np.uint8], places: Array) -> Array:
    """Returns grey values at places, shape (..., 2) [px]; outside the image the nearest pixel's."""
    flat = places.reshape(-1, 2).astype(np.float32)
    rows = -(-len(flat) // _MAP_WIDTH)
    padded = np.zeros((rows * _MAP_WIDTH, 2), np.float32)
    padded[: len(flat)] = flat
    at = padded.reshape(rows, _MAP_WIDTH, 2)
    found = cv2.remap(
        grey, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return found.reshape(-1)[: len(flat)].reshape(places.shape[:-1]).astype(float)


def _crossings(
    points: Array, good: NDArray[np.bool_], camera: CameraModel | None
) -> tuple[Array, NDArray[np.bool_]]:
    """Intersects the lines through the edge points, without the bend of the distortion.

    Returns:
        Corners, shape (m, 4, 2) [px], and which markers could be fitted, shape (m,).
    """
    if camera is None:
        lines, enough = _lines(points, good)
        corners = _intersections(lines)
    else:
        focal = camera.K[0, 0]
        straight = undistorted(points.reshape(-1, 2), camera).reshape(points.shape)
        lines, enough = _lines(straight * focal, good)
        rays = _intersections(lines).reshape(-1, 2) / focal
        enough &= np.isfinite(rays).all(axis=1).reshape(enough.shape)
        rays = np.nan_to_num(rays)
        corners = project(np.column_stack([rays, np.ones(len(rays))]), camera).reshape(-1, 4, 2)
    fitted = np.all(enough, axis=1) & np.all(np.isfinite(corners), axis=(1, 2))
    return corners, np.asarray(fitted, dtype=bool)


def _lines(points: Array, good: NDArray[np.bool_]) -> tuple[Array, NDArray[np.bool_]]:
    """Fits lines n . p = c by total least squares, twice: without the outliers of the first fit.

    Returns:
        (n_x, n_y, c), shape (m, 4, 3), and whether there were enough points, shape (m, 4).
    """
    weights = good.astype(float)
    for _ in range(2):
        total = np.maximum(weights.sum(axis=-1), 1e-9)
        centre = np.einsum("mea,meak->mek", weights, points) / total[..., None]
        apart = points - centre[:, :, None]
        spread = np.einsum("mea,meaj,meak->mejk", weights, apart, apart)
        normal = np.linalg.eigh(spread)[1][..., 0]
        residual = np.abs(np.einsum("meak,mek->mea", apart, normal))
        bound = np.maximum(3.0 * np.median(residual, axis=-1), _LEAST_BOUND_PX)
        weights = (good & (residual < bound[..., None])).astype(float)
    lines = np.concatenate([normal, np.sum(normal * centre, axis=-1, keepdims=True)], axis=-1)
    return lines, weights.sum(axis=-1) >= _LEAST_POINTS


def _intersections(lines: Array) -> Array:
    """Returns the corner of each edge and the one before it, shape (m, 4, 2); NaN = parallel."""
    sign = np.array([1.0, 1.0, -1.0])
    cross = np.cross(np.roll(lines, 1, axis=1) * sign, lines * sign)
    depth = np.where(np.abs(cross[..., 2:]) < 1e-9, np.nan, cross[..., 2:])
    return cross[..., :2] / depth
