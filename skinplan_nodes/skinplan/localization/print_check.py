"""Whether the cells of a marker lie where its corners say: a covered edge moves the corners."""

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from skinplan.localization.edges import looked_up
from skinplan.transforms import Array

# Places in each cell and axis that are compared with the cell's colour.
_PLACES = np.array([0.22, 0.5, 0.78])
# At least this share of them has the right colour; a strip of a tenth of the marker covered leaves
# less. Cells of few pixels are blurred into each other.
_LEAST_AGREEMENT, _LEAST_SMALL, _SMALL_CELL_PX = 0.96, 0.90, 5.0


def fits_print(
    light: NDArray[np.float32], ids: NDArray[np.int64], corners: Array, book: cv2.aruco.Dictionary
) -> NDArray[np.bool_]:
    """Tells which markers show their print in full, shape (m,).

    Args:
        light: Grey image, shape (h, w).
        ids: shape (m,).
        corners: shape (m, 4, 2) [px].
        book: The dictionary.
    """
    cells = int(book.markerSize) + 2
    if len(ids) == 0:
        return np.ones(0, dtype=bool)
    at = ((np.arange(cells)[:, None] + _PLACES) / cells).ravel()
    values = looked_up(light, places_on(corners, at[None, None, :], at[None, :, None]))
    wanted = np.array([_wanted(print_bits(book, i), cells) for i in ids.tolist()])
    level = [
        0.5 * (_middle(found[white]) + _middle(found[~white]))
        for found, white in zip(values, wanted, strict=True)
    ]
    agreement = np.mean((values > np.array(level)[:, None, None]) == wanted, axis=(1, 2))
    side = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).min(axis=1)
    least = np.where(side < _SMALL_CELL_PX * cells, _LEAST_SMALL, _LEAST_AGREEMENT)
    return np.asarray(agreement >= least)


def places_on(corners: Array, x: Array, y: Array) -> Array:
    """Maps places on markers to the image by each marker's perspective.

    Args:
        corners: shape (m, 4, 2) [px].
        x: Shares of the upper side, shape (m or 1, j, k).
        y: Shares of the left side, the same.

    Returns:
        shape (m, j, k, 2) [px].
    """
    a, b, c, d = (corners[:, k] for k in range(4))
    # Corners of the unit square, (0, 0), (1, 0), (1, 1), (0, 1): Heckbert's closed form.
    bend, right, low = a - b + c - d, b - c, d - c
    area = right[:, 0] * low[:, 1] - right[:, 1] * low[:, 0]
    area = np.where(np.abs(area) < 1e-9, 1e-9, area)
    g = (bend[:, 0] * low[:, 1] - bend[:, 1] * low[:, 0]) / area
    h = (right[:, 0] * bend[:, 1] - right[:, 1] * bend[:, 0]) / area
    along, down = b - a + g[:, None] * b, d - a + h[:, None] * d
    below = 1.0 + g[:, None, None] * x + h[:, None, None] * y
    top = along[:, None, None] * x[..., None] + down[:, None, None] * y[..., None]
    return np.asarray((top + a[:, None, None]) / below[..., None])


def _middle(values: NDArray[np.float32]) -> float:
    """Returns a median; many times faster than numpy's of so few values."""
    half = len(values) // 2
    return float(np.partition(values, half)[half])


def print_bits(book: cv2.aruco.Dictionary, marker_id: int) -> bytes:
    """Returns which cells of a marker are white, its border included, a byte each, row by row."""
    cells = int(book.markerSize) + 2
    return bytes(cv2.aruco.generateImageMarker(book, marker_id, cells, borderBits=1) > 127)


@lru_cache(maxsize=4096)
def _wanted(bits: bytes, cells: int) -> NDArray[np.bool_]:
    """Returns which places are white in a print, shape (3 cells, 3 cells)."""
    white = np.frombuffer(bits, dtype=bool).reshape(cells, cells)
    return np.asarray(white.repeat(len(_PLACES), axis=0).repeat(len(_PLACES), axis=1))
