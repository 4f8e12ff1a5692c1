"""Pose from points and their pixels by least squares, many starts at once."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.stats import chi2

from skinplan.localization.camera import project, ray_derivative, undistorted
from skinplan.localization.model import CameraModel
from skinplan.transforms import Array

_ROUNDS = 25
_DAMPING = 1e-4
_SMALLEST_STEP = 1e-9
# Share of the cost that another round has to take off.
_SMALLEST_GAIN = 1e-6
# Keeps the equations solvable where nothing can be derived.
_LEAST_SCALE = 1e-9
_LEAST_SHARE = 1e-6
_RIDGE = 1e-14
_DAMPING_RANGE = (1e-9, 1e12)
# What a point behind the camera counts as [px].
_BEHIND_PX = 1e4
_BEHIND_COST = 1e15
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


def turned_by(pose: Array, others: Array) -> Array:
    """Returns the angles between a pose, (4, 4), and others, (..., 4, 4): shape (...) [rad]."""
    apart = np.sum((others[..., :3, :3] - pose[:3, :3]) ** 2, axis=(-2, -1))
    return np.asarray(2.0 * np.arcsin(np.minimum(np.sqrt(apart / 8.0), 1.0)))


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
    rays, whiten = _in_rays(pixels, whiten, camera)
    count = len(starts)
    points, rays, pixels, whiten = (
        np.broadcast_to(item, (count, *item.shape[-3:])) for item in (points, rays, pixels, whiten)
    )
    poses, damping = np.array(starts, dtype=float), np.full(count, _DAMPING)
    squares = _squares(poses, points, rays, whiten)
    for _ in range(_ROUNDS):
        step = _step(squares, damping)
        # What the step will take off, to first order.
        gain = -np.einsum("bi,bi->b", squares[:, :6, 6], step)
        if np.all(gain < _SMALLEST_GAIN * squares[:, 6, 6]):
            break
        moved = _moved(poses, step)
        new = _squares(moved, points, rays, whiten)
        cost, new_cost = squares[:, 6, 6], new[:, 6, 6]
        better = new_cost < cost
        settled = (np.abs(step).max(axis=1) < _SMALLEST_STEP) | (
            better & (cost - new_cost < _SMALLEST_GAIN * cost)
        )
        poses = np.where(better[:, None, None], moved, poses)
        squares = np.where(better[:, None, None], new, squares)
        damping = np.clip(np.where(better, damping * 0.1, damping * 10.0), *_DAMPING_RANGE)
        if settled.all():
            break
    return _solutions(poses, squares, points, pixels, camera)


def _in_rays(pixels: Array, whiten: Array, camera: CameraModel) -> tuple[Array, Array]:
    """Takes the distortion away: rays on the plane z = 1, and W of them instead of the pixels.

    The steps are then those of a camera without distortion. Over the few pixels of a residual the
    derivative of the distortion does not change.
    """
    rays = undistorted(pixels.reshape(-1, 2), camera).reshape(pixels.shape)
    slope = ray_derivative(rays, camera)
    blocks = whiten.reshape(*whiten.shape[:-1], 4, 1, 2) @ slope[..., None, :, :, :]
    return rays, np.asarray(blocks.reshape(whiten.shape))


def _solutions(
    poses: Array, squares: Array, points: Array, pixels: Array, camera: CameraModel
) -> Solutions:
    free = max(8 * points.shape[1] - 6, 1)
    normal, cost = squares[:, :6, :6], squares[:, 6, 6]
    usual = (_PRIOR_COUNT + cost) / (_PRIOR_COUNT + free)
    growth = np.where(cost > largest_by_chance(free), cost / free, usual)
    # The ridge keeps a pose invertible of which the pixels tell nothing; it is far below any other.
    ridge = np.einsum("bii->b", normal)[:, None, None] * _RIDGE + _LEAST_SCALE
    covariance = growth[:, None, None] * np.linalg.inv(normal + ridge * np.eye(6))
    seen = _placed(poses, points)
    ahead = seen[..., 2].min(axis=-1) > _LEAST_DEPTH_M
    seen[..., 2] = np.maximum(seen[..., 2], _LEAST_DEPTH_M)
    apart = np.sum((project(seen, camera) - pixels) ** 2, axis=-1).mean(axis=-1)
    errors = np.where(ahead, np.sqrt(apart), _BEHIND_PX)
    return Solutions(poses, covariance, np.sqrt(np.mean(errors**2, axis=1)), errors)


@lru_cache(maxsize=256)
def largest_by_chance(free: int) -> float:
    """Returns the sum of squared normalised residuals that chance exceeds once in a thousand."""
    return float(chi2.ppf(_CHANCE, free))


def _step(squares: Array, damping: Array) -> Array:
    normal = squares[:, :6, :6]
    own = np.einsum("bii->bi", normal)
    # A direction that the pixels hardly tell gets its share of the others' weight.
    diagonal = np.maximum(own, _LEAST_SHARE * own.max(axis=1, keepdims=True) + _LEAST_SCALE)
    damped = normal + (damping[:, None] * diagonal)[:, :, None] * np.eye(6)
    return np.asarray(-np.linalg.solve(damped, squares[:, :6, 6:])[..., 0])


def _squares(poses: Array, points: Array, rays: Array, whiten: Array) -> Array:
    """Returns G^T G of the whitened G = [J r], shape (b, 7, 7).

    J is the derivative by (x, y, z, rx, ry, rz), r the residual: the normal equations, their
    gradient and the cost in one product. A pose with a point behind the camera has a large cost and
    no derivative.
    """
    count, markers = points.shape[:2]
    arm = points @ poses[:, None, :3, :3].swapaxes(-1, -2)
    seen = arm + poses[:, None, None, :3, 3]
    ahead = seen[..., 2].min(axis=(1, 2)) > _LEAST_DEPTH_M
    per_depth = 1.0 / np.maximum(seen[..., 2], _LEAST_DEPTH_M)
    u, v = seen[..., 0] * per_depth, seen[..., 1] * per_depth
    x, y, z = (arm[..., k] * per_depth for k in range(3))
    G = np.zeros((count, markers, 4, 2, 7))
    G[..., 0, 0] = G[..., 1, 1] = per_depth
    G[..., 0, 2], G[..., 1, 2] = -u * per_depth, -v * per_depth
    # A turn w moves a point by w x arm; its row is arm x (row of the point).
    G[..., 0, 3], G[..., 0, 4], G[..., 0, 5] = -y * u, z + x * u, -y
    G[..., 1, 3], G[..., 1, 4], G[..., 1, 5] = -z - y * v, x * v, x
    G[..., 0, 6], G[..., 1, 6] = u - rays[..., 0], v - rays[..., 1]
    white = (whiten @ G.reshape(count, markers, 8, 7)).reshape(count, -1, 7)
    squares = white.swapaxes(1, 2) @ white
    if not ahead.all():
        squares[~ahead] = 0.0
        squares[~ahead, 6, 6] = _BEHIND_COST
    return np.asarray(squares)


def _placed(poses: Array, points: Array) -> Array:
    """Maps corners, (b or 1, m, 4, 3), by poses, (b, 4, 4): shape (b, m, 4, 3)."""
    turned = points @ poses[:, None, :3, :3].swapaxes(-1, -2)
    return np.asarray(turned + poses[:, None, None, :3, 3])


def _moved(poses: Array, step: Array) -> Array:
    result = poses.copy()
    result[:, :3, :3] = _turns(step[:, 3:]) @ poses[:, :3, :3]
    result[:, :3, 3] += step[:, :3]
    return result


def _turns(vectors: Array) -> Array:
    """Rotation matrices of steps, (b, 3): shape (b, 3, 3); to first order their rotation vectors.

    Cayley's form with the half step h: 1 + 2 (H + H H) / (1 + h h), H the cross product with h.
    """
    half = 0.5 * vectors
    cross = np.zeros((len(vectors), 3, 3))
    cross[:, 2, 1], cross[:, 0, 2], cross[:, 1, 0] = half.T
    cross -= cross.swapaxes(1, 2)
    share = 2.0 / (1.0 + np.einsum("bi,bi->b", half, half))
    return np.asarray(np.eye(3) + share[:, None, None] * (cross + cross @ cross))
