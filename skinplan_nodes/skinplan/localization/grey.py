"""Images as the localisation takes them."""

import cv2
import numpy as np
from numpy.typing import NDArray

from skinplan.errors import ImageInvalidError

_LARGEST_PX = 100_000_000


def grey_image(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Returns an image as grey image, shape (h, w).

    Args:
        image: shape (h, w) grey or (h, w, 3) BGR, 8 bit.

    Raises:
        ImageInvalidError: Another shape or type, no pixels, or far too many.
    """
    found = np.asarray(image)
    good_shape = found.ndim == 2 or (found.ndim == 3 and found.shape[2] == 3)
    if found.dtype != np.uint8 or not good_shape or not 0 < found.size <= _LARGEST_PX:
        raise ImageInvalidError(
            f"an image of 8 bit, shape (h, w) or (h, w, 3), of at most {_LARGEST_PX} bytes, is "
            f"accepted, found {found.dtype} {found.shape}"
        )
    grey = found if found.ndim == 2 else cv2.cvtColor(found, cv2.COLOR_BGR2GRAY)
    return np.ascontiguousarray(grey, dtype=np.uint8)
