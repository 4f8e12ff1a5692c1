"""Pose from points and their pixels: the two solutions of a square, and least squares over many."""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from skinplan.localization.camera import project, project_with_derivative
from skinplan.localization.model import CameraModel
from skinplan.transforms import Array, transform

_ROUNDS = 25
_DAMPING = 1e-4
_SMALLEST_STEP = 1e-9
# Keeps the equations solvable where nothing can be derived.
_LEAST_SCALE = 1e-9
_LEAST_SHARE = 1e-6
_RIDGE = 1e-14
_DAMPING_RANGE = (1e-9, 1e12)
# What a point behind the camera counts as [px].
_BEHIND_PX = 1e4
_BEHIND_WHITENED = 1e6
_LEAST_DEPTH_M = 1e-6
# Residuals that chance makes so large in one of a thousand images are no chance: the corners are
# worse than their noise says (a bent print, a camera that is calibrated badly).
_CHANCE = 0.999
# Weight of the corners' own covariance against the residuals, as a count of observations.
_PRIOR_COUNT = 60.0


@dataclass(frozen=True, eq=False)
class Solutions:
    """Local minima of the reprojection, one for each start.

    Attributes:
        poses: ``T_camera_object``, shape (b, 4, 4) [m].
        covariance: shape (b, 6, 6), x y z [m] rx ry rz [rad] in the optical frame.
        error_px: Root mean square of the distances between pixels and projections, shape (b,).
        marker_error_px: The same for each marker, shape (b, m).
    """

    poses: Array
    covariance: Array
    error_px: Array
    marker_error_px: Array


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
        square_corners(size_m),
        np.asarray(corners, dtype=float),
        camera.K,
        camera.D,
        flags=cv2.SOLVEPNP_IPPE_SQUARE,
    )
    poses = []
    for turn, place in zip(turns, places, strict=True):
        if np.all(np.isfinite(turn)) and np.all(np.isfinite(place)) and place[2, 0] > 0.0:
            rotation = Rotation.from_rotvec(turn.ravel()).as_matrix()
            poses.append(transform(place.ravel(), rotation))
    return poses


def whitening(covariance: Array, floor_px: Array | float) -> Array:
    """Returns W with W C W^T = 1 for the error C of the corners of markers, shape (..., 8, 8).

    Args:
        covariance: Random part of the corners' error, shape (..., 8, 8) [px^2].
        floor_px: Part that does not get less with more images, shape (...) [px].
    """
    total = covariance + np.asarray(floor_px)[..., None, None] ** 2 * np.eye(8)
    return np.asarray(np.linalg.inv(np.linalg.cholesky(total)))


def marker_errors(poses: Array, points: Array, pixels: Array, camera: CameraModel) -> Array:
    """Returns how far the corners of markers are from where poses put them.

    Args:
        poses: ``T_camera_object``, shape (b, 4, 4) [m].
        points: In the object, shape (m, 4, 3) [m].
        pixels: shape (m, 4, 2) [px].
        camera: The camera.

    Returns:
        Root mean square distances, shape (b, m) [px].
    """
    seen = _placed(poses, points[None])
    ahead = seen[..., 2].min(axis=-1) > _LEAST_DEPTH_M
    seen[..., 2] = np.maximum(seen[..., 2], _LEAST_DEPTH_M)
    squares = np.sum((project(seen, camera) - pixels) ** 2, axis=-1).mean(axis=-1)
    return np.asarray(np.where(ahead, np.sqrt(squares), _BEHIND_PX))


def refine(
    starts: Array, points: Array, pixels: Array, whiten: Array, camera: CameraModel
) -> Solutions:
    """Weighted least squares of the reprojection by Levenberg-Marquardt, many starts at once.

    Args:
        starts: ``T_camera_object``, shape (b, 4, 4) [m].
        points: Corners of m markers in the object, shape (m, 4, 3), or those of each start, shape
            (b, m, 4, 3) [m].
        pixels: The same with shape (..., 2) [px].
        whiten: `whitening` of the markers, shape (m, 8, 8) or (b, m, 8, 8).
        camera: The camera.

    Returns:
        The local minima. The covariance is ``(J^T J)^-1`` of the whitened residuals; where they
        are larger than chance makes them, it grows with them.
    """
    count = len(starts)
    points, pixels, whiten = (
        np.broadcast_to(item, (count, *item.shape[-3:])) for item in (points, pixels, whiten)
    )
    poses, damping = np.array(starts, dtype=float), np.full(count, _DAMPING)
    residual, jacobian = _linearised(poses, points, pixels, whiten, camera)
    cost = np.einsum("bi,bi->b", residual, residual)
    for _ in range(_ROUNDS):
        step = _step(residual, jacobian, damping)
        moved = _moved(poses, step)
        new_residual, new_jacobian = _linearised(moved, points, pixels, whiten, camera)
        new_cost = np.einsum("bi,bi->b", new_residual, new_residual)
        better = new_cost < cost
        settled = (np.abs(step).max(axis=1) < _SMALLEST_STEP) | (
            better & (cost - new_cost < 1e-7 * cost)
        )
        poses = np.where(better[:, None, None], moved, poses)
        residual = np.where(better[:, None], new_residual, residual)
        jacobian = np.where(better[:, None, None], new_jacobian, jacobian)
        cost = np.where(better, new_cost, cost)
        damping = np.clip(np.where(better, damping * 0.1, damping * 10.0), *_DAMPING_RANGE)
        if settled.all():
            break
    return _solutions(poses, jacobian, cost, points, pixels, camera)


