"""Coarse scan of the whole tray and fine scans of single parts (R2.2)."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from skinplan.recognition.tray.camera import (
    CameraSettings,
    Scene,
    View,
    VirtualCamera,
    looking_at,
    moved,
)
from skinplan.recognition.tray.layout import TRAY_SIZE_M, PlacedPart, tray_grid
from skinplan.transforms import Array

# The coarse scan: square images of this side, edge to edge at the height of the highest part, from
# this height [m].
_TILE_M, _COARSE_M = 0.45, 0.9
_FINE_M = 0.45


@dataclass(frozen=True)
class ScanSettings:
    """How the tray is scanned.

    Attributes:
        coarse_step_m: Distance of points on the tray in the coarse scan [m].
        coarse_high_m: The coarse images overlap so far that they leave no gap at this height over
            the tray: images that meet on the tray would cut a part in two whose flange stands high
            where they meet [m].
        fine_step_m: In the fine scan [m].
        side_views: Views from around in the fine scan, besides the one from above.
        tilt_rad: Of these views, from the vertical.
        camera: Noise and edges; its opening angle and pixels follow from the steps.
    """

    coarse_step_m: float = 0.002
    coarse_high_m: float = 0.06
    fine_step_m: float = 0.001
    side_views: int = 4
    tilt_rad: float = 0.8
    camera: CameraSettings = field(default_factory=CameraSettings)


def tray_scene(parts: Sequence[PlacedPart], size_m: tuple[float, float] = TRAY_SIZE_M) -> Scene:
    """The tray's grid and what lies on it, frame of the tray [m]."""
    return Scene([tray_grid(size_m), *(moved(part.mesh, part.T_tray_part) for part in parts)])


def coarse_scan(
    scene: Scene,
    rng: np.random.Generator,
    settings: ScanSettings | None = None,
    size_m: tuple[float, float] = TRAY_SIZE_M,
) -> list[View]:
    """Scans the tray straight from above, image beside image.

    Args:
        scene: Frame of the tray [m].
        rng: Noise.
        settings: How.
        size_m: Tray.
    """
    settings = settings or ScanSettings()
    half = _TILE_M / 2.0 * _COARSE_M / (_COARSE_M - settings.coarse_high_m)
    camera = VirtualCamera(scene, _camera(settings, half, _COARSE_M, True))
    counts = [max(1, int(np.ceil(length / _TILE_M - 1e-9))) for length in size_m]
    centres = [((np.array(index) + 0.5) * _TILE_M)[:2] for index in np.ndindex(*counts)]
    return [
        camera.shot(looking_at(np.array([x, y, 0.0]), _COARSE_M, 0.0, 0.0), rng) for x, y in centres
    ]


def fine_scan(
    scene: Scene,
    middle: Array,
    radius_m: float,
    rng: np.random.Generator,
    settings: ScanSettings | None = None,
) -> list[View]:
    """Scans one part from above and from around.

    Args:
        scene: Frame of the tray [m].
        middle: Of the part, shape (3,) [m].
        radius_m: So far around it [m].
        rng: Noise.
        settings: How.
    """
    settings = settings or ScanSettings()
    far = max(_FINE_M, 2.0 * radius_m)
    camera = VirtualCamera(scene, _camera(settings, radius_m, far, False))
    poses = [looking_at(middle, far, 0.0, 0.0)]
    for side in range(settings.side_views):
        azimuth = 2.0 * np.pi * side / settings.side_views
        poses.append(looking_at(middle, far, azimuth, settings.tilt_rad))
    return [camera.shot(pose, rng) for pose in poses]


def _camera(settings: ScanSettings, half_m: float, far_m: float, coarse: bool) -> CameraSettings:
    step = settings.coarse_step_m if coarse else settings.fine_step_m
    return CameraSettings(
        half_angle_rad=float(np.arctan2(half_m, far_m)),
        pixels=max(2, round(2.0 * half_m / step)),
        noise_m=settings.camera.noise_m,
        incidence_max_rad=settings.camera.incidence_max_rad,
        range_m=(0.2 * far_m, 2.0 * far_m),
        edge_jump_m=settings.camera.edge_jump_m,
        edge_ratio=settings.camera.edge_ratio,
    )
