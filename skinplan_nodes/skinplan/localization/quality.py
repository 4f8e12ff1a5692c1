"""Quality of a marker view, eq (3) of M1.2."""

import numpy as np

from skinplan.errors import InputError
from skinplan.robot.cell import QualitySettings
from skinplan.transforms import Array


def angle_and_distance(T_camera_marker: Array) -> tuple[float, float]:
    """Returns theta and d of eq (3).

    Args:
        T_camera_marker: Marker in the optical frame, shape (4, 4) [m].

    Returns:
        Angle between the optical axis and the marker plane, in [0, pi/2], pi/2 = fronto-parallel
        [rad], and the distance of the camera from that plane [m].
    """
    angles, distances = angles_and_distances(T_camera_marker)
    return float(angles), float(distances)


def angles_and_distances(T_camera_marker: Array) -> tuple[Array, Array]:
    """Does the same for many markers, shape (..., 4, 4) [m]: theta [rad], d [m], shape (...)."""
    normals = T_camera_marker[..., :3, 2]
    angles = np.arcsin(np.minimum(np.abs(normals[..., 2]), 1.0))
    return angles, np.abs((normals * T_camera_marker[..., :3, 3]).sum(axis=-1))


def marker_quality(angle_rad: float, distance_m: float, settings: QualitySettings) -> float:
    """Quality E of eq (3): alpha sin(theta) + (1 - alpha) (d_max - d) / (d_max - d_min).

    The distance counts as d_min where it is smaller and as d_max where it is larger, so E is in
    [0, 1], and 1 exactly at theta = pi/2 and d <= d_min.

    Args:
        angle_rad: theta, in [0, pi/2] [rad].
        distance_m: d, >= 0 [m].
        settings: alpha, d_min, d_max.

    Returns:
        E.

    Raises:
        InputError: An argument is not finite or out of range, or d_max is not above d_min.
    """
    return float(marker_qualities(np.array(angle_rad), np.array(distance_m), settings))


def marker_qualities(angles_rad: Array, distances_m: Array, settings: QualitySettings) -> Array:
    """Does the same for many markers, shape (...) each."""
    facing, nearness = _parts(angles_rad, distances_m, settings)
    return np.asarray(settings.alpha * facing + (1.0 - settings.alpha) * nearness)


def quality_parts(
    angle_rad: float, distance_m: float, settings: QualitySettings
) -> tuple[float, float]:
    """Returns the two parts that eq (3) weighs: sin(theta) and (d_max - d) / (d_max - d_min).

    Arguments and errors as `marker_quality`.
    """
    facing, nearness = _parts(np.array(angle_rad), np.array(distance_m), settings)
    return float(facing), float(nearness)


def _parts(angles: Array, distances: Array, settings: QualitySettings) -> tuple[Array, Array]:
    near, far = settings.distance_min_m, settings.distance_max_m
    if not 0.0 <= settings.alpha <= 1.0 or not 0.0 < near < far:
        raise InputError(
            f"eq (3) takes alpha in [0, 1] and 0 < d_min < d_max, found alpha {settings.alpha}, "
            f"d_min {near} m, d_max {far} m"
        )
    possible = (angles >= 0.0) & (angles <= np.pi / 2 + 1e-9)
    possible &= (distances >= 0.0) & (distances < np.inf)
    if not np.all(possible):
        raise InputError(
            f"eq (3) takes theta in [0, pi/2] and d >= 0, found {angles[~possible].tolist()[:3]} "
            f"rad and {distances[~possible].tolist()[:3]} m"
        )
    return np.sin(angles), (far - np.clip(distances, near, far)) / (far - near)
