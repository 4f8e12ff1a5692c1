"""How far black reaches beyond its print in an image: tone curve, glare, ink.

A camera whose grey levels are no straight line of the light puts every edge to one side, and a
square of black looks larger or smaller by twice that. The cells inside the marker tell: the same
shift moves their edges towards white, where the grid of the cells says how far.
"""

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from skinplan.localization.edge_lines import bent, intersections, straightened
from skinplan.localization.edges import looked_up
from skinplan.localization.model import CameraModel
from skinplan.localization.print_check import places_on, print_bits
from skinplan.transforms import Array

# Markers with smaller cells do not tell how far black reaches, or whether the cells lie aside [px].
LEAST_CELL_PX, _LEAST_ASIDE_CELL_PX = 5.0, 3.0
# Profiles across an edge between two cells: half of their length in cells and at most in pixels,
# places on them, how many at either end give the level; where along the edge they lie, in cells.
_HALF, _HALF_PX, _LEVEL_TICKS = 0.45, 4.0, 2
_AHEAD = np.linspace(-1.0, 1.0, 13)
_ALONG = np.array([-0.25, 0.0, 0.25])
# What makes the levels at the ends and the mean of a profile.
_WEIGHTS = np.zeros((len(_AHEAD), 3), np.float32)
_WEIGHTS[:_LEVEL_TICKS, 0] = _WEIGHTS[-_LEVEL_TICKS:, 1] = 1.0 / _LEVEL_TICKS
_WEIGHTS[:, 2] = 1.0 / len(_AHEAD)
_LEAST_STEP = 25.0
_LEAST_EDGES = 12
_UNKNOWN_PX = 1e3
# Cells farther aside than this share of the side, and so many pixels: a strip over an edge puts
# them aside by half of its width.
_ASIDE_SHARE, _LEAST_ASIDE_PX = 0.006, 0.25
# Without the camera, so many times as far: an unknown distortion bends the grid.
_UNKNOWN_BEND = 3.0
# Shifts below this, or below so many standard deviations, are none.
_LEAST_PX, _LEAST_SIGMA = 0.02, 3.0


def edge_growth(
    light: NDArray[np.float32],
    ids: NDArray[np.int64],
    corners: Array,
    book: cv2.aruco.Dictionary,
    camera: CameraModel | None = None,
) -> tuple[Array, Array, Array]:
    """Measures how far black reaches over the edges of its cells, and how far these are off.

    Args:
        light: Grey image, shape (h, w).
        ids: shape (m,).
        corners: shape (m, 4, 2) [px].
        book: The dictionary.
        camera: Its distortion bends the grid of the cells; None = as small as a marker is, it does
            not.

    Returns:
        The shift, positive where black is larger, its standard deviation, and how far the cells lie
        aside of where the corners put them, shape (m,) each [px]. Markers that do not tell have 0,
        a very large one, and 0.
    """
    growth, sigma, aside = np.zeros(len(ids)), np.full(len(ids), _UNKNOWN_PX), np.zeros(len(ids))
    cells = int(book.markerSize) + 2
    side = np.linalg.norm(corners - corners[:, [3, 0, 1, 2]], axis=2).min(axis=1)
    tell = np.flatnonzero(side >= _LEAST_ASIDE_CELL_PX * cells).tolist()
    if not tell:
        return growth, sigma, aside
    owner, parts, signs, levers, axes = [], [], [], [], []
    for k in tell:
        middle, across, sign, lever = _edges_of(print_bits(book, int(ids[k])), cells)
        half = min(_HALF, _HALF_PX * cells / side[k]) * _AHEAD[:, None]
        parts.append((middle[:, None] + half * across[:, None]) / cells)
        owner.append(np.full(len(sign), k))
        signs.append(sign)
        levers.append(lever)
        axes.append(across[:, 0] > 0.5)
    places = np.concatenate(parts)[:, None]
    straight = straightened(corners, camera)[np.concatenate(owner)]
    # All at once: most of the time is that of the calls.
    at = bent(places_on(straight, places[..., 0], places[..., 1])[:, 0], camera)
    sign, lever = np.concatenate(signs), np.concatenate(levers)
    good, moved = _moved(looked_up(light, at), at, sign)
    ends = np.cumsum([len(item) for item in signs]).tolist()
    for k, axis, begin, end in zip(tell, axes, [0, *ends], ends, strict=False):
        own = good[begin:end]
        if own.sum() >= _LEAST_EDGES:
            shift, error = _shift(moved[begin:end][own], lever[begin:end][own])
            aside[k] = _aside(moved[begin:end][own], lever[begin:end][own] * shift, axis[own])
            if side[k] >= LEAST_CELL_PX * cells:
                growth[k], sigma[k] = shift, error
    return growth, sigma, aside


