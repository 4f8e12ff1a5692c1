"""A scanner that casts rays at the true mesh (M2.1)."""

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import InputError
from skinplan.mesh.model import SurfaceMesh
from skinplan.scanner.model import CYLINDER, ScannerModel
from skinplan.scanner.rays import RayCaster
from skinplan.transforms import Array, apply, require_transform

_GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))


class Caster(Protocol):
    """What the scanner needs of a ray caster."""

    def hits(self, origins: Array, directions: Array) -> tuple[Array, NDArray[np.int64]]:
        """Returns distance (n,) [m], inf = miss, and face (n,), -1 = miss."""


class ScanFrame(NamedTuple):
    """What one frame saw.

    Attributes:
        points: In the scanner frame, shape (n, 3) [m].
        intensity: Returned light, shape (n,), 0 to 1.
        incidence: Angle between the view axis and the inward surface normal, shape (n,) [rad].
    """

    points: Array
    intensity: Array
    incidence: Array


class MockScanner:
    """Parallel rays over the disc of radius r_f: the paper's cylinder.

    Args:
        mesh: The true surface, in the workpiece frame.
        scanner: Field of view, range window and incidence limit.
        seed: Of the rays' places and the noise.
        rays: Rays of a frame.
        noise_m: Standard deviation along the ray [m].
        caster: Ray caster of that mesh; None = a new one.
    """

    def __init__(
        self,
        mesh: SurfaceMesh,
        scanner: ScannerModel,
        seed: int,
        rays: int = 900,
        noise_m: float = 3e-5,
        caster: Caster | None = None,
    ) -> None:
        if rays < 1:
            raise InputError(f"a scanner with {rays} rays was asked; at least 1 is accepted")
        if scanner.field != CYLINDER:
            raise InputError(
                f"the mock scanner has parallel rays: field_of_view {CYLINDER} is accepted, found "
                f"{scanner.field}"
            )
        self._normals = mesh.face_normals
        self._scanner = scanner
        self._caster: Caster = RayCaster(mesh) if caster is None else caster
        self._noise_m = noise_m
        self._random = np.random.default_rng([seed, 0x5CA2])
        # Sunflower pattern: the same area for every ray.
        self._radii = scanner.field_radius_m * np.sqrt((np.arange(rays) + 0.5) / rays)
        self._angles = _GOLDEN_ANGLE * np.arange(rays)

    def frame(self, T_workpiece_scanner: Array) -> ScanFrame:
        """Takes one frame; the pattern is turned and jittered anew for each.

        A ray measures where it first meets the surface: within the range window, and not more
        oblique than the incidence limit.

        Args:
            T_workpiece_scanner: True pose, shape (4, 4) [m]; +x is the view direction.

        Returns:
            The points, possibly none.

        Raises:
            InputError: The pose is no rigid transform.
        """
        pose = require_transform(T_workpiece_scanner, "T_workpiece_scanner")
        starts = self._starts()
        axis = pose[:3, 0]
        directions = np.repeat(axis[None, :], len(starts), axis=0)
        distance, face = self._caster.hits(apply(pose, starts), directions)
        cosine = -self._normals[face] @ axis
        seen = (
            (face >= 0)
            & (distance >= self._scanner.range_min_m)
            & (distance <= self._scanner.range_max_m)
            & (cosine >= np.cos(self._scanner.incidence_max_rad))
        )
        points = starts[seen]
        points[:, 0] += distance[seen] + self._random.normal(0.0, self._noise_m, int(seen.sum()))
        cosine = np.clip(cosine[seen], 0.0, 1.0)
        glitter = self._random.uniform(0.9, 1.0, len(cosine))
        return ScanFrame(points, cosine * glitter, np.arccos(cosine))

    def _starts(self) -> Array:
        """Where the rays leave, in the scanner frame, shape (r, 3) [m]."""
        limit = self._scanner.field_radius_m
        pitch = limit / np.sqrt(len(self._radii))
        angles = self._angles + self._random.uniform(0.0, 2.0 * np.pi)
        places = self._radii[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        places += self._random.uniform(-pitch, pitch, places.shape)
        radii = np.maximum(np.linalg.norm(places, axis=1, keepdims=True), 1e-12)
        places *= np.minimum(1.0, limit / radii)
        return np.column_stack([np.zeros(len(places)), places])
