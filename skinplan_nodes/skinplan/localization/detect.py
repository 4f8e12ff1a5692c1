"""Markers in an image: identity by OpenCV's detector, corners by lines along the edges (M1.2)."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from skinplan.errors import PartInvalidError
from skinplan.localization.edges import RefinedCorners, refine_corners
from skinplan.localization.foreign import foreign_ids
from skinplan.localization.grey import grey_image
from skinplan.localization.growth import common_growth, drawn_in, edge_growth, lie_aside
from skinplan.localization.mirrored import mirrored_ids
from skinplan.localization.model import CameraModel, Detection
from skinplan.localization.print_check import fits_print
from skinplan.transforms import Array

log = logging.getLogger(__name__)

CORNER_FINDERS = ("auto", "lines", "subpix")
# Half the light lies farther inside than this: a dark tone curve over a blur with long ends, which
# draws the edges outwards.
_SKEWED_PX = -0.06
# Share of the shift that stays when it is taken off.
_GROWTH_LEFT = 0.2
# By how much blur draws the corners of OpenCV's finder inwards [px].
_SUBPIX_PULL_PX = 0.15
# Two finds of one id closer than this share of the marker's side are the same marker.
_SAME_MARKER = 0.5
# Windows of the adaptive threshold: the small one for far markers, the large one for near ones.
# OpenCV's own third one costs a third of the time and finds nothing more.
_WINDOWS_PX = (3, 29)
# One is enough near a marker that was found before; without it the whole image is looked at.
_TRACKING_PX = 15
# Markers of more than half again as many pixels are made so large for the search, at least half as
# large as they are: the corners are then found in the full image, from there.
_SEARCHED_SIDE_PX, _LEAST_SCALE = 60.0, 0.5
# Half window of `cornerSubPix`: share of a cell, at most so many pixels; and when it ends.
_SUBPIX_SHARE, _SUBPIX_PX = 0.3, 5
_SUBPIX_UNTIL = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.01)
_MOST_FINDERS = 16  # that are kept, each of other ids
# The detector that finds, and the one for mirror images.
_Finders = tuple[cv2.aruco.ArucoDetector, cv2.aruco.ArucoDetector]


@dataclass(frozen=True)
class Window:
    """Part of an image.

    Attributes:
        left: First column [px].
        top: First row [px].
        right: Column behind the last one [px].
        bottom: Row behind the last one [px].
        side_px: Side of the smallest marker in it; 0 = not known.
    """

    left: int
    top: int
    right: int
    bottom: int
    side_px: float = 0.0


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


class MarkerDetector:
    """Finds the markers of a dictionary.

    Args:
        dictionary: Name as OpenCV writes it, or a dictionary of one's own.
        corners: ``lines`` (along the edges), ``subpix`` (OpenCV's corner finder; it draws the
            corners inwards under blur), or ``auto``: lines, but OpenCV's corner finder for a marker
            whose edges the image has drawn outwards without telling by how much.

    Attributes:
        book: The dictionary.

    Raises:
        PartInvalidError: There is no such dictionary or way of finding corners.
    """

    def __init__(self, dictionary: str | cv2.aruco.Dictionary, corners: str = "auto") -> None:
        if corners not in CORNER_FINDERS:
            raise PartInvalidError(
                f"corners by {corners!r} were asked; accepted: {', '.join(CORNER_FINDERS)}"
            )
        self.book = dictionary_of(dictionary) if isinstance(dictionary, str) else dictionary
        self._corners = corners
        parameters = cv2.aruco.DetectorParameters()
        parameters.adaptiveThreshWinSizeStep = _WINDOWS_PX[1] - _WINDOWS_PX[0]
        self._parameters = parameters
        self._finders = self._made(self.book)
        self._lit = np.zeros((0, 0), np.float32)
        self._lit_parts: list[tuple[slice, slice]] = []
        self._few: dict[tuple[int, ...], _Finders] = {}

    def find(
        self,
        image: NDArray[np.uint8],
        camera: CameraModel | None = None,
        windows: Sequence[Window] | None = None,
        ids: Sequence[int] | None = None,
    ) -> Detection:
        """Finds markers in an image.

        An id that is there twice names no marker: all its finds are left out and it is listed.

        Args:
            image: shape (h, w) grey or (h, w, 3) BGR, 8 bit.
            camera: Lets the corners be refined without the bend of the distortion; None = without.
            windows: Parts of the image to look at; None = all. Mirror images and other ids are not
                looked for in them.
            ids: Those that count, which takes less time; others are only named. None = all of the
                dictionary.

        Returns:
            The markers by rising id.

        Raises:
            ImageInvalidError: The array is no image.
        """
        grey = grey_image(image)
        parts = [Window(0, 0, grey.shape[1], grey.shape[0])] if windows is None else windows
        own = self._own(ids)
        finders = self._finders if own is None else self._finders_of(tuple(own.tolist()))
        looks = [self._in_part(grey, part, finders, whole=windows is None) for part in parts]
        numbers = np.concatenate([look[0] for look in looks])
        corners = np.concatenate([look[1] for look in looks])
        mirrored = {number for look in looks for number in look[2]}
        if own is not None:
            numbers, mirrored = own[numbers], {int(own[number]) for number in mirrored}
        keep, duplicates = _unique(numbers, corners)
        numbers, corners = numbers[keep], corners[keep]
        light = self._light(grey, parts)
        foreign: set[int] = set()
        if own is not None and windows is None:
            others = foreign_ids(grey, looks[0][3], looks[0][1], self.book)
            foreign = set(others.tolist()) - set(own.tolist())
        refined, growth_px, whole = self._refined(grey, light, numbers, corners, camera)
        whole &= fits_print(light, numbers, refined.corners, self.book)
        return Detection(
            numbers[whole],
            refined.corners[whole],
            refined.covariance[whole],
            refined.floor_px[whole],
            duplicates,
            tuple(sorted(mirrored)),
            tuple(numbers[~whole].tolist()),
            growth_px,
            tuple(sorted(foreign)),
        )

    def _light(self, grey: NDArray[np.uint8], parts: Sequence[Window]) -> NDArray[np.float32]:
        """Returns parts of an image in floating point, 0 elsewhere; valid until the next image.

        New memory for every image costs more than what is done in it.
        """
        if self._lit.shape != grey.shape:
            self._lit, self._lit_parts = np.zeros(grey.shape, np.float32), []
        for part in self._lit_parts:
            self._lit[part] = 0.0
        self._lit_parts = [np.s_[w.top : w.bottom, w.left : w.right] for w in parts]
        for part in self._lit_parts:
            self._lit[part] = grey[part]
        return self._lit

    def _own(self, ids: Sequence[int] | None) -> NDArray[np.int64] | None:
        """Returns those of the dictionary, rising; None = all, also where none of them is."""
        count = len(self.book.bytesList)
        own = sorted({i for i in ids or () if i < count})
        return np.array(own, dtype=np.int64) if own else None

    def _finders_of(self, ids: tuple[int, ...]) -> _Finders:
        """Returns detectors of a few ids: comparing with a thousand takes 2 ms a quadrilateral."""
        if ids not in self._few:
            if len(self._few) >= _MOST_FINDERS:
                self._few.clear()
            few = cv2.aruco.Dictionary(
                self.book.bytesList[list(ids)], self.book.markerSize, self.book.maxCorrectionBits
            )
            self._few[ids] = self._made(few)
        return self._few[ids]

    def _made(self, book: cv2.aruco.Dictionary) -> _Finders:
        """Returns the detector that finds, and the one for mirror images."""
        return cv2.aruco.ArucoDetector(book, self._parameters), cv2.aruco.ArucoDetector(book)

    def _in_part(
        self,
        grey: NDArray[np.uint8],
        part: Window,
        finders: _Finders,
        *,
        whole: bool,
    ) -> tuple[NDArray[np.int64], Array, set[int], Array]:
        """Returns ids, corners, what is mirrored, and corners of what was rejected."""
        window = np.ascontiguousarray(grey[part.top : part.bottom, part.left : part.right])
        large = part.side_px > 1.5 * _SEARCHED_SIDE_PX
        scale = max(_SEARCHED_SIDE_PX / part.side_px, _LEAST_SCALE) if large else 1.0
        if large:
            size = np.rint(np.multiply(window.shape[::-1], scale)).astype(int)
            smaller = cv2.resize(window, size.tolist(), interpolation=cv2.INTER_AREA)
            window = np.asarray(smaller, dtype=np.uint8)
        # OpenCV's limits are shares of the longer side of the image: the same in pixels.
        rate = 0.03 * scale * max(grey.shape) / max(window.shape)
        parameters = self._parameters
        parameters.minMarkerPerimeterRate = min(rate, 3.0)
        low, high = _WINDOWS_PX if whole else (_TRACKING_PX, _TRACKING_PX)
        parameters.adaptiveThreshWinSizeMin, parameters.adaptiveThreshWinSizeMax = low, high
        finder, plain = finders
        finder.setDetectorParameters(self._parameters)
        found, found_ids, rejected = finder.detectMarkers(window)
        corners = np.asarray(found, dtype=float).reshape(-1, 4, 2)
        mirrored = mirrored_ids(window, rejected, corners, plain) if whole else set()
        quads = np.asarray(rejected, dtype=float).reshape(-1, 4, 2)
        if len(corners) == 0:
            return np.zeros(0, dtype=np.int64), corners, mirrored, quads
        placed = (corners + 0.5) / scale - 0.5 + (part.left, part.top)
        return np.asarray(found_ids, dtype=np.int64).ravel(), placed, mirrored, quads

    def _refined(
        self,
        grey: NDArray[np.uint8],
        light: NDArray[np.float32],
        ids: NDArray[np.int64],
        corners: Array,
        camera: CameraModel | None,
    ) -> tuple[RefinedCorners, float, NDArray[np.bool_]]:
        cells = self.book.markerSize + 2
        found = refine_corners(light, corners, cells, camera)
        by_finder, shift = np.full(len(ids), self._corners == "subpix"), 0.0
        whole = np.ones(len(ids), dtype=bool)
        if self._corners != "subpix":
            growth, sigma, aside = edge_growth(light, ids, found.corners, self.book)
            odd = lie_aside(light, ids, found.corners, aside, self.book, camera)
            whole &= ~(odd & found.fitted)
            shift = common_growth(growth[~odd], sigma[~odd])
            if shift == 0.0 and self._corners == "auto":
                by_finder = found.skew_px < _SKEWED_PX
            if shift != 0.0:
                own = found.fitted
                found.corners[own] = drawn_in(found.corners[own], shift)
                found.floor_px[own] = np.hypot(found.floor_px[own], _GROWTH_LEFT * shift)
        for number in np.flatnonzero(by_finder | ~found.fitted):
            found.corners[number] = _subpix(grey, corners[number], cells)
            found.floor_px[number] = max(found.floor_px[number], _SUBPIX_PULL_PX)
        return found, shift, whole


def detect_markers(
    image: NDArray[np.uint8], dictionary: str, camera: CameraModel | None = None
) -> Detection:
    """Finds the markers of a dictionary in one image; see `MarkerDetector`."""
    return MarkerDetector(dictionary).find(image, camera)


def _subpix(grey: NDArray[np.uint8], corners: Array, cells: int) -> Array:
    """Returns corners of one marker by OpenCV's corner finder, with the detector's own settings."""
    side = float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).mean())
    half = int(np.clip(round(_SUBPIX_SHARE * side / cells), 1, _SUBPIX_PX))
    start = np.ascontiguousarray(corners, dtype=np.float32).reshape(-1, 1, 2)
    found = cv2.cornerSubPix(grey, start, (half, half), (-1, -1), _SUBPIX_UNTIL)
    return np.asarray(found.reshape(4, 2), dtype=float)


def _unique(ids: NDArray[np.int64], corners: Array) -> tuple[NDArray[np.int64], tuple[int, ...]]:
    """Returns which finds to keep, by rising id, and the ids that are at several places.

    Of a marker that was found twice one find is kept.
    """
    keep, twice = [], []
    several = np.unique(ids)
    if len(several) == len(ids):
        return np.argsort(ids), ()
    centres = corners.mean(axis=1)
    for marker_id in several:
        same = np.flatnonzero(ids == marker_id)
        side = np.linalg.norm(corners[same[0], 0] - corners[same[0], 1])
        apart = np.linalg.norm(centres[same] - centres[same[0]], axis=1)
        if np.all(apart < _SAME_MARKER * side):
            keep.append(same[0])
        else:
            log.debug("marker %d is there %d times: left out", marker_id, len(same))
            twice.append(int(marker_id))
    return np.array(keep, dtype=np.int64), tuple(twice)
