"""Photos of the tray by a virtual 2-D camera: rays against parts and grid, with uneven light.

Light is a field over the tray's plane (lamps at one side, a lamp over a corner) on matt surfaces;
parts cast no shadows. Frame of the tray: see `skinplan.recognition.tray.layout`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from skinplan.localization.camera import undistorted
from skinplan.localization.model import CameraModel
from skinplan.mesh.model import SurfaceMesh
from skinplan.recognition.tray.layout import TRAY_SIZE_M, PlacedPart, tray_grid
from skinplan.scanner.rays import RayCaster
from skinplan.transforms import Array, inverse, rotate, transform

Image = NDArray[np.uint8]

# Reflectance of parts, of the bars of the tray, and of the floor far below it.
PART, BAR, FLOOR = 0.55, 0.28, 0.08
# Share of the light that comes from all sides.
_AMBIENT = 0.45
_FULL_SCALE = 255.0


@dataclass(frozen=True)
class Light:
    """How a photo is lit and exposed.

    Attributes:
        ratio: Brightness at one short side of the tray over that at the other, at least 1; it
            grows evenly, by the same share per metre.
        heading_rad: Direction toward the bright side, from the tray's x.
        lamp: Further brightness right below a lamp over the corner at (0, 0) [1]; falls off as a
            bell of 0.35 m.
        exposure: Grey value over reflectance at the middle of the tray [1].
        noise: Standard deviation of the camera's noise [grey values].
    """

    ratio: float = 1.0
    heading_rad: float = 0.0
    lamp: float = 0.0
    exposure: float = 220.0
    noise: float = 1.5

    def at(self, places: Array) -> Array:
        """Returns the brightness at places over the tray, shape (n, 2) [m], shape (n,)."""
        toward = np.array([np.cos(self.heading_rad), np.sin(self.heading_rad)])
        along = (places - np.array(TRAY_SIZE_M) / 2.0) @ toward / TRAY_SIZE_M[0]
        bell = np.exp(-(places**2).sum(axis=1) / (2.0 * 0.35**2))
        return np.asarray(self.ratio**along * (1.0 + self.lamp * bell))


def camera_above(
    width: int = 1296, height: int = 1024, distance_m: float = 1.3
) -> tuple[CameraModel, Array]:
    """Makes the camera of the cell: it looks down at the middle of the tray, 79.6 degrees wide.

    Args:
        width: [px].
        height: [px].
        distance_m: Height over the tray [m].

    Returns:
        The camera, with a little distortion, and ``T_tray_camera``, shape (4, 4) [m].
    """
    focal = width / 2.0 / np.tan(np.deg2rad(79.6) / 2.0)
    K = np.array([[focal, 0.0, (width - 1) / 2.0], [0.0, focal, (height - 1) / 2.0], [0, 0, 1.0]])
    camera = CameraModel(width, height, K, np.array([-0.03, 0.01, 0.0003, -0.0002, 0.0]))
    down = Rotation.from_euler("x", np.pi).as_matrix()
    return camera, transform((TRAY_SIZE_M[0] / 2.0, TRAY_SIZE_M[1] / 2.0, distance_m), down)


class Photographer:
    """Takes photos with one camera."""

    def __init__(self, camera: CameraModel, T_tray_camera: Array) -> None:
        """Aims the camera.

        Args:
            camera: The camera.
            T_tray_camera: Optical frame in that of the tray, shape (4, 4) [m].
        """
        self._camera, self._T_tray_camera = camera, T_tray_camera
        y, x = np.mgrid[: camera.height, : camera.width]
        flat = undistorted(np.stack([x.ravel(), y.ravel()], axis=1).astype(float), camera)
        rays = np.column_stack([flat, np.ones(len(flat))])
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        self._rays = rotate(T_tray_camera, rays)

    def photo(
        self, parts: Sequence[PlacedPart], light: Light | None = None, seed: int = 0
    ) -> Image:
        """Takes a photo of parts on the tray; none = the background.

        Args:
            parts: What lies there.
            light: How it is lit; None = evenly.
            seed: Of the noise.

        Returns:
            Grey values, shape (height, width).
        """
        light = light or Light()
        grid = _surface(tray_grid())
        bodies = [_surface(part.mesh, part.T_tray_part) for part in parts]
        caster = RayCaster(grid, bodies)
        eye = self._T_tray_camera[:3, 3]
        distance, face = caster.hits(np.broadcast_to(eye, self._rays.shape), self._rays)
        solid = np.where(face < caster.part_faces, BAR, PART)
        reflectance = np.where(face < 0, FLOOR, solid)
        normals = np.concatenate([body.face_normals for body in (grid, *bodies)])
        upward = np.where(face < 0, 1.0, np.abs(normals[face, 2]))
        # The floor is lit as the tray above it.
        reach = np.where(np.isfinite(distance), distance, -eye[2] / self._rays[:, 2])
        places = eye[:2] + reach[:, None] * self._rays[:, :2]
        grey = light.exposure * reflectance * (_AMBIENT + (1.0 - _AMBIENT) * upward)
        grey = grey * light.at(places)
        noise = np.random.default_rng(seed).normal(0.0, light.noise, len(grey))
        shape = (self._camera.height, self._camera.width)
        return np.clip(np.round(grey + noise), 0.0, _FULL_SCALE).astype(np.uint8).reshape(shape)

    @property
    def T_camera_tray(self) -> Array:
        """Frame of the tray in that of the camera, shape (4, 4) [m]."""
        return inverse(self._T_tray_camera)


def _surface(mesh: trimesh.Trimesh, T_tray_part: Array | None = None) -> SurfaceMesh:
    vertices = np.asarray(mesh.vertices, dtype=float)
    if T_tray_part is not None:
        vertices = vertices @ T_tray_part[:3, :3].T + T_tray_part[:3, 3]
    return SurfaceMesh(vertices, np.asarray(mesh.faces, dtype=np.int64))
