"""Parts in an image of the tray: background difference, opening, outlines, rectangles (R 1)."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from skinplan.errors import InputError
from skinplan.recognition.tray_light import light_ratio
from skinplan.recognition.tray_view import Image, TrayView
from skinplan.transforms import Array

# Added to the brightness that differences are measured by [grey values].
_FLOOR_LEVEL = 4.0


@dataclass(frozen=True)
class BlobSettings:
    """How parts are told from the tray.

    Attributes:
        compensate_light: Whether a change of light between image and background is estimated and
            taken off, and differences are measured by the brightness about them; without it grey
            values are compared as they are.
        threshold: Least difference that counts, as a share of the brightness about it [1].
        plain_threshold: Same without compensation [grey values].
        brightness_m: The brightness about a place is the mean over so many metres of the tray [m].
        close_m: Gaps up to this are closed: sides of parts that are as bright as a bar [m].
        open_m: What is narrower is no part: bars of the tray and their edges [m].
        least_area_m2: Smaller outlines are no parts [m^2].
    """

    compensate_light: bool = True
    threshold: float = 0.5
    plain_threshold: float = 18.0
    brightness_m: float = 0.09
    close_m: float = 0.006
    open_m: float = 0.009
    least_area_m2: float = 0.0008

    def __post_init__(self) -> None:
        """Refuses figures that are no lengths, areas or thresholds."""
        for name in (
            "threshold",
            "plain_threshold",
            "brightness_m",
            "close_m",
            "open_m",
            "least_area_m2",
        ):
            value = getattr(self, name)
            if not np.isfinite(value) or value <= 0.0:
                raise InputError(f"{name} {value:g} was given; a number above 0 is accepted")


@dataclass(frozen=True, eq=False)
class Blob:
    """An outline on the tray; all on the plane of the tray, in its frame.

    Attributes:
        outline: Points of the outer outline, shape (n, 2) [m].
        area_m2: Area inside it [m^2].
        centre: Centre of the rectangle of least area around it, shape (2,) [m].
        size_m: Longer and shorter side of the rectangle [m].
        heading_rad: Direction of the longer side, in [0, pi).
        corners: Corners of the rectangle, shape (4, 2) [m].
        cut_off: It reaches the rim of what is looked at: more of it may be outside.
    """

    outline: Array
    area_m2: float
    centre: Array
    size_m: tuple[float, float]
    heading_rad: float
    corners: Array
    cut_off: bool = False

    @property
    def aspect(self) -> float:
        """Longer side over shorter side."""
        return self.size_m[0] / max(self.size_m[1], 1e-9)


def difference_mask(image: Image, background: Image, view: TrayView, how: BlobSettings) -> Image:
    """Tells the parts from the tray.

    Args:
        image: Flat image with parts, of `TrayView.flat`, shape (h, w).
        background: Flat image of the empty tray.
        view: Where the pixels are.
        how: Settings.

    Returns:
        255 where something lies, else 0, shape (h, w); opened.
    """
    if how.compensate_light:
        expected = background.astype(np.float32) * light_ratio(image, background)
        pixels = max(1, round(how.brightness_m / view.settings.pixel_m))
        about = cv2.blur(expected.astype(np.float32), (pixels, pixels)) + _FLOOR_LEVEL
        different = np.abs(image - expected) > how.threshold * about
    else:
        different = cv2.absdiff(image, background) > how.plain_threshold
    mask = different.astype(np.uint8) * 255
    closed = _morphed(mask, cv2.MORPH_CLOSE, how.close_m, view.settings.pixel_m)
    return opened(closed, how.open_m, view.settings.pixel_m)


def opened(mask: Image, length_m: float, pixel_m: float) -> Image:
    """Takes away what is narrower than a length [m] from a mask, shape (h, w)."""
    return _morphed(mask, cv2.MORPH_OPEN, length_m, pixel_m)


def _morphed(mask: Image, operation: int, length_m: float, pixel_m: float) -> Image:
    pixels = max(1, round(length_m / pixel_m)) | 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (pixels, pixels))
    return np.asarray(cv2.morphologyEx(mask, operation, kernel), dtype=np.uint8)


def blobs(
    image: object, background: object, view: TrayView, how: BlobSettings | None = None
) -> list[Blob]:
    """Finds what lies on the tray.

    Args:
        image: Image of the camera, 8 bit, grey or BGR.
        background: Image of the empty tray by the same camera.
        view: Camera and tray.
        how: Settings.

    Returns:
        The outlines, the largest first.

    Raises:
        ImageInvalidError: An image is missing, has another size, or is badly exposed.
    """
    how = how or BlobSettings()
    flat, empty = view.flat(image, "image"), view.flat(background, "background image")
    return blobs_of(difference_mask(flat, empty, view, how), view, how.least_area_m2)


def blobs_of(mask: Image, view: TrayView, least_area_m2: float) -> list[Blob]:
    """Finds the outlines of a mask, the largest first; small ones are left out."""
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    # Outlines run through the middles of the outer pixels: half a pixel inside all round.
    found = []
    for outline in outlines:
        if len(outline) < 3:
            continue
        blob = _blob(np.asarray(outline, dtype=np.int32).reshape(-1, 2), view)
        if blob.area_m2 >= least_area_m2:
            found.append(blob)
    return sorted(found, key=lambda blob: (-round(blob.area_m2, 9), *np.round(blob.centre, 6)))


def _blob(outline: NDArray[np.int32], view: TrayView) -> Blob:
    pixel = view.settings.pixel_m
    inner = float(cv2.contourArea(outline))
    rim = float(cv2.arcLength(outline, closed=True))
    middle, size, _ = rectangle = cv2.minAreaRect(outline)
    corners = cv2.boxPoints(rectangle).astype(float)
    centre = np.array(middle, dtype=float)
    sides = np.array(size) * pixel + pixel
    along = corners[1] - corners[0]
    other = corners[2] - corners[1]
    if np.linalg.norm(other) > np.linalg.norm(along):
        along = other
    grown = centre + (corners - centre) * (1.0 + 1.0 / np.maximum(np.min(size), 1.0))
    low, high = outline.min(axis=0), outline.max(axis=0)
    edge = np.array(view.shape[::-1]) - 1
    return Blob(
        outline=view.metres(outline.astype(float)),
        area_m2=(inner + rim / 2.0 + 1.0) * pixel**2,
        centre=view.metres(centre),
        size_m=(float(sides.max()), float(sides.min())),
        heading_rad=float(np.arctan2(along[1], along[0]) % np.pi),
        corners=view.metres(grown),
        cut_off=bool(np.any(low <= 1) or np.any(high >= edge - 1)),
    )
