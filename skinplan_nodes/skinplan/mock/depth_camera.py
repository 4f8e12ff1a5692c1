"""A stereo depth camera that casts rays at the true mesh, aligned with the colour image.

Noise by the error of the disparity, as Intel states it for the D400 series: a depth z is measured
with a standard deviation of z^2 s / (f b), with the sub-pixel error s of the disparity [px], the
focal length f [px] and the baseline b [m].
"""

import numpy as np

from skinplan.errors import InputError
from skinplan.localization.camera import camera_model, undistorted
from skinplan.mesh.model import SurfaceMesh
from skinplan.robot.cell import CameraConfig
from skinplan.scanner.rays import RayCaster
from skinplan.transforms import Array, apply, inverse, require_transform, rotate

#: D435: distance of its two cameras, error of the disparity, range of the depth (data sheet).
BASELINE_M, SUBPIXEL_PX, RANGE_M = 0.050, 0.08, (0.3, 3.0)
# Surfaces more oblique than this give no depth.
_INCIDENCE_MAX_RAD = np.deg2rad(80.0)


class DepthCamera:
    """Depth image of the part, as points.

    Args:
        camera: Figures of the colour camera, whose pixels the points belong to.
        mesh: The true surface, workpiece frame.
        seed: Of the noise.
        step_px: One ray per so many columns and rows.
    """

    def __init__(self, camera: CameraConfig, mesh: SurfaceMesh, seed: int, step_px: int = 6):
        if step_px < 1:
            raise InputError(f"a ray per {step_px} pixels was asked; at least 1 is accepted")
        model = camera_model(camera)
        columns, rows = np.meshgrid(
            np.arange(step_px / 2, model.width, step_px),
            np.arange(step_px / 2, model.height, step_px),
        )
        pixels = np.column_stack([columns.ravel(), rows.ravel()])
        rays = np.column_stack([undistorted(pixels, model), np.ones(len(pixels))])
        self._rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        self._noise_m = SUBPIXEL_PX / (float(model.K[0, 0]) * BASELINE_M)
        self._caster = RayCaster(mesh)
        self._normals = mesh.face_normals
        self._random = np.random.default_rng([seed, 0xD435])

    def cloud(self, T_camera_workpiece: Array) -> Array:
        """Takes one depth image.

        Args:
            T_camera_workpiece: True pose of the workpiece in the optical frame, shape (4, 4) [m].

        Returns:
            Points in the optical frame, shape (n, 3) [m]; pixels without depth are left out.

        Raises:
            InputError: The pose is no rigid transform.
        """
        pose = inverse(require_transform(T_camera_workpiece, "T_camera_workpiece"))
        origins = np.repeat(apply(pose, np.zeros((1, 3))), len(self._rays), axis=0)
        directions = rotate(pose, self._rays)
        distance, face = self._caster.hits(origins, directions)
        cosine = np.abs(np.einsum("ij,ij->i", self._normals[face], directions))
        depth = np.where(face >= 0, distance, 0.0) * self._rays[:, 2]
        seen = (
            (face >= 0)
            & (depth >= RANGE_M[0])
            & (depth <= RANGE_M[1])
            & (cosine >= np.cos(_INCIDENCE_MAX_RAD))
        )
        rays, depth = self._rays[seen], depth[seen]
        depth += self._random.normal(0.0, 1.0, len(depth)) * self._noise_m * depth**2
        return np.asarray(rays / rays[:, 2:] * depth[:, None])
