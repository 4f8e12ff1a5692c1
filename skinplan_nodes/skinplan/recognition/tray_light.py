"""How much brighter each place of the tray is in one image than in another.

The light of a hall changes between the photo of the empty tray and that of the parts, and not
everywhere alike. Most of the tray is still background, so the change can be found from the images
themselves: a smooth field that most places agree on.
"""

import cv2
import numpy as np

from skinplan.recognition.tray_view import Image
from skinplan.transforms import Array

# The field is fitted to means over blocks of so many pixels to a side, at least.
_BLOCKS = 40
_DARK_LEVEL = 1.0
_ROUNDS = 25
# Scale of Tukey's weight in standard deviations, and of a median deviation.
_TUKEY, _MAD = 4.685, 1.4826
_LEAST_SPREAD = 0.01


def light_ratio(image: Image, background: Image) -> Array:
    """Fits a polynomial of third degree to the logarithm of the ratio of two images, robustly.

    Args:
        image: With parts, shape (h, w).
        background: Without, shape (h, w).

    Returns:
        Ratio of the light at each pixel, shape (h, w).
    """
    height, width = image.shape
    columns = _BLOCKS
    rows = max(2, round(_BLOCKS * height / width))
    small = [
        cv2.resize(each, (columns, rows), interpolation=cv2.INTER_AREA).astype(float) + _DARK_LEVEL
        for each in (image, background)
    ]
    change = np.log(small[0] / small[1]).ravel()
    terms = _terms(rows, columns)
    field = _terms(height, width) @ _robust(terms, change)
    return np.asarray(np.exp(field).reshape(height, width))


def _terms(rows: int, columns: int) -> Array:
    """Returns the terms of the polynomial over the unit square, shape (rows * columns, 10)."""
    y, x = np.meshgrid(
        (np.arange(rows) + 0.5) / rows * 2 - 1,
        (np.arange(columns) + 0.5) / columns * 2 - 1,
        indexing="ij",
    )
    return np.stack(
        [x.ravel() ** i * y.ravel() ** j for i in range(4) for j in range(4 - i)], axis=1
    )


def _robust(terms: Array, values: Array) -> Array:
    """Least absolute values first, then Tukey's weights: parts are outliers, all to one side."""
    weights: Array = np.ones(len(values))
    found: Array = np.zeros(terms.shape[1])
    for number in range(2 * _ROUNDS):
        root = np.sqrt(weights)
        solved = np.linalg.lstsq(terms * root[:, None], values * root, rcond=None)[0]
        found = np.asarray(solved, dtype=np.float64)
        rest = np.asarray(values - terms @ found, dtype=np.float64)
        spread = max(_MAD * float(np.median(np.abs(rest))), _LEAST_SPREAD)
        if number < _ROUNDS:
            weights = 1.0 / np.maximum(np.abs(rest), _LEAST_SPREAD)
        else:
            weights = np.maximum(1.0 - (rest / (_TUKEY * spread)) ** 2, 0.0) ** 2
    return np.asarray(found)