def lie_aside(
    light: NDArray[np.float32],
    ids: NDArray[np.int64],
    corners: Array,
    aside: Array,
    book: cv2.aruco.Dictionary,
    camera: CameraModel | None,
) -> NDArray[np.bool_]:
    """Tells whose cells do not lie where the corners put them: something covers an edge.

    Args:
        light: Grey image, shape (h, w).
        ids: shape (m,).
        corners: shape (m, 4, 2) [px].
        aside: As `edge_growth` returns it [px].
        book: The dictionary.
        camera: Looked at where the distortion may be what bends the grid; None = not known.

    Returns:
        shape (m,).
    """
    side = np.linalg.norm(corners - corners[:, [3, 0, 1, 2]], axis=2).min(axis=1)
    bound = np.maximum(_ASIDE_SHARE * side, _LEAST_ASIDE_PX)
    if camera is None:
        bound *= _UNKNOWN_BEND
    odd = aside > bound
    if camera is not None and odd.any():
        odd[odd] = edge_growth(light, ids[odd], corners[odd], book, camera)[2] > bound[odd]
    return np.asarray(odd)


def common_growth(growth: Array, sigma: Array) -> float:
    """Returns the shift of all markers of an image [px]; 0 = none that can be told from chance."""
    weight = 1.0 / sigma**2
    total = float(weight.sum()) if len(weight) else 0.0
    if total <= _UNKNOWN_PX**-2 * len(weight) * 2.0:
        return 0.0
    mean = float(weight @ growth) / total
    return mean if abs(mean) > max(_LEAST_PX, _LEAST_SIGMA / np.sqrt(total)) else 0.0


def drawn_in(corners: Array, shift_px: float) -> Array:
    """Moves the edges of squares inwards by a shift: corners, shape (m, 4, 2) [px]."""
    along = corners[:, [1, 2, 3, 0]] - corners
    length = np.linalg.norm(along, axis=2, keepdims=True)
    outward = np.stack([along[..., 1], -along[..., 0]], axis=-1) / length
    offset = np.einsum("mei,mei->me", outward, corners) - shift_px
    return intersections(np.concatenate([outward, offset[..., None]], axis=-1))


def _moved(values: NDArray[np.float32], at: Array, sign: Array) -> tuple[NDArray[np.bool_], Array]:
    """Returns which profiles show an edge, and by how much it is ahead of its place [px]."""
    left, right, mean = np.moveaxis(values @ _WEIGHTS, -1, 0)
    step = right - left
    good = step * sign > _LEAST_STEP
    along = at[..., -1, :] - at[..., 0, :]
    share = (right - mean) / np.where(good, step, 1.0)
    return good, (share - 0.5) * np.hypot(along[..., 0], along[..., 1])


def _shift(moved: Array, arm: Array) -> tuple[float, float]:
    """Returns the shift of one marker and its standard deviation [px]."""
    squares = float(arm @ arm)
    shift = float(arm @ moved) / squares
    scatter = float(np.var(moved - shift * arm))
    # The profiles along one edge share their noise.
    return shift, float(np.sqrt(scatter * len(_ALONG) / squares))


def _aside(moved: Array, grown: Array, axis: NDArray[np.bool_]) -> float:
    """Returns how far the edges of the cells are off along either axis, on an average [px]."""
    off = moved - grown
    return max(abs(float(off[own].mean())) if own.any() else 0.0 for own in (axis, ~axis))


@lru_cache(maxsize=4096)
def _edges_of(bits: bytes, cells: int) -> tuple[Array, Array, Array, Array]:
    """Lists places on the edges between the cells of a print.

    Returns:
        The places and the directions across the edge, shape (n, 2) each, in cells; +1 where white
        lies ahead, shape (n,); and by how much of the shift an edge leaves the grid: the grid is
        drawn by corners that have moved themselves, shape (n,).
    """
    print_ = np.frombuffer(bits, dtype=bool).reshape(cells, cells)
    middles, directions, signs, levers = [], [], [], []
    for axis, cell in ((0, print_), (1, print_.T)):
        row, column = np.nonzero(cell[:, :-1] != cell[:, 1:])
        sign = np.where(cell[row, column + 1], 1.0, -1.0)
        x = np.repeat(column + 1.0, len(_ALONG))
        y = (row[:, None] + 0.5 + _ALONG).ravel()
        middles.append(np.stack([x, y] if axis == 0 else [y, x], axis=-1))
        directions.append(np.tile(np.eye(2)[axis], (len(x), 1)))
        signs.append(np.repeat(sign, len(_ALONG)))
        levers.append(signs[-1] - (2.0 * x / cells - 1.0))
    parts = (middles, directions, signs, levers)
    middle, across, sign, lever = (np.concatenate(part) for part in parts)
    return middle, across, sign, lever
