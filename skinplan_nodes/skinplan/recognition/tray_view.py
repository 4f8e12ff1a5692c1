"""The tray seen straight from above: images of a camera, put on the tray's plane in metres."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from skinplan.errors import ImageInvalidError, InputError
from skinplan.localization.camera import in_view, project, require_camera
from skinplan.localization.model import CameraModel
from skinplan.transforms import Array, apply, inverse, require_transform

Image = NDArray[np.uint8]

_SATURATED = 250
_DARK = 3
_MOST_PIXELS = 40_000_000


@dataclass(frozen=True)
class ViewSettings:
    """How images are put on the tray's plane, and which are refused.

    Attributes:
        pixel_m: Side of a pixel there [m].
        margin_m: So much around the tray is looked at, too [m].
        saturated_ratio_max: Largest share of saturated pixels [1]; more is over-exposed.
        dark_ratio_max: Largest share of black pixels [1]; more is under-exposed.
    """

    pixel_m: float = 0.001
    margin_m: float = 0.06
    saturated_ratio_max: float = 0.02
    dark_ratio_max: float = 0.5


class TrayView:
    """Puts images on the plane z = 0 of the tray."""

    def __init__(
        self,
        camera: CameraModel,
        T_camera_tray: Array,
        size_m: tuple[float, float],
        settings: ViewSettings | None = None,
    ) -> None:
        """Finds where each place of the tray is in the image.

        Args:
            camera: The camera.
            T_camera_tray: Frame of the tray (origin at a corner, x along the longer side, z up) in
                the optical frame, shape (4, 4) [m].
            size_m: Sides of the tray [m].
            settings: Figures.

        Raises:
            ImageInvalidError: No camera, or it does not see the whole tray from above.
            InputError: The pose is none, or the pixels are too small.
        """
        self.settings = settings or ViewSettings()
        self.camera, self.size_m = require_camera(camera), size_m
        T_camera_tray = require_transform(T_camera_tray, "T_camera_tray")
        self.eye = inverse(T_camera_tray)[:3, 3]
        pixel, margin = self.settings.pixel_m, self.settings.margin_m
        self.shape = (self._count(size_m[1]), self._count(size_m[0]))
        if not pixel > 0.0 or self.shape[0] * self.shape[1] > _MOST_PIXELS:
            raise InputError(
                f"pixels of {pixel:g} m on a tray of {size_m[0]:g} x {size_m[1]:g} m were asked "
                f"for; at most {_MOST_PIXELS} pixels in all are accepted"
            )
        self._require_seen(T_camera_tray)
        rows, columns = np.mgrid[: self.shape[0], : self.shape[1]]
        x, y = columns * pixel - margin, rows * pixel - margin
        flat = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
        pixels = project(apply(T_camera_tray, flat), self.camera).astype(np.float32)
        self._columns = np.ascontiguousarray(pixels[:, 0].reshape(self.shape))
        self._rows = np.ascontiguousarray(pixels[:, 1].reshape(self.shape))

    def _count(self, length_m: float) -> int:
        return round((length_m + 2.0 * self.settings.margin_m) / self.settings.pixel_m) + 1

    def _require_seen(self, T_camera_tray: Array) -> None:
        corners = np.array(
            [[x, y, 0.0] for x in (0.0, self.size_m[0]) for y in (0.0, self.size_m[1])]
        )
        seen = in_view(apply(T_camera_tray, corners), self.camera)
        if self.eye[2] <= 0.0 or not seen.all():
            raise ImageInvalidError(
                f"the camera sees {int(seen.sum())} of the 4 corners of the tray, from a height of "
                f"{self.eye[2]:.2f} m; a camera above the tray that sees all of it is accepted"
            )

    def flat(self, image: object, name: str) -> Image:
        """Returns an image of the tray straight from above, row 0 at the least y.

        Args:
            image: Grey or BGR image of the camera, shape (h, w) or (h, w, 3), 8 bit; None = there
                is none.
            name: What it is, for messages.

        Raises:
            ImageInvalidError: There is none, it is of another size or kind, or it is over- or
                under-exposed.
        """
        flat = cv2.remap(
            self._grey(image, name),
            self._columns,
            self._rows,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        grey = np.asarray(flat, dtype=np.uint8)
        self._require_exposed(grey, name)
        return grey

    def _grey(self, image: object, name: str) -> Image:
        if image is None:
            raise ImageInvalidError(
                f"no {name} was given; an image of {self.camera.width} x {self.camera.height} px "
                "is accepted"
            )
        found = np.asarray(image)
        if found.dtype != np.uint8 or found.ndim not in (2, 3) or found.shape[2:] not in ((), (3,)):
            raise ImageInvalidError(
                f"the {name} is an array of {found.dtype} of shape {found.shape}; a grey or BGR "
                "image of 8 bit is accepted"
            )
        if found.shape[:2] != (self.camera.height, self.camera.width):
            raise ImageInvalidError(
                f"the {name} has {found.shape[1]} x {found.shape[0]} px; {self.camera.width} x "
                f"{self.camera.height} px as those of the camera are accepted"
            )
        return found if found.ndim == 2 else np.asarray(cv2.cvtColor(found, cv2.COLOR_BGR2GRAY))

    def _require_exposed(self, flat: Image, name: str) -> None:
        saturated = float(np.mean(flat >= _SATURATED))
        if saturated > self.settings.saturated_ratio_max:
            raise ImageInvalidError(
                f"the {name} is over-exposed: {100 * saturated:.0f} % of the tray is saturated; at "
                f"most {100 * self.settings.saturated_ratio_max:g} % is accepted, with a shorter "
                "exposure"
            )
        dark = float(np.mean(flat <= _DARK))
        if dark > self.settings.dark_ratio_max:
            raise ImageInvalidError(
                f"the {name} is under-exposed: {100 * dark:.0f} % of the tray is black; at most "
                f"{100 * self.settings.dark_ratio_max:g} % is accepted, with a longer exposure"
            )

    def metres(self, pixels: Array) -> Array:
        """Returns places on the tray, shape (n, 2) [m], of pixels of the flat image (x, y)."""
        return np.asarray(pixels * self.settings.pixel_m - self.settings.margin_m)

    def pixels(self, places: Array) -> Array:
        """Returns pixels of the flat image (x, y), shape (n, 2), of places on the tray [m]."""
        return np.asarray((places + self.settings.margin_m) / self.settings.pixel_m)

    def shadow(self, points: Array) -> Array:
        """Returns where points, shape (..., 3) [m], appear on the tray's plane, shape (..., 2)."""
        share = self.eye[2] / np.maximum(self.eye[2] - points[..., 2], 1e-9)
        return np.asarray(self.eye[:2] + (points[..., :2] - self.eye[:2]) * share[..., None])
