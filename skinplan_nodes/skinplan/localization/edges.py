"""Corners of markers as intersections of lines fitted to their edges.

A corner finder that looks at the corner alone is drawn inwards by blur, and so makes the marker
look farther away (0.15 px at 1 m on rendered images, where this module is within 0.02 px). A
straight edge keeps its place under blur, and many places along it average the noise. How far the
places scatter about the line says how well the line, and so each corner, is known.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from skinplan.localization.edge_lines import AFTER, corner_covariance, crossings, dot
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
# A refined corner farther away than this from the detector's is no improvement but a mistake: in
# pixels, and as share of the marker's side, as large ones are searched at a smaller size.
_TRUST_PX, _TRUST_SHARE = 2.5, 0.03
# Rounds, and as many more as the corners still move by more than this.
_ROUNDS, _MOST_ROUNDS, _SETTLED_PX = 3, 6, 0.1
# How well the corners of a marker are known whose edges can't be fitted [px].
_UNFITTED_PX = 0.3
# What remains of the corners' error however many images are taken: the texture of the print, the
# mean over the profiles; and, where the blur is as wide as a cell, what the next cells mix in.
CORNER_FLOOR_PX = 0.002
_MIXED_PX = 0.55
_MAP_WIDTH = 1024
# Shorter profiles do not reach the levels of black and white [px].
_LEAST_REACH_PX = 3.0
# The place of a sharper edge among the pixels looks like skew [px].
_LEAST_WIDTH_PX = 0.6
# Grey values, difference between the levels, which are good, half length.
_Profiles = tuple[NDArray[np.float32], Array, NDArray[np.bool_], Array]


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
    light: NDArray[np.float32], corners: Array, cells: int, camera: CameraModel | None = None
) -> RefinedCorners:
    """Refines the corners of markers.

    Args:
        light: Grey image, shape (h, w).
        corners: To about two pixels, shape (m, 4, 2) [px].
        cells: Cells along the side of a marker, its border included.
        camera: Its distortion bends the edges; None = they are taken as straight in the image.
    """
    count = len(corners)
    refined = np.array(corners, dtype=float).reshape(count, 4, 2)
    covariance = np.tile(np.eye(8) * _UNFITTED_PX**2, (count, 1, 1))
    floor, usable = np.full(count, _UNFITTED_PX), np.zeros(count, dtype=bool)
    skew = np.zeros(count)
    trust = np.maximum(_TRUST_PX, _TRUST_SHARE * narrowest(refined))
    for number in range(_MOST_ROUNDS if count else 0):
        points, good, shape = edge_points(light, refined, cells, near=number > 0)
        crossing, lines, fitted = crossings(
            points, good, camera if number > 1 else None, min(number + 1, 2)
        )
        moved = np.linalg.norm(crossing - corners, axis=2).max(axis=1)
        usable = fitted & (moved < trust)
        last, refined = refined, np.where(usable[:, None, None], crossing, refined)
        if number + 1 >= _ROUNDS and np.abs(refined - last).max() < _SETTLED_PX:
            break
    if count:
        spread = corner_covariance(*lines)
        usable &= np.isfinite(spread).all(axis=(1, 2))
        covariance = np.where(usable[:, None, None], spread, covariance)
        lasting, half = profile_shape(*shape, narrowest(refined) / cells)
        floor = np.where(usable, lasting, floor)
        skew = np.where(usable, half, skew)
    return RefinedCorners(refined, covariance, floor, usable, skew)


def edge_points(
    light: NDArray[np.float32],
    corners: Array,
    cells: int,
    *,
    near: bool,
    allowed: NDArray[np.bool_] | None = None,
) -> tuple[Array, NDArray[np.bool_], _Profiles]:
    """Finds the edge's place on profiles across it.

    The area under the profile gives it: exact for any symmetric blur and any place of the edge
    between the pixels.

    Args:
        light: Grey image, shape (h, w).
        corners: shape (m, 4, 2) [px].
        cells: Cells along the side of a marker, its border included.
        near: Whether the corners are as near as another round brings them.
        allowed: Which places may show an edge, shape (m, 4, a); None = all.

    Returns:
        Points, shape (m, 4, a, 2) [px], which are good, shape (m, 4, a), and the profiles, as
        `profile_shape` takes them.
    """
    along = corners[:, AFTER] - corners
    length = np.sqrt(np.einsum("mei,mei->me", along, along))[..., None]
    across = along[..., ::-1] * (1.0, -1.0) / np.maximum(length, 1e-9)
    reach = np.clip(_ACROSS_CELLS / cells * length.min(axis=1, keepdims=True), *_ACROSS_PX)
    places, ticks, weights = _FINE if near else _COARSE
    base = corners[:, :, None] + along[:, :, None] * places[:, None]
    values, inside = _profiles(light, base, across, reach[..., 0], ticks)
    # One product: the mean, the levels at both ends, and how far the ends rise.
    mean, inner, outer, rise = np.moveaxis(values @ weights, -1, 0)
    step = outer - inner
    # Beyond the rim there is no white.
    good = (step > _LEAST_STEP) & inside
    if allowed is not None:
        good &= allowed
    shift = (2.0 * (outer - mean) / np.maximum(step, 1.0) - 1.0) * reach
    good &= np.abs(shift) < reach
    # Far from the edge, the ends of the profiles tell of other things.
    shift /= _gain(rise, step, good) if near else 1.0
    points = base + across[:, :, None] * shift[..., None]
    return points, good, (values, step, good, reach[:, 0, 0])


def _profiles(
    light: NDArray[np.float32], base: Array, across: Array, reach: Array, ticks: Array
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Reads profiles through points, shape (m, 4, a, 2): values, and which lie in the image."""
    read, inside = [], np.ones(base.shape[:-1], dtype=bool)
    for axis, size in ((0, light.shape[1]), (1, light.shape[0])):
        offset = (across[..., axis] * reach)[..., None]
        middle = base[..., axis]
        low, high = middle - np.abs(offset), middle + np.abs(offset)
        inside &= (low >= 0.0) & (high <= size - 1.0)
        tick = (offset * ticks).astype(np.float32)
        read.append(middle.astype(np.float32)[..., None] + tick[:, :, None])
    return sampled(light, *read), inside