def _solutions(
    poses: Array, jacobian: Array, cost: Array, points: Array, pixels: Array, camera: CameraModel
) -> Solutions:
    free = max(jacobian.shape[1] - 6, 1)
    usual = (_PRIOR_COUNT + cost) / (_PRIOR_COUNT + free)
    growth = np.where(cost > chi2.ppf(_CHANCE, free), cost / free, usual)
    normal = jacobian.swapaxes(1, 2) @ jacobian
    # The ridge keeps a pose invertible of which the pixels tell nothing; it is far below any other.
    ridge = np.einsum("bii->b", normal)[:, None, None] * _RIDGE + _LEAST_SCALE
    covariance = growth[:, None, None] * np.linalg.inv(normal + ridge * np.eye(6))
    seen = _placed(poses, points)
    ahead = seen[..., 2].min(axis=-1) > _LEAST_DEPTH_M
    seen[..., 2] = np.maximum(seen[..., 2], _LEAST_DEPTH_M)
    squares = np.sum((project(seen, camera) - pixels) ** 2, axis=-1).mean(axis=-1)
    errors = np.where(ahead, np.sqrt(squares), _BEHIND_PX)
    return Solutions(poses, covariance, np.sqrt(np.mean(errors**2, axis=1)), errors)


def _step(residual: Array, jacobian: Array, damping: Array) -> Array:
    normal = jacobian.swapaxes(1, 2) @ jacobian
    own = np.einsum("bii->bi", normal)
    # A direction that the pixels hardly tell gets its share of the others' weight.
    diagonal = np.maximum(own, _LEAST_SHARE * own.max(axis=1, keepdims=True) + _LEAST_SCALE)
    damped = normal + (damping[:, None] * diagonal)[:, :, None] * np.eye(6)
    gradient = np.einsum("bij,bi->bj", jacobian, residual)
    return np.asarray(-np.linalg.solve(damped, gradient[..., None])[..., 0])


def _linearised(
    poses: Array, points: Array, pixels: Array, whiten: Array, camera: CameraModel
) -> tuple[Array, Array]:
    """Returns whitened residuals, (b, 8 m), and derivative by (x, y, z, rx, ry, rz), (b, 8 m, 6).

    A pose with a point behind the camera has large residuals and no derivative.
    """
    count, markers = points.shape[:2]
    seen = _placed(poses, points)
    arm = seen - poses[:, None, None, :3, 3]
    ahead = seen[..., 2].min(axis=(1, 2)) > _LEAST_DEPTH_M
    seen[..., 2] = np.maximum(seen[..., 2], _LEAST_DEPTH_M)
    projected, by_point = project_with_derivative(seen, camera)
    by_turn = np.zeros((*arm.shape, 3))
    by_turn[..., 0, 1], by_turn[..., 0, 2], by_turn[..., 1, 2] = (
        arm[..., 2],
        -arm[..., 1],
        arm[..., 0],
    )
    by_turn -= by_turn.swapaxes(-1, -2)
    jacobian = np.concatenate([by_point, by_point @ by_turn], axis=-1)
    jacobian = whiten @ jacobian.reshape(count, markers, 8, 6)
    residual = (whiten @ (projected - pixels).reshape(count, markers, 8, 1)).reshape(count, -1)
    jacobian = np.where(ahead[:, None, None], jacobian.reshape(count, -1, 6), 0.0)
    return np.where(ahead[:, None], residual, _BEHIND_WHITENED), jacobian


def _placed(poses: Array, points: Array) -> Array:
    """Maps corners, (b or 1, m, 4, 3), by poses, (b, 4, 4): shape (b, m, 4, 3)."""
    turned = points @ poses[:, None, :3, :3].swapaxes(-1, -2)
    return np.asarray(turned + poses[:, None, None, :3, 3])


def _moved(poses: Array, step: Array) -> Array:
    result = poses.copy()
    result[:, :3, :3] = Rotation.from_rotvec(step[:, 3:]).as_matrix() @ poses[:, :3, :3]
    result[:, :3, 3] += step[:, :3]
    return result
