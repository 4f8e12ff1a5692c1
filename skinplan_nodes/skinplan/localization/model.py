"""Camera, markers and poses, as the rooms exchange them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.transforms import Array


@dataclass(frozen=True, eq=False)
class CameraModel:
    """Perspective camera with distortion model ``plumb_bob``.

    Attributes:
        width: [px].
        height: [px].
        K: Camera matrix, shape (3, 3) [px].
        D: Distortion coefficients, shape (5,); empty = none.
    """

    width: int
    height: int
    K: Array
    D: Array


@dataclass(frozen=True, eq=False)
class Observation:
    """One marker in one image.

    Attributes:
        id: Marker id.
        size_m: Side of the black square [m].
        corners: Top left, top right, bottom right, bottom left, shape (4, 2) [px].
        T_camera_marker: Pose in the camera's optical frame, shape (4, 4) [m].
        reprojection_error_px: Root mean square over the corners [px].
        ambiguity_ratio: Best over second reprojection error of the two planar solutions; 0 = they
            are one pose, near 1 = a guess.
        distance_m: d of eq (3) [m].
        angle_rad: theta of eq (3), pi/2 = fronto-parallel [rad].
        quality: E of eq (3).
    """

    id: int
    size_m: float
    corners: Array
    T_camera_marker: Array
    reprojection_error_px: float
    ambiguity_ratio: float
    distance_m: float
    angle_rad: float
    quality: float


@dataclass(frozen=True, eq=False)
class WorkpiecePose:
    """Pose of the workpiece from all markers of its fixture in one image.

    Attributes:
        T_camera_workpiece: In the camera's optical frame, shape (4, 4) [m].
        covariance: shape (6, 6), x y z [m] rx ry rz [rad] in the camera's optical frame.
        reprojection_error_px: Root mean square over all corners used [px].
        quality: E of eq (3) of the best marker used.
        distance_m: d of eq (3) of that marker [m].
        angle_rad: theta of eq (3) of that marker [rad].
        marker_ids: Markers used, shape (m,).
    """

    T_camera_workpiece: Array
    covariance: Array
    reprojection_error_px: float
    quality: float
    distance_m: float
    angle_rad: float
    marker_ids: NDArray[np.int64]
