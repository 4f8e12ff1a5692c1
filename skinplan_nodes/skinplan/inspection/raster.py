"""Points of a part as a picture.

Seen from the front, one colour per value, small gaps between points closed.
"""

import base64
from dataclasses import dataclass
from io import BytesIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from skinplan.transforms import Array

_LONGEST_PX = 1200
# Around each point the picture is filled up to this many times the mean spacing of the points.
_REACH = 1.5
# Gaps in the points are closed up to twice this [px], to tell the area that they span.
_SPAN_PX = 30

# Diverging: blue - neutral - red, the middle visible on white and on black; differs in lightness
# too.
DIVERGING = np.array(
    [[23, 78, 166], [110, 160, 220], [206, 210, 216], [229, 140, 110], [170, 30, 40]], dtype=float
)


@dataclass(frozen=True)
class View:
    """The window of a picture.

    Attributes:
        left: Lower edge of u [m].
        bottom: Lower edge of v [m].
        width: Extent in u [m].
        height: Extent in v [m].
    """

    left: float
    bottom: float
    width: float
    height: float

    @classmethod
    def around(cls, points: Array, margin: float = 0.03) -> "View":
        """Returns the window around points, shape (n, 2+) [m]; margin: share of the longer side."""
        low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
        size = np.maximum(high - low, 1e-3)
        edge = margin * size.max()
        return cls(
            float(low[0] - edge),
            float(low[1] - edge),
            float(size[0] + 2 * edge),
            float(size[1] + 2 * edge),
        )

    @property
    def pixel_m(self) -> float:
        """Side of a pixel [m]."""
        return max(self.width, self.height) / _LONGEST_PX

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns [px]."""
        return max(1, round(self.height / self.pixel_m)), max(1, round(self.width / self.pixel_m))


def value_image(points: Array, values: Array, view: View) -> tuple[Array, NDArray[np.bool_]]:
    """Returns the mean value of each pixel, shape (h, w), top row first, and where there is any.

    Args:
        points: shape (n, 2+) [m], right and up.
        values: shape (n,), finite.
        view: The window.
    """
    rows, columns = view.shape
    u = ((points[:, 0] - view.left) / view.pixel_m).astype(np.int64)
    v = rows - 1 - ((points[:, 1] - view.bottom) / view.pixel_m).astype(np.int64)
    inside = (u >= 0) & (u < columns) & (v >= 0) & (v < rows)
    cell = v[inside] * columns + u[inside]
    count = np.bincount(cell, minlength=rows * columns).reshape(rows, columns)
    total = np.bincount(cell, weights=values[inside], minlength=rows * columns).reshape(
        rows, columns
    )
    mean = total / np.maximum(count, 1)
    if not count.any():
        return mean, count > 0
    return _close_gaps(mean, count > 0)


def _close_gaps(mean: Array, filled: NDArray[np.bool_]) -> tuple[Array, NDArray[np.bool_]]:
    # The spacing is that between filled pixels in the area that the points span.
    span = closed(filled, _SPAN_PX)
    spacing = float(np.sqrt(span.sum() / filled.sum()))
    distance, (row, column) = ndimage.distance_transform_edt(~filled, return_indices=True)
    return mean[row, column], distance <= (_REACH * spacing if spacing > 1.05 else 1.0)


def closed(filled: NDArray[np.bool_], reach_px: int) -> NDArray[np.bool_]:
    """Returns the closing by a diamond: as `reach_px` dilations, then erosions, by a cross.

    Two distance transforms take the same time whatever the reach is.

    Args:
        filled: Mask, shape (h, w).
        reach_px: Of the diamond [px].
    """
    if not filled.any():
        return filled.copy()
    # A pixel beyond the reach stays empty on every side, as what lies outside the image.
    padded = np.pad(filled, reach_px + 1)
    empty = ndimage.distance_transform_cdt(~padded, metric="taxicab") > reach_px
    eroded = ndimage.distance_transform_cdt(~empty, metric="taxicab") > reach_px
    border = slice(reach_px + 1, -reach_px - 1)
    return np.asarray(eroded[border, border])


def diverging(values: Array, limit: float) -> NDArray[np.uint8]:
    """Returns colours, shape (..., 3): -limit is blue, 0 grey, limit red."""
    place = np.clip(values / limit, -1.0, 1.0) * 2.0 + 2.0
    stops = np.arange(5.0)
    channels = [np.interp(place, stops, DIVERGING[:, channel]) for channel in range(3)]
    return np.stack(channels, axis=-1).astype(np.uint8)


def png_uri(colours: NDArray[np.uint8], shown: NDArray[np.bool_]) -> str:
    """Returns a picture with transparent background as data URI.

    Args:
        colours: shape (h, w, 3).
        shown: Where it is not transparent, shape (h, w).
    """
    rgba = np.dstack([np.where(shown[..., None], colours, 0), np.where(shown, 255, 0)]).astype(
        np.uint8
    )
    stream = BytesIO()
    # A palette keeps the report small; the eye does not tell 255 colours from more here.
    Image.fromarray(rgba, "RGBA").quantize(255, method=Image.Quantize.FASTOCTREE).save(
        stream, "PNG", optimize=True
    )
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode("ascii")
