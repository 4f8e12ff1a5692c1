"""Markers in a stream of images: near where they were, with a look at everything now and then."""

import numpy as np
from numpy.typing import NDArray

from skinplan.localization.camera import require_camera
from skinplan.localization.detect import MarkerDetector, Window
from skinplan.localization.edge_lines import narrowest_px
from skinplan.localization.grey import grey_image
from skinplan.localization.judge import judged
from skinplan.localization.model import CameraModel, Sighting
from skinplan.localization.observe import require_size
from skinplan.localization.partly import completed, misses_any
from skinplan.part.model import Fixture
from skinplan.robot.cell import QualitySettings
from skinplan.transforms import Array

# A window reaches so far beyond a marker: share of the marker's size, at least so many pixels.
_MARGIN_SHARE, _LEAST_MARGIN_PX = 0.4, 12.0
# The whole image is looked at every so many images: a new marker, or a second one of an id.
_WHOLE_EVERY = 10
# Windows that cover more than this share of the image save nothing.
_LARGEST_SHARE = 0.5


class MarkerTracker:
    """Finds the markers of one fixture in image after image.

    Args:
        fixture: The markers.
        quality: Figures of eq (3).
        corners: How corners are found, see `MarkerDetector`.

    Attributes:
        windowed: Whether the last image was looked at near the markers only.
    """

    def __init__(self, fixture: Fixture, quality: QualitySettings, corners: str = "auto") -> None:
        self._fixture = fixture
        self._own = [marker.id for marker in fixture.markers]
        self._quality = quality
        self._detector = MarkerDetector(fixture.dictionary, corners)
        self._last: Sighting | None = None
        self._since_whole = 0
        self._missed = False
        self.windowed = False

    def observe(self, image: NDArray[np.uint8], camera: CameraModel) -> Sighting:
        """Finds the fixture's markers in the next image; arguments and errors as `observe`."""
        camera = require_camera(camera)
        require_size(image, camera)
        grey = grey_image(image)
        windows = self._windows(grey.shape[1], grey.shape[0])
        self.windowed = windows is not None
        found, seen = None, None
        if windows is not None and self._last is not None:
            ids = [item.id for item in self._last.markers]
            found = self._detector.find(grey, camera, windows, ids)
            seen = judged(found, camera, self._fixture, self._quality)
            if not _same(seen, self._last):
                seen, self.windowed = None, False
        if found is None or seen is None:
            self._since_whole = 0
            found = self._detector.find(grey, camera, ids=self._own)
            seen = judged(found, camera, self._fixture, self._quality)
            self._missed = misses_any(seen, camera, self._fixture)
        else:
            self._since_whole += 1
        self._last = seen
        if not self._missed:
            # One that gets hidden is missing near its place, and the whole image is looked at.
            return seen
        book = self._detector.book
        return completed(seen, found, grey, book, camera, self._fixture, self._quality)

    def _windows(self, width: int, height: int) -> list[Window] | None:
        """Returns where to look; None = everywhere."""
        last = self._last
        if last is None or not last.markers or self._since_whole + 1 >= _WHOLE_EVERY:
            return None
        if last.duplicates or last.mirrored:
            return None
        windows = _merged([_window(item.corners, width, height) for item in last.markers])
        area = sum((item.right - item.left) * (item.bottom - item.top) for item in windows)
        return windows if area <= _LARGEST_SHARE * width * height else None


def _same(seen: Sighting, last: Sighting | None) -> bool:
    """Tells whether the markers of the last image are all there again, and nothing is odd."""
    if last is None or seen.duplicates or seen.mirrored:
        return False
    return [item.id for item in seen.markers] == [item.id for item in last.markers]


def _window(corners: Array, width: int, height: int) -> Window:
    low, high = corners.min(axis=0), corners.max(axis=0)
    margin = max(_MARGIN_SHARE * float((high - low).max()), _LEAST_MARGIN_PX)
    left, top = np.maximum(np.floor(low - margin), 0.0).astype(int)
    right, bottom = np.minimum(np.ceil(high + margin), [width, height]).astype(int)
    return Window(int(left), int(top), int(right), int(bottom), narrowest_px(corners))


def _merged(windows: list[Window]) -> list[Window]:
    """Joins windows that overlap."""
    result: list[Window] = []
    for window in windows:
        joined = window
        while True:
            other = next((item for item in result if _overlap(item, joined)), None)
            if other is None:
                break
            result.remove(other)
            joined = Window(
                min(joined.left, other.left),
                min(joined.top, other.top),
                max(joined.right, other.right),
                max(joined.bottom, other.bottom),
                min(joined.side_px, other.side_px),
            )
        result.append(joined)
    return result


def _overlap(a: Window, b: Window) -> bool:
    return a.left < b.right and b.left < a.right and a.top < b.bottom and b.top < a.bottom
