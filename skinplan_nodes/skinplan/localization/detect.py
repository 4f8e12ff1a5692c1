"""Markers in an image: identity by OpenCV's detector, corners by lines along the edges (M1.2)."""

import logging

import cv2
import numpy as np
from numpy.typing import NDArray

from skinplan.errors import ImageInvalidError, PartInvalidError
from skinplan.localization.edges import refine_corners
from skinplan.localization.model import CameraModel
from skinplan.transforms import Array

log = logging.getLogger(__name__)

# Two finds of one id closer than this share of the marker's side are the same marker.
_SAME_MARKER = 0.5


def dictionary_of(name: str) -> cv2.aruco.Dictionary:
    """Returns the dictionary of a name such as ``DICT_5X5_100``.

    Raises:
        PartInvalidError: There is no dictionary of that name.
    """
    names = sorted(key for key in dir(cv2.aruco) if key.startswith("DICT_"))
    if name not in names:
        raise PartInvalidError(
            f"marker dictionary {name!r} was asked; accepted: {', '.join(names)}"
        )
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def grey_image(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Returns an image as grey image, shape (h, w).

    Args:
        image: shape (h, w) grey or (h, w, 3) BGR, 8 bit.

    Raises:
        ImageInvalidError: Another shape or type, or no pixels.
    """
    found = np.asarray(image)
    good_shape = found.ndim == 2 or (found.ndim == 3 and found.shape[2] == 3)
    if found.dtype != np.uint8 or not good_shape or found.size == 0:
        raise ImageInvalidError(
            f"an image of 8 bit, shape (h, w) or (h, w, 3), is accepted, found {found.dtype} "
            f"{found.shape}"
        )
    grey = found if found.ndim == 2 else cv2.cvtColor(found, cv2.COLOR_BGR2GRAY)
    return np.asarray(grey, dtype=np.uint8)


def detect_markers(
    image: NDArray[np.uint8], dictionary: str, camera: CameraModel | None = None
) -> tuple[NDArray[np.int64], Array]:
    """Finds the markers of a dictionary.

    An id that is there twice names no marker: all its finds are left out.

    Args:
        image: shape (h, w) grey or (h, w, 3) BGR, 8 bit.
        dictionary: Name as OpenCV writes it.
        camera: Lets the corners be refined without the bend of the distortion; None = without.

    Returns:
        Ids, rising, shape (m,), and corners top left, top right, bottom right, bottom left,
        shape (m, 4, 2) [px]; both empty when there are none.

    Raises:
        ImageInvalidError: The array is no image.
        PartInvalidError: There is no such dictionary.
    """
    grey = grey_image(image)
    found, found_ids, _ = _detector(dictionary).detectMarkers(grey)
    if found_ids is None or len(found_ids) == 0:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 4, 2))
    ids = np.asarray(found_ids, dtype=np.int64).ravel()
    corners = np.asarray(found, dtype=float).reshape(-1, 4, 2)
    keep = _unique(ids, corners)
    ids, corners = ids[keep], refine_corners(grey, corners[keep], camera)
    order = np.argsort(ids)
    return ids[order], corners[order]


def _detector(dictionary: str) -> cv2.aruco.ArucoDetector:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.minMarkerPerimeterRate = 0.02
    return cv2.aruco.ArucoDetector(dictionary_of(dictionary), parameters)


def _unique(ids: NDArray[np.int64], corners: Array) -> NDArray[np.int64]:
    """Returns the finds to keep: one of a marker found twice, none of an id at two places."""
    keep = []
    centres = corners.mean(axis=1)
    for marker_id in np.unique(ids):
        same = np.flatnonzero(ids == marker_id)
        side = np.linalg.norm(corners[same[0], 0] - corners[same[0], 1])
        apart = np.linalg.norm(centres[same] - centres[same[0]], axis=1)
        if np.all(apart < _SAME_MARKER * side):
            keep.append(same[0])
        else:
            log.warning("marker %d is there %d times: left out", marker_id, len(same))
    return np.array(keep, dtype=np.int64)
