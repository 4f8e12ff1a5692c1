"""Whether the cells of a marker lie where its corners say: a covered edge moves the corners."""

import cv2
import numpy as np
from numpy.typing import NDArray

from skinplan.transforms import Array

# Places in each cell and axis that are compared with the cell's colour.
_PLACES = np.array([0.22, 0.5, 0.78])
# At least this share of them has the right colour; a strip of a tenth of the marker covered leaves
# less. Cells of few pixels are blurred into each other.
_LEAST_AGREEMENT, _LEAST_SMALL, _SMALL_CELL_PX = 0.96, 0.90, 5.0


def fits_print(
    grey: NDArray[np.uint8], ids: NDArray[np.int64], corners: Array, book: cv2.aruco.Dictionary
) -> NDArray[np.bool_]:
    """Tells which markers show their print in full, shape (m,).

    Args:
        grey: shape (h, w).
        ids: shape (m,).
        corners: shape (m, 4, 2) [px].
        book: The dictionary.
    """
    cells = int(book.markerSize) + 2
    at = ((np.arange(cells)[:, None] + _PLACES) / cells).ravel()
    x, y = np.meshgrid(at, at)
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float32)
    good = np.ones(len(ids), dtype=bool)
    for k, (marker_id, quad) in enumerate(zip(ids.tolist(), corners, strict=True)):
        to_image = cv2.getPerspectiveTransform(square, quad.astype(np.float32))
        places = cv2.perspectiveTransform(
            np.stack([x, y], axis=-1).reshape(-1, 1, 2).astype(np.float32), to_image
        ).reshape(*x.shape, 2)
        values = cv2.remap(
            grey, places[..., 0], places[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        wanted = cv2.aruco.generateImageMarker(book, marker_id, cells, borderBits=1) > 127
        wanted = np.kron(wanted, np.ones((len(_PLACES), len(_PLACES)), dtype=bool))
        level = 0.5 * (np.median(values[wanted]) + np.median(values[~wanted]))
        agreement = float(np.mean((values > level) == wanted))
        side = float(np.linalg.norm(quad - np.roll(quad, 1, axis=0), axis=1).min())
        small = side < _SMALL_CELL_PX * cells
        good[k] = agreement >= (_LEAST_SMALL if small else _LEAST_AGREEMENT)
    return good
