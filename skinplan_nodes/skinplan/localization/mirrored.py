"""Mirror images of markers: printed with the mirror option, or seen through a mirror or a foil."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from skinplan.transforms import Array

# Places per cell and axis that vote on its colour.
_VOTES = np.array([0.3, 0.5, 0.7])
# Smaller quadrilaterals can't be read [px per cell].
_LEAST_CELL_PX = 2.5
_LEAST_CONTRAST = 25.0
# Of the largest ones; cluttered images have hundreds of quadrilaterals.
_MOST_QUADS = 40


def mirrored_ids(
    grey: NDArray[np.uint8], quads: Sequence[NDArray], book: cv2.aruco.Dictionary
) -> set[int]:
    """Returns the ids of markers whose mirror image is in an image.

    Args:
        grey: shape (h, w).
        quads: Quadrilaterals that are no markers, shape (1, 4, 2) [px] each, as OpenCV's detector
            rejects them.
        book: The dictionary.

    Returns:
        Ids; a mirror image counts only when every cell of it and its border are right.
    """
    cells = int(book.markerSize) + 2
    corners = np.asarray(quads, dtype=np.float64).reshape(-1, 4, 2)
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).min(axis=1)
    order = np.argsort(-sides, kind="stable")[:_MOST_QUADS]
    order = order[sides[order] >= _LEAST_CELL_PX * cells]
    return {
        marker_id
        for quad in corners[order]
        if (marker_id := _mirrored_id(grey, quad, cells, book)) is not None
    }


def _mirrored_id(
    grey: NDArray[np.uint8], quad: Array, cells: int, book: cv2.aruco.Dictionary
) -> int | None:
    bits = _bits(grey, quad, cells)
    if bits is None or bits[0].any() or bits[-1].any() or bits[:, [0, -1]].any():
        return None
    inner = np.ascontiguousarray(bits[1:-1, -2:0:-1], dtype=np.uint8)
    known, marker_id, _ = book.identify(inner, 0.0)
    return int(marker_id) if known else None


def _bits(grey: NDArray[np.uint8], quad: Array, cells: int) -> NDArray[np.bool_] | None:
    """Reads the cells of a quadrilateral, True = white; None = it has no contrast."""
    places = (np.arange(cells)[:, None] + _VOTES).ravel()
    x, y = np.meshgrid(places, places)
    square = np.array([[0, 0], [cells, 0], [cells, cells], [0, cells]], dtype=np.float32)
    to_image = cv2.getPerspectiveTransform(square, quad.astype(np.float32))
    at = cv2.perspectiveTransform(
        np.stack([x, y], axis=-1).reshape(-1, 1, 2).astype(np.float32), to_image
    ).reshape(*x.shape, 2)
    values = cv2.remap(
        grey, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    if float(np.ptp(values)) < _LEAST_CONTRAST:
        return None
    level, _ = cv2.threshold(values, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    white = (values > level).reshape(cells, len(_VOTES), cells, len(_VOTES))
    return np.asarray(white.mean(axis=(1, 3)) > 0.5)
