"""Camera, markers and poses, as the rooms exchange them."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from skinplan.transforms import Array


@dataclass(frozen=True, eq=False)
class CameraModel:
    """Perspective camera with distortion model ``plumb_bob`` or ``rational_polynomial``.

    Attributes:
        width: [px].
        height: [px].
        K: Camera matrix, shape (3, 3) [px].
        D: Distortion coefficients k1 k2 p1 p2 k3 k4 k5 k6, shape (8,), or as many of the first as
            differ from 0, shape (4,) or (5,); empty = none, also of a rectified image.
    """

    width: int
    height: int
    K: Array
    D: Array


@dataclass(frozen=True, eq=False)
class Detection:
    """Markers of one dictionary in one image.

    Attributes:
        ids: Rising, each once, shape (m,).
        corners: Top left, top right, bottom right, bottom left, shape (m, 4, 2) [px].
        covariance: Random part of the corners' error, x y of each corner, shape (m, 8, 8) [px^2].
        floor_px: Part of it that does not get less with more images, of each marker, shape (m,).
        duplicates: Ids that are there at several places; they name no marker and are left out.
        mirrored: Ids that are there as their mirror image: printed or looked at the wrong way.
        covered: Ids whose print does not lie where their corners say: something covers an edge.
        growth_px: By how much black reaches over its edges; it has been taken off the corners.
        foreign: Ids that were not looked for, and are there.
    """

    ids: NDArray[np.int64]
    corners: Array
    covariance: Array
    floor_px: Array
    duplicates: tuple[int, ...] = ()
    mirrored: tuple[int, ...] = ()
    covered: tuple[int, ...] = ()
    growth_px: float = 0.0
    foreign: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class Observation:
    """One marker in one image.

    Attributes:
        id: Marker id.
        size_m: Side of the black square [m].
        corners: Top left, top right, bottom right, bottom left, shape (4, 2) [px].
        corner_covariance: Random part of their error, shape (8, 8) [px^2].
        corner_floor_px: Part of it that does not get less with more images [px].
        T_camera_marker: Better one of the two planar solutions, in the camera's optical frame,
            shape (4, 4) [m].
        covariance: Of that pose, shape (6, 6), x y z [m] rx ry rz [rad] in the optical frame.
        reprojection_error_px: Root mean square over the corners [px].
        T_camera_second: The other solution, shape (4, 4) [m]; the same where they are one.
        second_error_px: Its reprojection error [px].
        ambiguity_ratio: Best over second reprojection error; 0 = they are one pose, near 1 = a
            guess.
        distance_m: d of eq (3) [m].
        angle_rad: theta of eq (3), pi/2 = fronto-parallel [rad].
        quality: E of eq (3).
    """

    id: int
    size_m: float
    corners: Array
    corner_covariance: Array
    corner_floor_px: float
    T_camera_marker: Array
    covariance: Array
    reprojection_error_px: float
    T_camera_second: Array
    second_error_px: float
    ambiguity_ratio: float
    distance_m: float
    angle_rad: float
    quality: float


@dataclass(frozen=True, eq=False)
class Sighting:
    """What one image, or several of one stand, show of a fixture.

    Attributes:
        markers: Its markers by rising id; empty = none.
        unknown: Ids of the dictionary that are not of the fixture.
        duplicates: Ids of the fixture that are there several times; they are left out.
        mirrored: Ids of the fixture that are there mirrored; they are left out.
        covered: Ids of the fixture that are partly hidden; they are left out.
        partly: Ids of markers that are partly hidden and count with the edges that are seen: where
            the others expect them. Of a hidden edge their corners know nothing.
        images: How many images it is made of.
    """

    markers: tuple[Observation, ...]
    unknown: tuple[int, ...] = ()
    duplicates: tuple[int, ...] = ()
    mirrored: tuple[int, ...] = ()
    covered: tuple[int, ...] = ()
    partly: tuple[int, ...] = ()
    images: int = 1


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
        ambiguity_ratio: Best over second reprojection error of two poses; 0 = there is one only.
        rejected_ids: Markers seen that are not where the fixture says, shape (r,).
        hidden_ids: Markers that should be in the image by this pose, but were not found: covered,
            in part or wholly, or too dim; shape (h,).
    """

    T_camera_workpiece: Array
    covariance: Array
    reprojection_error_px: float
    quality: float
    distance_m: float
    angle_rad: float
    marker_ids: NDArray[np.int64]
    ambiguity_ratio: float = 0.0
    rejected_ids: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    hidden_ids: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
