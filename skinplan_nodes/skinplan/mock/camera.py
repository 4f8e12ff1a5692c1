"""A camera that renders the fixture's markers as its real counterpart would see them."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from skinplan.errors import ImageInvalidError
from skinplan.localization.camera import camera_model, project
from skinplan.localization.detect import dictionary_of
from skinplan.part.model import Fixture, Marker
from skinplan.robot.cell import CameraConfig
from skinplan.transforms import Array, apply, inverse, require_transform

Image = NDArray[np.uint8]
# What falls on the sensor, in grey levels, before it is read out.
Light = NDArray[np.float32]

# White plate round the black square, in cells of the marker on every side.
_QUIET_CELLS = 1.5
# Texels per cell: the rim of the plate lies between two as well.
_TEXELS = 2
# Samples per pixel and axis.
_SAMPLES = 3
_BLACK, _WHITE = 28, 222
_COVER = 110
_NEAREST_M = 0.05
# The noise frame is larger than the image by this: every image takes another cut-out.
_NOISE_MARGIN = 96


@dataclass(frozen=True, eq=False)
class _Plate:
    """A marker with its white plate, in the marker frame.

    Attributes:
        half_m: Half of the plate's side [m].
        texel_m: Side of one texel [m].
        T_workpiece_marker: shape (4, 4) [m].
        texture: Grey value and whether it covers, by texels, shape (t, t, 2), 0 to 255 and 0 or 1.
    """

    half_m: float
    texel_m: float
    T_workpiece_marker: Array
    texture: NDArray[np.float32]


class MockCamera:
    """Perspective camera with distortion, blur, noise and a shaded grey background.

    Args:
        camera: Figures of the camera.
        fixture: Its markers are what can be seen; the part itself is not drawn.
        seed: Of the noise.
        blur_px: Standard deviation of the blur [px]; 0 = none.
        noise: Standard deviation of the noise [grey levels]; 0 = none.
        light: Share of the full light; little light means little contrast, not less noise. May be
            changed between images.
        samples: Samples per pixel and axis.
    """

    def __init__(
        self,
        camera: CameraConfig,
        fixture: Fixture,
        seed: int,
        blur_px: float = 0.7,
        noise: float = 2.0,
        light: float = 1.0,
        samples: int = _SAMPLES,
    ) -> None:
        self._camera = camera_model(camera)
        self._plates = tuple(
            _plate(
                fixture.dictionary, marker, fixture.T_workpiece_fixture @ marker.T_fixture_marker
            )
            for marker in fixture.markers
        )
        self._blur_px = blur_px
        self.light = light
        self._samples = samples
        self._random = np.random.default_rng([seed, 0xCA3E])
        shape = (self._camera.height, self._camera.width)
        self._rays = self._pixel_rays()
        self._background = _shading(*shape)
        self._noise: NDArray[np.float32] | None = None
        if noise > 0.0:
            larger = (shape[0] + _NOISE_MARGIN, shape[1] + _NOISE_MARGIN)
            self._noise = self._random.normal(0.0, noise, larger).astype(np.float32)

    def render(self, T_camera_workpiece: Array, covers: Sequence[Array] = ()) -> Image:
        """Renders one image.

        Args:
            T_camera_workpiece: True pose of the workpiece in the optical frame, shape (4, 4) [m].
            covers: What stands before the markers: polygons in the image, shape (k, 2) [px].

        Returns:
            Grey image, shape (height, width).

        Raises:
            InputError: The pose is no rigid transform.
        """
        pose = require_transform(T_camera_workpiece, "T_camera_workpiece")
        image = self._background.copy()
        seen = [(pose @ plate.T_workpiece_marker, plate) for plate in self._plates]
        for T_camera_marker, plate in sorted(seen, key=lambda pair: -pair[0][2, 3]):
            self._draw(image, T_camera_marker, plate)
        for cover in covers:
            cv2.fillPoly(image, [np.rint(cover).astype(np.int32)], _COVER)
        if self.light != 1.0:
            image *= np.float32(self.light)
        if self._blur_px > 0.0:
            cv2.GaussianBlur(image, (0, 0), self._blur_px, dst=image)
        return self._read_out(image)

    def _draw(self, image: Light, T_camera_marker: Array, plate: _Plate) -> None:
        """Blends one plate into the image, unless it is behind the camera or seen from the back."""
        outline = apply(T_camera_marker, _rim(plate.half_m))
        if outline[:, 2].min() < _NEAREST_M or T_camera_marker[:3, 2] @ T_camera_marker[:3, 3] >= 0:
            return
        pixels = project(outline, self._camera)
        low = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - 2, 0)
        high = np.minimum(
            np.ceil(pixels.max(axis=0)).astype(int) + 3, [self._camera.width, self._camera.height]
        )
        if np.any(high - low < 2):
            return
        window = np.s_[low[1] : high[1], low[0] : high[0]]
        layer = self._sampled(window, T_camera_marker, plate)
        image[window] *= 1.0 - layer[..., 1]
        image[window] += layer[..., 0]

    def _sampled(
        self, window: tuple[slice, slice], T_camera_marker: Array, plate: _Plate
    ) -> NDArray[np.float32]:
        """Looks the texture up at several places per pixel and takes the mean, shape (h, w, 2)."""
        rays = self._rays[window]
        # A ray r meets the marker plane at s r with marker coordinates M r / (n . r).
        T_marker_camera = inverse(T_camera_marker)
        eye = T_marker_camera[:3, 3]
        turn = T_marker_camera[:3, :3]
        to_plane = (turn[:2] * -eye[2] + np.outer(eye[:2], turn[2])) / plate.texel_m
        top = rays @ to_plane[:, :2].T.astype(np.float32) + to_plane[:, 2].astype(np.float32)
        below = rays @ turn[2, :2].astype(np.float32) + np.float32(turn[2, 2])
        at = top / np.where(np.abs(below) < 1e-9, np.float32(1e-9), below)[..., None]
        middle = np.float32(plate.texture.shape[0] / 2.0)
        x = _softened(at[..., 0] + middle, self._samples)
        y = _softened(middle - at[..., 1], self._samples)
        fine = cv2.remap(plate.texture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        mean = cv2.resize(fine, rays.shape[1::-1], interpolation=cv2.INTER_AREA)
        return np.asarray(mean, dtype=np.float32)

    def _pixel_rays(self) -> NDArray[np.float32]:
        """Where the undistorted ray of every pixel meets z = 1, shape (h, w, 2)."""
        rows, columns = np.mgrid[: self._camera.height, : self._camera.width]
        pixels = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2).astype(float)
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-10)
        rays = cv2.undistortPoints(pixels, self._camera.K, self._camera.D, criteria=criteria)
        if not np.all(np.isfinite(rays)):
            raise ImageInvalidError("the camera's distortion can't be inverted over its image")
        return rays.reshape(self._camera.height, self._camera.width, 2).astype(np.float32)

    def _read_out(self, light: Light) -> Image:
        """Adds noise and rounds, once and last, as a sensor does: noise dithers rounding."""
        if self._noise is not None:
            height, width = light.shape
            row, column = self._random.integers(0, _NOISE_MARGIN, 2)
            light += self._noise[row : row + height, column : column + width]
        grey = cv2.convertScaleAbs(np.maximum(light, 0.0, out=light))
        return np.asarray(grey, dtype=np.uint8)


def _rim(half_m: float) -> Array:
    """Returns points along the four edges of a square, shape (36, 3) [m]."""
    steps = np.linspace(-half_m, half_m, 9)
    ends, flat = np.full_like(steps, half_m), np.zeros_like(steps)
    edges = ((steps, ends), (steps, -ends), (ends, steps), (-ends, steps))
    return np.vstack([np.column_stack([x, y, flat]) for x, y in edges])


def _softened(places: NDArray[np.float32], samples: int) -> NDArray[np.float32]:
    """Returns where to look a texture up, for so many samples per pixel and axis.

    Between two texels lies an edge. Read at the places returned it rises over the width of one
    sample: as of the light that falls on it, the mean of the samples changes in proportion to the
    place of the edge, however it lies between them.

    Args:
        places: In texels, whole numbers on the edges, at the pixels' centres, shape (h, w).
        samples: How many.

    Returns:
        In the texture's own numbers, whole ones in the middle of a texel, shape (s h, s w).
    """
    slope = cv2.magnitude(*(np.gradient(places, axis=axis) for axis in (0, 1)))
    width = np.clip(slope / np.float32(samples), 1e-6, 1.0).astype(np.float32)
    fine, rise = (
        cv2.resize(values, None, fx=samples, fy=samples, interpolation=cv2.INTER_LINEAR)
        for values in (places, width)
    )
    edge = np.rint(fine)
    beyond = np.clip((fine - edge) / rise, -0.5, 0.5)
    return np.asarray(edge + beyond - 0.5, dtype=np.float32)


def _plate(dictionary: str, marker: Marker, T_workpiece_marker: Array) -> _Plate:
    book = dictionary_of(dictionary)
    cells = book.markerSize + 2
    bits = cv2.aruco.generateImageMarker(book, marker.id, cells, borderBits=1)
    grey = np.where(bits > 127, _WHITE, _BLACK).astype(np.float32)
    texel_m = marker.size_m / cells / _TEXELS
    quiet = round(_QUIET_CELLS * _TEXELS)
    value = np.pad(np.kron(grey, np.ones((_TEXELS, _TEXELS))), quiet, constant_values=_WHITE)
    texture = np.dstack([value, np.ones_like(value)]).astype(np.float32)
    half_m = 0.5 * marker.size_m + quiet * texel_m
    return _Plate(half_m, texel_m, T_workpiece_marker, texture)


def _shading(height: int, width: int) -> Light:
    """A grey wall, lighter at the top left, darker at the bottom."""
    y, x = np.mgrid[0.0 : 1.0 : height * 1j, 0.0 : 1.0 : width * 1j]
    shade = 128.0 + 18.0 * (0.5 - y) + 12.0 * (0.5 - x) + 6.0 * np.sin(5.0 * x + 2.0 * y)
    return np.asarray(shade, dtype=np.float32)
