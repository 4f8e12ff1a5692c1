"""Markers of the same dictionary that are not the fixture's, among what OpenCV's detector rejects.

Comparing a quadrilateral with a thousand markers takes OpenCV 2 ms. So its detector is only given
the fixture's own, and the others are read here, all at once.
"""

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from skinplan.localization.edges import narrowest
from skinplan.localization.print_check import places_on
from skinplan.transforms import Array

# Places in each cell and axis whose mean is compared with the level between black and white.
_PLACES = np.array([0.3, 0.5, 0.7])
# Cells of fewer pixels can't be read.
_LEAST_CELL_PX = 1.4
# As OpenCV's detector has them: share of the cells in the border that may be white, of the inner
# ones; share of the bits that the dictionary could correct that are corrected; and least scatter.
_BORDER_WRONG, _CORRECTED, _LEAST_SCATTER = 0.35, 0.6, 5.0
# Of the largest ones; cluttered images have hundreds of quadrilaterals.
_MOST_QUADS = 32
# Shorter outlines are none; corners of an outline lie off a straight line by this share of it.
_LEAST_OUTLINE_PX, _STRAIGHT = 40, 0.03


def foreign_ids(
    grey: NDArray[np.uint8],
    rejected: Array,
    found: Array,
    book: cv2.aruco.Dictionary,
) -> NDArray[np.int64]:
    """Reads the quadrilaterals that were rejected, and those inside them: a marker on its plate.

    Args:
        grey: shape (h, w).
        rejected: Corners of what was rejected, shape (q, 4, 2) [px].
        found: Corners of the fixture's markers, shape (m, 4, 2) [px]; what lies around or inside
            them is none.
        book: The dictionary.

    Returns:
        Ids in the dictionary, rising, each once.
    """
    cells = int(book.markerSize) + 2
    side = narrowest(rejected)
    free = (side >= _LEAST_CELL_PX * cells) & _apart(rejected, found, side)
    order = np.argsort(-side, kind="stable")
    outer = rejected[order[free[order]][:_MOST_QUADS]]
    if len(outer) == 0:
        return np.zeros(0, dtype=np.int64)
    quads = np.concatenate([outer, *(_inside(grey, quad) for quad in outer)])
    side = narrowest(quads)
    quads = quads[(side >= _LEAST_CELL_PX * cells) & _apart(quads, found, side)]
    return _read(grey, quads, book)


def _apart(quads: Array, found: Array, side: Array) -> NDArray[np.bool_]:
    """Tells which quadrilaterals have no marker that was found in their middle, shape (q,)."""
    apart = np.linalg.norm(quads.mean(axis=1)[:, None] - found.mean(axis=1)[None], axis=2)
    return np.asarray(np.all(apart > 0.5 * side[:, None], axis=1))


def _inside(grey: NDArray[np.uint8], quad: Array) -> Array:
    """Finds dark quadrilaterals inside one, shape (k, 4, 2), clockwise [px]."""
    low = np.maximum(np.floor(quad.min(axis=0)).astype(int), 0)
    high = np.ceil(quad.max(axis=0)).astype(int) + 1
    window = np.ascontiguousarray(grey[low[1] : high[1], low[0] : high[0]])
    flag = cv2.THRESH_BINARY_INV | cv2.THRESH_OTSU
    _, dark = cv2.threshold(window, 0, 255, flag)
    outlines, _ = cv2.findContours(dark, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    result = []
    for outline in outlines:
        if len(outline) < _LEAST_OUTLINE_PX:
            continue
        corners = cv2.approxPolyDP(outline, _STRAIGHT * len(outline), True)
        if len(corners) == 4 and cv2.isContourConvex(corners):
            clockwise = cv2.contourArea(corners, oriented=True) > 0.0
            points = corners.reshape(4, 2)[:: 1 if clockwise else -1]
            result.append(points.astype(float) + low)
    return np.array(result).reshape(-1, 4, 2)


def _read(grey: NDArray[np.uint8], quads: Array, book: cv2.aruco.Dictionary) -> NDArray[np.int64]:
    """Reads the ids of quadrilaterals, as OpenCV's detector does; rising, each once."""
    if len(quads) == 0:
        return np.zeros(0, dtype=np.int64)
    cells = int(book.markerSize) + 2
    at = ((np.arange(cells)[:, None] + _PLACES) / cells).ravel()
    values = _values(grey, places_on(quads, at[None, None, :], at[None, :, None]))
    mean = values.reshape(len(quads), cells, len(_PLACES), cells, len(_PLACES)).mean(axis=(2, 4))
    flat = values.reshape(len(quads), -1)
    white = mean > _levels(flat)[:, None, None]
    inner = white[:, 1:-1, 1:-1]
    wrong = white.sum(axis=(1, 2)) - inner.sum(axis=(1, 2))
    readable = wrong <= int(_BORDER_WRONG * book.markerSize**2)
    readable &= flat.std(axis=1) >= _LEAST_SCATTER
    signs = np.where(inner[readable], 1.0, -1.0).reshape(-1, book.markerSize**2)
    # Each bit that differs takes 2 off the product.
    prints, ids = _prints(book.bytesList.tobytes(), book.bytesList.shape, int(book.markerSize))
    differ = 0.5 * (prints.shape[1] - signs.astype(np.float32) @ prints.T)
    best = np.argmin(differ, axis=1)
    near = differ[np.arange(len(signs)), best] <= int(_CORRECTED * book.maxCorrectionBits)
    return np.unique(ids[best[near]])


def _values(grey: NDArray[np.uint8], places: Array) -> NDArray[np.float32]:
    """Returns grey values of the nearest pixels, shape (q, k, k), for places (q, k, k, 2)."""
    x = np.clip(np.rint(places[..., 0]), 0, grey.shape[1] - 1).astype(int)
    y = np.clip(np.rint(places[..., 1]), 0, grey.shape[0] - 1).astype(int)
    return np.asarray(grey[y, x], dtype=np.float32)


def _levels(values: NDArray[np.float32]) -> Array:
    """Returns the levels between black and white by Otsu, shape (q,)."""
    grey = np.clip(values, 0.0, 255.0).astype(np.uint8)
    flag = cv2.THRESH_BINARY | cv2.THRESH_OTSU
    return np.array([cv2.threshold(row[None], 0, 255, flag)[0] for row in grey])


@lru_cache(maxsize=16)
def _prints(
    packed: bytes, shape: tuple[int, int, int], size: int
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Returns all prints of a dictionary in four turns, +1 = white, shape (4 n, s * s), and ids."""
    entries = np.frombuffer(packed, dtype=np.uint8).reshape(shape)
    bits = np.array([_bits(entry, size) for entry in entries])
    turned = np.concatenate([np.rot90(bits, k, axes=(1, 2)) for k in range(4)])
    signs = np.where(turned > 0, 1.0, -1.0).astype(np.float32)
    return signs.reshape(len(signs), -1), np.tile(np.arange(len(bits), dtype=np.int64), 4)


def _bits(entry: NDArray[np.uint8], size: int) -> NDArray[np.uint8]:
    found = cv2.aruco.Dictionary.getBitsFromByteList(entry[None], size)
    return np.asarray(found, dtype=np.uint8)
