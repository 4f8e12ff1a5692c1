"""The camera model: checks, projection and its derivative."""

import cv2
import numpy as np
from numpy.typing import NDArray

from skinplan.errors import ImageInvalidError
from skinplan.localization.model import CameraModel
from skinplan.robot.cell import CameraConfig
from skinplan.transforms import Array

_ZERO = np.zeros(3)
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
    """Projects points in the optical frame, shape (n, 3) [m], to the image, shape (n, 2) [px]."""
    pixels, _ = cv2.projectPoints(points, _ZERO, _ZERO, camera.K, camera.D)
    return np.asarray(pixels.reshape(-1, 2), dtype=float)


def project_with_derivative(points: Array, camera: CameraModel) -> tuple[Array, Array]:
    """Projects points in the optical frame.

    Args:
        points: shape (n, 3) [m].
        camera: The camera.

    Returns:
        Pixels, shape (n, 2), and their derivative by the point, shape (n, 2, 3) [px/m].
    """
    pixels, derivative = cv2.projectPoints(points, _ZERO, _ZERO, camera.K, camera.D)
    by_point = derivative[:, 3:6].reshape(-1, 2, 3)
    return np.asarray(pixels.reshape(-1, 2), dtype=float), np.asarray(by_point, dtype=float)


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
