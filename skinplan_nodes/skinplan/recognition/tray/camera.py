"""A virtual 3-D camera: a grid of rays against what stands in front of it, with noise.

Structured-light scanners measure flat places to micrometres; where the depth jumps within one pixel
they see a mixture of both sides. Optical frame: z forward, x right, y down.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from skinplan.errors import InputError
from skinplan.mesh.model import SurfaceMesh
from skinplan.scanner.rays import RayCaster
from skinplan.transforms import Array, apply, require_transform, rotate, transform


@dataclass(frozen=True)
class CameraSettings:
    """What the camera sees and how well.

    Attributes:
        half_angle_rad: Half opening angle of the square image [rad].
        pixels: To a side.
        noise_m: Standard deviation along the ray [m].
        incidence_max_rad: Flatter rays give no point.
        range_m: Least and largest distance along the optical axis [m].
        edge_jump_m: Depth steps between neighbouring pixels above this are edges [m].
        edge_ratio: Share of the pixels at edges that see a mixture of both sides [1].
    """

    half_angle_rad: float = 0.35
    pixels: int = 300
    noise_m: float = 5e-6
    incidence_max_rad: float = 1.4
    range_m: tuple[float, float] = (0.1, 1.2)
    edge_jump_m: float = 0.0015
    edge_ratio: float = 0.3


@dataclass(frozen=True, eq=False)
class View:
    """What one shot gave.

    Attributes:
        points: World frame, shape (n, 3) [m].
        seen_from: Where the camera stood, shape (3,) [m].
    """

    points: Array
    seen_from: Array


class Scene:
    """Bodies that cameras look at.

    Args:
        meshes: In the world frame, at least one [m].

    Raises:
        InputError: There is none.
    """

    def __init__(self, meshes: Sequence[trimesh.Trimesh]) -> None:
        self.mesh = _joined(meshes)
        self.rays = RayCaster(self.mesh)


class VirtualCamera:
    """Takes shots of bodies.

    Args:
        scene: What it looks at.
        settings: The camera.
    """

    def __init__(self, scene: Scene, settings: CameraSettings | None = None) -> None:
        self._settings = settings or CameraSettings()
        self._scene = scene
        self._directions = _directions(self._settings)

    def shot(self, T_world_optical: Array, rng: np.random.Generator) -> View:
        """Takes one.

        Args:
            T_world_optical: Where the camera stands, shape (4, 4) [m].
            rng: Noise.

        Raises:
            InputError: A pose that is none.
        """
        pose = require_transform(T_world_optical, "camera pose")
        along = rotate(pose, self._directions)
        distance, faces = self._scene.rays.hits(np.broadcast_to(pose[:3, 3], along.shape), along)
        # Depth along the optical axis: steps of it are edges.
        depth = distance * self._directions[:, 2]
        low, high = self._settings.range_m
        seen = (faces >= 0) & (depth > low) & (depth < high)
        slope = np.abs(np.einsum("ij,ij->i", self._scene.mesh.face_normals[faces], along))
        seen &= slope > np.cos(self._settings.incidence_max_rad)
        distance = self._mixed(np.where(seen, distance, np.nan), seen, rng)
        distance = distance + rng.normal(0.0, self._settings.noise_m, len(distance))
        kept = np.isfinite(distance)
        return View(pose[:3, 3] + distance[kept, None] * along[kept], pose[:3, 3].copy())

    def _mixed(self, distance: Array, seen: NDArray[np.bool_], rng: np.random.Generator) -> Array:
        """Puts some of the pixels beside a depth step anywhere between both sides."""
        side = self._settings.pixels
        image = distance.reshape(side, side)
        share = rng.random(image.shape)
        chosen = rng.random(image.shape) < self._settings.edge_ratio
        mixed = image.copy()
        for axis in (0, 1):
            for step in (-1, 1):
                other = np.roll(image, step, axis=axis)
                jump = np.abs(other - image) > self._settings.edge_jump_m
                mixed = np.where(jump & chosen, image + share * (other - image), mixed)
        return np.where(seen, mixed.ravel(), np.nan)


def looking_at(target: Array, distance_m: float, azimuth_rad: float, tilt_rad: float) -> Array:
    """Pose of a camera that looks at a place from above.

    Args:
        target: World frame, shape (3,) [m].
        distance_m: From there [m].
        azimuth_rad: Side from which it looks, about z from x.
        tilt_rad: From the vertical; 0 = straight down.

    Returns:
        ``T_world_optical``, shape (4, 4) [m].

    Raises:
        InputError: A distance that is not positive.
    """
    if not distance_m > 0.0:
        raise InputError(f"a positive distance of the camera is accepted, found {distance_m} m")
    toward = np.array(
        [
            np.sin(tilt_rad) * np.cos(azimuth_rad),
            np.sin(tilt_rad) * np.sin(azimuth_rad),
            np.cos(tilt_rad),
        ]
    )
    right = np.array([-np.sin(azimuth_rad), np.cos(azimuth_rad), 0.0])
    forward = -toward
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    return transform(np.asarray(target) + distance_m * toward, rotation)


def _directions(settings: CameraSettings) -> Array:
    edge = np.tan(settings.half_angle_rad)
    steps = (np.arange(settings.pixels) + 0.5) / settings.pixels * 2.0 - 1.0
    x, y = np.meshgrid(edge * steps, edge * steps)
    rays = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1)
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def _joined(meshes: Sequence[trimesh.Trimesh]) -> SurfaceMesh:
    if not meshes:
        raise InputError("a camera needs at least one body before it, found none")
    firsts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    return SurfaceMesh(
        np.concatenate([np.asarray(mesh.vertices) for mesh in meshes]),
        np.concatenate(
            [np.asarray(mesh.faces) + first for mesh, first in zip(meshes, firsts, strict=True)]
        ),
    )


def moved(mesh: trimesh.Trimesh, T_world_mesh: Array) -> trimesh.Trimesh:
    """Returns a mesh in another frame."""
    points = apply(T_world_mesh, np.asarray(mesh.vertices))
    return trimesh.Trimesh(points, mesh.faces, process=False, validate=False)
