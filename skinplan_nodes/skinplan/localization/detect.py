"""Markers in an image: identity by OpenCV's detector, corners by lines along the edges (M1.2)."""

import logging
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from skinplan.errors import ImageInvalidError, PartInvalidError
from skinplan.localization.edges import RefinedCorners, refine_corners
from skinplan.localization.mirrored import mirrored_ids
from skinplan.localization.model import CameraModel, Detection
from skinplan.localization.print_check import fits_print
from skinplan.transforms import Array

log = logging.getLogger(__name__)

CORNER_FINDERS = ("lines", "subpix")
# Two finds of one id closer than this share of the marker's side are the same marker.
_SAME_MARKER = 0.5
# Windows of the adaptive threshold: the small one for far markers, the large one for near ones.
# OpenCV's own third one costs a third of the time and finds nothing more.
_WINDOWS_PX = (3, 29)
# One is enough near a marker that was found before; without it the whole image is looked at.
_TRACKING_PX = 15
# Half window of `cornerSubPix`, of markers whose edges can't be fitted.
_SUBPIX_PX = 3
_SUBPIX_SHARE = 0.04
_LARGEST_PX = 100_000_000


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


class MarkerDetector:
    """Finds the markers of a dictionary.

    Args:
        dictionary: Name as OpenCV writes it, or a dictionary of one's own.
        corners: ``lines`` (along the edges) or ``subpix`` (OpenCV's corner finder, for a camera
            that was calibrated with it; it draws the corners inwards under blur).

    Raises:
        PartInvalidError: There is no such dictionary or way of finding corners.
    """

    def __init__(self, dictionary: str | cv2.aruco.Dictionary, corners: str = "lines") -> None:
        if corners not in CORNER_FINDERS:
            raise PartInvalidError(
                f"corners by {corners!r} were asked; accepted: {', '.join(CORNER_FINDERS)}"
            )
        self._book = dictionary_of(dictionary) if isinstance(dictionary, str) else dictionary
        self._by_lines = corners == "lines"
        parameters = cv2.aruco.DetectorParameters()
        parameters.adaptiveThreshWinSizeStep = _WINDOWS_PX[1] - _WINDOWS_PX[0]
        if not self._by_lines:
            parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        self._parameters = parameters
        self._detector = cv2.aruco.ArucoDetector(self._book, parameters)
        self._plain = cv2.aruco.ArucoDetector(self._book)

    def find(
        self,
        image: NDArray[np.uint8],
        camera: CameraModel | None = None,
        windows: Sequence[tuple[int, int, int, int]] | None = None,
    ) -> Detection:
        """Finds markers in an image.

        An id that is there twice names no marker: all its finds are left out and it is listed.

        Args:
            image: shape (h, w) grey or (h, w, 3) BGR, 8 bit.
            camera: Lets the corners be refined without the bend of the distortion; None = without.
            windows: Parts of the image to look at, (left, top, right, bottom) [px]; None = all.

        Returns:
            The markers by rising id.

        Raises:
            ImageInvalidError: The array is no image.
        """
        grey = grey_image(image)
        parts = [(0, 0, grey.shape[1], grey.shape[0])] if windows is None else windows
        ids, corners, mirrored = np.zeros(0, dtype=np.int64), np.zeros((0, 4, 2)), set()
        for part in parts:
            found = self._in_part(grey, part)
            ids, corners = np.append(ids, found[0]), np.concatenate([corners, found[1]])
            mirrored |= found[2]
        keep, duplicates = _unique(ids, corners)
        ids, corners = ids[keep], corners[keep]
        order = np.argsort(ids)
        ids, corners = ids[order], corners[order]
        refined = self._refined(grey, corners, camera)
        whole = fits_print(grey, ids, refined.corners, self._book)
        return Detection(
            ids[whole],
            refined.corners[whole],
            refined.covariance[whole],
            refined.floor_px[whole],
            duplicates,
            tuple(sorted(mirrored)),
            tuple(ids[~whole].tolist()),
        )

    def _in_part(
        self, grey: NDArray[np.uint8], part: tuple[int, int, int, int]
    ) -> tuple[NDArray[np.int64], Array, set[int]]:
        left, top, right, bottom = part
        window = grey[top:bottom, left:right]
        # OpenCV's limits are shares of the longer side of the image: the same in pixels.
        rate = 0.03 * max(grey.shape) / max(window.shape)
        parameters = self._parameters
        parameters.minMarkerPerimeterRate = min(rate, 3.0)
        whole = window.shape == grey.shape
        low, high = _WINDOWS_PX if whole else (_TRACKING_PX, _TRACKING_PX)
        parameters.adaptiveThreshWinSizeMin, parameters.adaptiveThreshWinSizeMax = low, high
        self._detector.setDetectorParameters(self._parameters)
        found, found_ids, rejected = self._detector.detectMarkers(np.ascontiguousarray(window))
        corners = np.asarray(found, dtype=float).reshape(-1, 4, 2)
        mirrored = mirrored_ids(window, rejected, corners, self._plain)
        if len(corners) == 0:
            return np.zeros(0, dtype=np.int64), np.zeros((0, 4, 2)), mirrored
        return np.asarray(found_ids, dtype=np.int64).ravel(), corners + (left, top), mirrored

    def _refined(
        self, grey: NDArray[np.uint8], corners: Array, camera: CameraModel | None
    ) -> RefinedCorners:
        refined = refine_corners(grey, corners, self._book.markerSize + 2, camera)
        if not self._by_lines:
            return replace(refined, corners=corners)
        for number in np.flatnonzero(~refined.fitted):
            refined.corners[number] = _subpix(grey, corners[number])
        return refined


def detect_markers(
    image: NDArray[np.uint8], dictionary: str, camera: CameraModel | None = None
) -> Detection:
    """Finds the markers of a dictionary in one image; see `MarkerDetector`."""
    return MarkerDetector(dictionary).find(image, camera)


def _subpix(grey: NDArray[np.uint8], corners: Array) -> Array:
    side = float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).min())
    half = int(np.clip(round(_SUBPIX_SHARE * side), 1, _SUBPIX_PX))
    start = np.ascontiguousarray(corners, dtype=np.float32).reshape(-1, 1, 2)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.01)
    found = cv2.cornerSubPix(grey, start, (half, half), (-1, -1), criteria)
    return np.asarray(found.reshape(4, 2), dtype=float)


def _unique(ids: NDArray[np.int64], corners: Array) -> tuple[NDArray[np.int64], tuple[int, ...]]:
    """Returns the finds to keep, one of a marker found twice, and the ids at several places."""
    keep, twice = [], []
    centres = corners.mean(axis=1)
    for marker_id in np.unique(ids):
        same = np.flatnonzero(ids == marker_id)
        side = np.linalg.norm(corners[same[0], 0] - corners[same[0], 1])
        apart = np.linalg.norm(centres[same] - centres[same[0]], axis=1)
        if np.all(apart < _SAME_MARKER * side):
            keep.append(same[0])
        else:
            log.debug("marker %d is there %d times: left out", marker_id, len(same))
            twice.append(int(marker_id))
    return np.array(keep, dtype=np.int64), tuple(twice)
