"""Pose from points and their pixels: the two solutions of a square, and least squares over many."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from skinplan.localization.camera import project, project_with_derivative
from skinplan.localization.model import CameraModel
from skinplan.transforms import Array, apply, transform

# Prior of the corner noise: what the edge fit reaches on rendered images at 1 m, and its weight as
# a count of observations. The residuals of the image itself are added to it.
CORNER_NOISE_PX = 0.02
_PRIOR_COUNT = 8.0
_ROUNDS = 30
_DAMPING = 1e-4
_SMALLEST_STEP = 1e-10
# Keeps the equations solvable where a point is behind the camera and nothing can be derived.
_LEAST_SCALE = 1e-9
# What a point behind the camera counts as [px].
_BEHIND_PX = 1e4


@dataclass(frozen=True, eq=False)
class Solution:
    """A pose and how well it explains the pixels.

    Attributes:
        T_camera_object: shape (4, 4) [m].
        covariance: shape (6, 6), x y z [m] rx ry rz [rad] in the optical frame.
        error_px: Root mean square of the distances between pixels and projections [px].
    """

    T_camera_object: Array
    covariance: Array
    error_px: float


def square_corners(size_m: float) -> Array:
    """Returns top left, top right, bottom right, bottom left of a marker, shape (4, 3) [m]."""
    half = 0.5 * size_m
    return np.array(
        [[-half, half, 0.0], [half, half, 0.0], [half, -half, 0.0], [-half, -half, 0.0]]
    )


def square_solutions(corners: Array, size_m: float, camera: CameraModel) -> list[Array]:
    """Returns the poses that explain the image of a square: two, or one where they coincide.

    Args:
        corners: In the order of `square_corners`, shape (4, 2) [px].
        size_m: Side of the square [m].
        camera: The camera.

    Returns:
        ``T_camera_marker``, shape (4, 4) [m] each; empty where the corners are degenerate.
    """
    _, turns, places, _ = cv2.solvePnPGeneric(
        square_corners(size_m), corners, camera.K, camera.D, flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    poses = []
    for turn, place in zip(turns, places, strict=True):
        if np.all(np.isfinite(turn)) and np.all(np.isfinite(place)):
            rotation = Rotation.from_rotvec(turn.ravel()).as_matrix()
            poses.append(transform(place.ravel(), rotation))
    return poses


def reprojection_error(
    T_camera_object: Array, points: Array, pixels: Array, camera: CameraModel
) -> float:
    """Returns the root mean square distance between pixels and projections [px]."""
    seen = apply(T_camera_object, points)
    if seen[:, 2].min() <= 0.0:
        return _BEHIND_PX
    return float(np.sqrt(np.mean(np.sum((project(seen, camera) - pixels) ** 2, axis=1))))


def refine(T_camera_object: Array, points: Array, pixels: Array, camera: CameraModel) -> Solution:
    """Least squares of the reprojection by Levenberg-Marquardt.

    Args:
        T_camera_object: Where to start, shape (4, 4) [m].
        points: In the object's frame, shape (n, 3) [m], n >= 4.
        pixels: shape (n, 2) [px].
        camera: The camera.

    Returns:
        The local minimum with covariance ``(J^T J)^-1 sigma^2``; sigma is estimated from the
        residuals together with the prior `CORNER_NOISE_PX`.
    """
    pose, damping = T_camera_object, _DAMPING
    residual, jacobian = _linearised(pose, points, pixels, camera)
    cost = float(residual @ residual)
    for _ in range(_ROUNDS):
        normal = jacobian.T @ jacobian
        scale = np.diag(np.maximum(np.diag(normal), _LEAST_SCALE))
        step = -np.linalg.solve(normal + damping * scale, jacobian.T @ residual)
        moved = _moved(pose, step)
        new_residual, new_jacobian = _linearised(moved, points, pixels, camera)
        new_cost = float(new_residual @ new_residual)
        if new_cost < cost:
            settled = cost - new_cost < 1e-12 * cost
            pose, residual, jacobian, cost = moved, new_residual, new_jacobian, new_cost
            damping *= 0.1
            if settled:
                break
        else:
            damping *= 10.0
        if np.abs(step).max() < _SMALLEST_STEP:
            break
    free = max(2 * len(points) - 6, 0)
    variance = (cost + _PRIOR_COUNT * CORNER_NOISE_PX**2) / (free + _PRIOR_COUNT)
    covariance = variance * np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    return Solution(pose, np.asarray(covariance, dtype=float), float(np.sqrt(cost / len(points))))


def _linearised(
    T_camera_object: Array, points: Array, pixels: Array, camera: CameraModel
) -> tuple[Array, Array]:
    """Returns residuals, (2 n,) [px], and their derivative by (x, y, z, rx, ry, rz), (2 n, 6)."""
    arm = points @ T_camera_object[:3, :3].T
    seen = arm + T_camera_object[:3, 3]
    if seen[:, 2].min() <= 0.0:
        return np.full(2 * len(points), _BEHIND_PX), np.zeros((2 * len(points), 6))
    projected, by_point = project_with_derivative(seen, camera)
    by_turn = np.zeros((len(points), 3, 3))
    by_turn[:, 0, 1], by_turn[:, 0, 2], by_turn[:, 1, 2] = arm[:, 2], -arm[:, 1], arm[:, 0]
    by_turn -= np.swapaxes(by_turn, 1, 2)
    jacobian = np.concatenate([by_point, by_point @ by_turn], axis=2)
    return (projected - pixels).ravel(), jacobian.reshape(-1, 6)


def _moved(T_camera_object: Array, step: NDArray[np.floating]) -> Array:
    result = T_camera_object.copy()
    result[:3, :3] = Rotation.from_rotvec(step[3:]).as_matrix() @ result[:3, :3]
    result[:3, 3] += step[:3]
    return result