def _gain(rise: Array, step: Array, good: NDArray[np.bool_]) -> Array:
    """Returns by how much of its way an edge shifts the area, shape (m, 1, 1).

    All of it where the profile's ends are level. Where the blur is as wide as the profile, the ends
    rise with the edge, and take a share away.
    """
    weight = good / np.maximum(step, 1.0)
    share = dot(weight, rise).sum(axis=1) / np.maximum(good.sum(axis=(1, 2)), 1)
    per_way = share / (_LEVEL_TICKS * (_TICKS[1] - _TICKS[0]))
    return np.maximum(1.0 - per_way, _LEAST_GAIN)[:, None, None]


def narrowest(corners: Array) -> Array:
    """Returns the shortest sides of markers, shape (m,) [px]."""
    return np.asarray(np.linalg.norm(corners[:, AFTER] - corners, axis=2).min(axis=1))


def profile_shape(
    values: NDArray[np.float32], step: Array, good: NDArray[np.bool_], reach: Array, cell: Array
) -> tuple[Array, Array]:
    """Looks at the mean profile across the edges of each marker, on which they lie in the middle.

    Returns:
        What of the corners' error does not get less with more images, by how much of the blur
        reaches from the next cell, `cell` px inside the edge, to the end of the profiles: the
        steepest place of a step blurred by a Gaussian tells the blur; and where the mean profile is
        at half of its height; shape (m,) each [px].
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
    tail = np.exp(-0.5 * ((cell - reach) / width) ** 2)
    return np.hypot(CORNER_FLOOR_PX, _MIXED_PX * tail), skew


def looked_up(light: NDArray[np.float32], places: Array) -> NDArray[np.float32]:
    """Returns grey values at places, shape (..., 2) [px], as `sampled` does."""
    return sampled(light, *(places[..., k].astype(np.float32) for k in (0, 1)))


def sampled(
    light: NDArray[np.float32], x: NDArray[np.float32], y: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Returns grey values between pixels; outside the image the nearest pixel's.

    Args:
        light: The image, not in bytes: of bytes OpenCV returns whole grey levels, and along an edge
            that lies along the pixels the rounding is the same everywhere. Shape (h, w).
        x: shape (...) [px].
        y: shape (...) [px].
    """
    rows = -(-x.size // _MAP_WIDTH)
    at = np.zeros((2, rows * _MAP_WIDTH), np.float32)
    at[0, : x.size], at[1, : y.size] = x.ravel(), y.ravel()
    if rows == 0:
        return np.zeros(x.shape, np.float32)
    map_x, map_y = at.reshape(2, rows, _MAP_WIDTH)
    light = np.asarray(light, dtype=np.float32)
    found = cv2.remap(light, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found.reshape(-1)[: x.size].reshape(x.shape), dtype=np.float32)


def _weights(ticks: Array) -> NDArray[np.float32]:
    """Returns what makes the mean, the two levels and the rise of a profile, shape (t, 4)."""
    weights, k = np.zeros((len(ticks), 4), np.float32), _LEVEL_TICKS
    weights[:, 0] = 1.0 / len(ticks)
    weights[:k, 1] = weights[-k:, 2] = 1.0 / k
    weights[[k, -1], 3], weights[[0, -1 - k], 3] = 1.0, -1.0
    return weights


# The first round only comes near the edges: every so many places, and ticks.
_FINE = (_ALONG, _TICKS, _weights(_TICKS))
_COARSE = (_ALONG[::3], _TICKS[::2], _weights(_TICKS[::2]))
