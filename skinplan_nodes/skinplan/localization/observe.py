"""From an image to the fixture's markers (M1.2)."""

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import ImageInvalidError
from skinplan.localization.camera import require_camera
from skinplan.localization.detect import MarkerDetector
from skinplan.localization.grey import grey_image
from skinplan.localization.judge import judged
from skinplan.localization.model import CameraModel, Sighting
from skinplan.localization.partly import completed
from skinplan.part.model import Fixture
from skinplan.robot.cell import QualitySettings


def observe(
    image: NDArray[np.uint8],
    camera: CameraModel,
    fixture: Fixture,
    quality: QualitySettings,
    corners: str = "auto",
) -> Sighting:
    """Finds the fixture's markers in one image; `tracking.MarkerTracker` does it for many.

    Args:
        image: shape (h, w) grey or (h, w, 3) BGR, 8 bit, of the camera's size.
        camera: The camera; of a rectified image its K is the projection's and D is empty.
        fixture: The markers that count.
        quality: Figures of eq (3).
        corners: How corners are found, see `MarkerDetector`.

    Returns:
        What is seen; no markers where none of the fixture's is.

    Raises:
        ImageInvalidError: The image or the camera can't be used, or the sizes differ.
    """
    camera = require_camera(camera)
    require_size(image, camera)
    detector = MarkerDetector(fixture.dictionary, corners)
    grey = grey_image(image)
    found = detector.find(grey, camera, ids=[marker.id for marker in fixture.markers])
    seen = judged(found, camera, fixture, quality)
    return completed(seen, found, grey, detector.book, camera, fixture, quality)


def require_size(image: NDArray[np.uint8], camera: CameraModel) -> None:
    """Refuses an image of another size than the camera's.

    Raises:
        ImageInvalidError: The sizes differ.
    """
    if np.shape(image)[:2] != (camera.height, camera.width):
        raise ImageInvalidError(
            f"an image of {camera.width} x {camera.height} px, as the camera model says, is "
            f"accepted, found shape {np.shape(image)}"
        )
