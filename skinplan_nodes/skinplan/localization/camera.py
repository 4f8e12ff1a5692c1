"""The camera model: checks, projection and its derivative."""

import cv2
import numpy as np
from numpy.typing import NDArray

from skinplan.errors import ImageInvalidError
from skinplan.localization.model import CameraModel
from skinplan.robot.cell import CameraConfig
from skinplan.transforms import Array

_SAME_RAY = 1e-4
# Counts of coefficients that OpenCV's model takes: plumb_bob has 4 or 5, rational_polynomial 8.
_COEFFICIENTS = (0, 4, 5, 8)


def camera_model(config: CameraConfig) -> CameraModel:
    """Takes the camera's figures from the cell.

    Raises:
        ImageInvalidError: As `require_camera`.
    """
    return require_camera(
        CameraModel(config.width, config.height, np.asarray(config.K), np.asarray(config.D))
    )


def require_camera(camera: CameraModel) -> CameraModel:
    """Returns the camera, or says why it can't be used.

    Raises:
        ImageInvalidError: No size, no focal length, a wrong count of distortion coefficients, or a
            value that is not finite.
    """
    K, D = np.asarray(camera.K, dtype=float), np.asarray(camera.D, dtype=float).ravel()
    if camera.width < 1 or camera.height < 1:
        raise ImageInvalidError(
            f"a camera of {camera.width} x {camera.height} px was given; at least 1 x 1 is accepted"
        )
    if K.shape != (3, 3) or not np.all(np.isfinite(K)) or K[0, 0] <= 0.0 or K[1, 1] <= 0.0:
        raise ImageInvalidError(
            f"a (3, 3) camera matrix with focal lengths above 0 is accepted, found {K.tolist()}"
        )
    if D.size not in _COEFFICIENTS or not np.all(np.isfinite(D)):
        raise ImageInvalidError(
            f"{_COEFFICIENTS} finite distortion coefficients are accepted, found {D.tolist()}"
        )
    return CameraModel(camera.width, camera.height, K, D)


def project(points: Array, camera: CameraModel) -> Array:
    """Projects points in the optical frame to the image.

    Args:
        points: In front of the camera, shape (..., 3) [m].
        camera: The camera.

    Returns:
        shape (..., 2) [px].
    """
    return project_rays(points[..., :2] / points[..., 2:], camera)


def project_rays(rays: Array, camera: CameraModel) -> Array:
    """Projects rays, given on the plane z = 1, shape (..., 2): pixels, shape (..., 2)."""
    bent, _ = _bent(rays, _coefficients(camera), with_derivative=False)
    return np.asarray(bent @ camera.K[:2, :2].T + camera.K[:2, 2])


def ray_derivative(rays: Array, camera: CameraModel) -> Array:
    """Returns the derivative of pixels by rays on the plane z = 1, shape (..., 2, 2) [px]."""
    if not camera.D.any():
        return np.broadcast_to(camera.K[:2, :2], (*rays.shape[:-1], 2, 2))
    _, by_ray = _bent(rays, _coefficients(camera), with_derivative=True)
    return np.asarray(camera.K[:2, :2] @ by_ray)


def _coefficients(camera: CameraModel) -> Array:
    """Returns k1 k2 p1 p2 k3 k4 k5 k6, shape (8,)."""
    full = np.zeros(8)
    full[: len(camera.D)] = camera.D
    return full


def _bent(rays: Array, D: Array, *, with_derivative: bool) -> tuple[Array, Array]:
    """Applies the distortion to rays on the plane z = 1; OpenCV's model.

    Returns:
        shape (..., 2), and the derivative by the ray, shape (..., 2, 2); empty without.
    """
    k1, k2, p1, p2, k3, k4, k5, k6 = D
    x, y = rays[..., 0], rays[..., 1]
    r2 = x * x + y * y
    top = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
    radial = top / below
    bent = np.stack(
        [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ],
        axis=-1,
    )
    if not with_derivative:
        return bent, np.zeros(0)
    slope = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3) - radial * (k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6))
    slope = 2.0 * slope / below
    mixed = x * y * slope + 2.0 * (p1 * x + p2 * y)
    by_ray = np.empty((*rays.shape, 2))
    by_ray[..., 0, 0] = radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    by_ray[..., 1, 1] = radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    by_ray[..., 0, 1] = by_ray[..., 1, 0] = mixed
    return bent, by_ray


def undistorted(pixels: Array, camera: CameraModel) -> Array:
    """Returns where the rays of pixels, shape (n, 2), meet the plane z = 1, shape (n, 2)."""
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-10)
    if len(pixels) == 0:
        return np.zeros((0, 2))
    source = np.ascontiguousarray(pixels, dtype=float).reshape(-1, 1, 2)
    rays = cv2.undistortPoints(source, camera.K, camera.D, criteria=criteria)
    return np.asarray(rays.reshape(-1, 2), dtype=float)


def in_view(points: Array, camera: CameraModel, margin_px: float = 0.0) -> NDArray[np.bool_]:
    """Tells which points are seen in the image.

    Args:
        points: In the optical frame, shape (n, 3) [m].
        camera: The camera.
        margin_px: Least distance from the rim of the image [px].

    Returns:
        shape (n,).
    """
    ahead = points[:, 2] > 1e-6
    rays = points[:, :2] / np.where(ahead, points[:, 2], 1.0)[:, None]
    pixels = project(np.column_stack([rays, np.ones(len(rays))]), camera)
    size = np.array([camera.width, camera.height]) - 1.0
    inside = np.all((pixels >= margin_px) & (pixels <= size - margin_px), axis=1)
    # Far outside, the polynomial of the distortion folds back into the image: the ray of such a
    # pixel is another one.
    found = np.zeros_like(rays)
    found[inside] = undistorted(pixels[inside], camera)
    same = np.linalg.norm(found - rays, axis=1) < _SAME_RAY
    return np.asarray(ahead & inside & same, dtype=bool)
