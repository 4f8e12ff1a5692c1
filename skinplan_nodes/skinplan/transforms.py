"""Rigid transforms as 4x4 arrays.

``T_a_b`` maps coordinates in b to coordinates in a: ``p_a = T_a_b @ p_b`` and ``T_a_c = T_a_b @
T_b_c``. Quaternions are ``(x, y, z, w)``, as in ROS messages.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from skinplan.errors import InputError

Array = NDArray[np.float64]


def transform(translation: ArrayLike = (0.0, 0.0, 0.0), rotation: ArrayLike | None = None) -> Array:
    """Builds a rigid transform.

    Args:
        translation: shape (3,) [m].
        rotation: shape (3, 3) rotation matrix or (4,) quaternion (x, y, z, w); None = identity.

    Returns:
        Transform, shape (4, 4).

    Raises:
        InputError: A shape is wrong, a value is not finite, or the quaternion has no length.
    """
    result = np.eye(4)
    result[:3, 3] = _checked(translation, (3,), "translation")
    if rotation is None:
        return result
    turn = np.asarray(rotation, dtype=float)
    if turn.shape == (4,):
        turn = _checked(turn, (4,), "quaternion")
        if np.linalg.norm(turn) < 1e-9:
            raise InputError(
                "a rotation was asked from a quaternion of length 0; a unit quaternion is accepted"
            )
        result[:3, :3] = Rotation.from_quat(turn).as_matrix()
    else:
        result[:3, :3] = _checked(turn, (3, 3), "rotation matrix")
    return result


def inverse(T_a_b: Array) -> Array:
    """Returns ``T_b_a``, shape (..., 4, 4), of rigid transforms ``T_a_b``, shape (..., 4, 4)."""
    rotation = np.swapaxes(T_a_b[..., :3, :3], -1, -2)
    result = np.zeros_like(T_a_b)
    result[..., :3, :3] = rotation
    result[..., :3, 3] = -np.einsum("...ij,...j->...i", rotation, T_a_b[..., :3, 3])
    result[..., 3, 3] = 1.0
    return result


def apply(T_a_b: Array, points_b: Array) -> Array:
    """Maps points, shape (n, 3) [m], from frame b to frame a."""
    return points_b @ T_a_b[:3, :3].T + T_a_b[:3, 3]


def rotate(T_a_b: Array, vectors_b: Array) -> Array:
    """Maps directions, shape (n, 3), from frame b to frame a."""
    return vectors_b @ T_a_b[:3, :3].T


def quaternion(T_a_b: Array) -> Array:
    """Returns the rotation of a transform as quaternion (x, y, z, w) with w >= 0, shape (4,)."""
    found = Rotation.from_matrix(T_a_b[:3, :3]).as_quat()
    return -found if found[3] < 0 else found


def planar(x_m: float, y_m: float, heading_rad: float) -> Array:
    """Returns the transform of a pose on the floor: (x, y) [m] and heading about z [rad]."""
    return transform((x_m, y_m, 0.0), Rotation.from_euler("z", heading_rad).as_matrix())


def heading(T_a_b: Array) -> float:
    """Returns the angle about z [rad] of frame b in frame a, in (-pi, pi]."""
    return float(np.arctan2(T_a_b[1, 0], T_a_b[0, 0]))


def difference(T_a_b: Array, T_a_c: Array) -> tuple[float, float]:
    """Returns distance [m] and angle [rad] between two frames."""
    delta = inverse(T_a_b) @ T_a_c
    angle = Rotation.from_matrix(delta[:3, :3]).magnitude()
    return float(np.linalg.norm(delta[:3, 3])), float(angle)


def require_transform(T_a_b: ArrayLike, name: str) -> Array:
    """Returns the argument as (4, 4) array, or says why it is no rigid transform.

    Raises:
        InputError: Shape, a value that is not finite, or a rotation that is none.
    """
    checked = _checked(T_a_b, (4, 4), name)
    rotation = checked[:3, :3]
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) or np.linalg.det(rotation) < 0:
        raise InputError(
            f"{name}: a rigid transform is accepted, but its rotation part is not orthonormal"
        )
    return checked


def _checked(values: ArrayLike, shape: tuple[int, ...], name: str) -> Array:
    array = np.asarray(values, dtype=float)
    if array.shape != shape:
        raise InputError(f"{name}: shape {shape} is accepted, found {array.shape}")
    if not np.all(np.isfinite(array)):
        raise InputError(f"{name}: finite numbers are accepted, found {array.tolist()}")
    return array
