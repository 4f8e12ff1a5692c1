"""Mirror images of markers: printed with the mirror option, or seen through a mirror or a foil."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from skinplan.transforms import Array

# Smaller quadrilaterals can't be read [px].
_LEAST_SIDE_PX = 18.0
# Of the largest ones; cluttered images have hundreds of quadrilaterals.
_MOST_QUADS = 8
_MARGIN_PX = 12
# Sizes that are tried beside markers that were found, as share of theirs.
_USUAL = (0.7, 2.0)


def mirrored_ids(
    grey: NDArray[np.uint8],
    quads: Sequence[NDArray],
    found: Array,
    detector: cv2.aruco.ArucoDetector,
) -> set[int]:
    """Returns the ids of markers whose mirror image is in an image.

    Args:
        grey: shape (h, w).
        quads: Quadrilaterals that are no markers, shape (1, 4, 2) [px] each, as OpenCV's detector
            rejects them.
        found: Corners of those that are, shape (m, 4, 2) [px].
        detector: Finds markers; it is given the mirrored surroundings of the quadrilaterals.
    """
    if len(quads) == 0:
        return set()
    corners = np.asarray(quads, dtype=np.float64).reshape(-1, 4, 2)
    low, high = corners.min(axis=1), corners.max(axis=1)
    middles = found.mean(axis=1)
    inside = (middles[None] > low[:, None]) & (middles[None] < high[:, None])
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).min(axis=1)
    free = (sides >= _LEAST_SIDE_PX) & ~inside.all(axis=2).any(axis=1)
    if len(found) > 0:
        # The others of a fixture look about as large; their white plate is what is rejected.
        usual = float(np.median(np.linalg.norm(found[:, 0] - found[:, 1], axis=1)))
        free &= (sides > _USUAL[0] * usual) & (sides < _USUAL[1] * usual)
    order = [k for k in np.argsort(-sides, kind="stable") if free[k]][:_MOST_QUADS]
    ids: set[int] = set()
    for k in order:
        left, top = np.maximum(low[k].astype(int) - _MARGIN_PX, 0)
        right, bottom = high[k].astype(int) + _MARGIN_PX
        window = np.ascontiguousarray(grey[top:bottom, left:right][:, ::-1])
        _, found_ids, _ = detector.detectMarkers(window)
        ids |= set() if found_ids is None else {int(i) for i in found_ids.ravel()}
    return ids
