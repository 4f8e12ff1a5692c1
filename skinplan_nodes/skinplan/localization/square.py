"""The two poses that explain the image of a square (M1.2).

Collins and Bartoli, "Infinitesimal Plane-Based Pose Estimation", 2014: the derivative of the
homography in the middle of the square tells its turn but for one sign, that of its slant. OpenCV's
own passes through a rotation vector that is lost at half a turn: a camera that stands level before
an upright marker.
"""

import numpy as np

from skinplan.localization.camera import undistorted
from skinplan.localization.model import CameraModel
from skinplan.transforms import Array

# Signs of the corners' x and y, in the order of `square_corners`.
_SIGNS = np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])
# A square of less than this area on the plane z = 1 tells no pose; a tenth of a pixel is more.
_LEAST_AREA = 1e-9


def square_corners(size_m: float) -> Array:
    """Returns top left, top right, bottom right, bottom left of a marker, shape (4, 3) [m]."""
    return np.column_stack([0.5 * size_m * _SIGNS, np.zeros(4)])


def square_solutions(corners: Array, sizes_m: Array, camera: CameraModel) -> Array:
    """Returns the two poses that explain the image of each square.

    Args:
        corners: In the order of `square_corners`, shape (m, 4, 2) [px].
        sizes_m: Sides of the squares, shape (m,) [m].
        camera: The camera.

    Returns:
        ``T_camera_marker``, shape (m, 2, 4, 4) [m], in no order; NaN where the corners are
        degenerate. The two are one where the square faces the camera.
    """
    rays = undistorted(corners.reshape(-1, 2), camera).reshape(-1, 4, 2)
    half = 0.5 * np.asarray(sizes_m, dtype=float)
    with np.errstate(divide="ignore", invalid="ignore"):
        middle, slope = _middle(rays)
        turns = _turns(middle, slope / half[:, None, None])
        places = _places(turns, rays, half)
    poses = np.tile(np.eye(4), (len(rays), 2, 1, 1))
    poses[..., :3, :3], poses[..., :3, 3] = turns, places
    good = np.isfinite(poses).all(axis=(2, 3)) & (places[..., 2] > 0.0)
    return np.where(good[..., None, None], poses, np.nan)


def _middle(rays: Array) -> tuple[Array, Array]:
    """Returns where the middle of squares is seen, (m, 2), and its derivative, (m, 2, 2).

    By place on the square, of which a half side counts 1. The homography of (-1, 1), (1, 1),
    (1, -1), (-1, -1) has a closed form, as that of the unit square has.
    """
    a, b, c, d = (rays[:, k] for k in range(4))
    bend, right, low = a - b + c - d, b - c, d - c
    area = right[:, 0] * low[:, 1] - right[:, 1] * low[:, 0]
    area = np.where(np.abs(area) < _LEAST_AREA, np.nan, area)
    g = (bend[:, 0] * low[:, 1] - bend[:, 1] * low[:, 0]) / area
    h = (right[:, 0] * bend[:, 1] - right[:, 1] * bend[:, 0]) / area
    # From the unit square, x to the right and y downwards: (a + along x + down y) / (1 + g x + h y)
    along, down = b - a + g[:, None] * b, d - a + h[:, None] * d
    depth = (1.0 + 0.5 * (g + h))[:, None]
    middle = (a + 0.5 * (along + down)) / depth
    by_x = 0.5 * (along - g[:, None] * middle) / depth
    by_y = -0.5 * (down - h[:, None] * middle) / depth
    return middle, np.stack([by_x, by_y], axis=-1)


def _turns(middle: Array, slope: Array) -> Array:
    """Returns the two turns of planes, shape (m, 2, 3, 3), by `_middle` per metre."""
    facing = _facing(middle)
    across = facing[:, :2, :2] - middle[:, :, None] * facing[:, 2:, :2]
    seen = _inverse(across) @ slope
    a, b = np.einsum("mij,mij->mi", seen, seen).T, np.einsum("mi,mi->m", seen[:, 0], seen[:, 1])
    # The larger singular value is that of the direction that is not foreshortened.
    largest = np.sqrt(0.5 * (a[0] + a[1] + np.sqrt((a[0] - a[1]) ** 2 + 4.0 * b * b)))
    columns = np.empty((len(middle), 2, 3, 3))
    columns[:, :, :2, :2] = (seen / largest[:, None, None])[:, None]
    x, y = columns[:, 0, :2, 0], columns[:, 0, :2, 1]
    # What the columns lack to length 1, and to a right angle between them.
    lower_x = np.sqrt(np.maximum(1.0 - np.einsum("mi,mi->m", x, x), 0.0))
    lower_y = np.sqrt(np.maximum(1.0 - np.einsum("mi,mi->m", y, y), 0.0))
    lower_y *= np.where(np.einsum("mi,mi->m", x, y) > 0.0, -1.0, 1.0)
    columns[:, 0, 2, 0], columns[:, 0, 2, 1] = lower_x, lower_y
    columns[:, 1, 2, 0], columns[:, 1, 2, 1] = -lower_x, -lower_y
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        columns[..., i, 2] = (
            columns[..., j, 0] * columns[..., k, 1] - columns[..., k, 0] * columns[..., j, 1]
        )
    return np.asarray(facing[:, None] @ columns)


def _inverse(square: Array) -> Array:
    """Inverts matrices, shape (m, 2, 2); infinite or NaN where there is no inverse."""
    a, b, c, d = square[:, 0, 0], square[:, 0, 1], square[:, 1, 0], square[:, 1, 1]
    adjoint = np.stack([d, -b, -c, a], axis=-1).reshape(-1, 2, 2)
    return np.asarray(adjoint / (a * d - b * c)[:, None, None])


def _facing(middle: Array) -> Array:
    """Returns turns, (m, 3, 3), that carry z to the rays of pixels, (m, 2), the shortest way."""
    x, y = middle[:, 0], middle[:, 1]
    length = np.sqrt(1.0 + x * x + y * y)
    sine_x, sine_y, cosine = x / length, y / length, 1.0 / length
    share = 1.0 / (1.0 + cosine)
    turn = np.empty((len(middle), 3, 3))
    turn[:, 0, 0], turn[:, 1, 1] = 1.0 - share * sine_x**2, 1.0 - share * sine_y**2
    turn[:, 0, 1] = turn[:, 1, 0] = -share * sine_x * sine_y
    turn[:, 0, 2], turn[:, 2, 0] = sine_x, -sine_x
    turn[:, 1, 2], turn[:, 2, 1] = sine_y, -sine_y
    turn[:, 2, 2] = cosine
    return turn


def _places(turns: Array, rays: Array, half: Array) -> Array:
    """Returns where squares of known turns are, shape (m, 2, 3): least squares of their rays."""
    flat = half[:, None, None] * _SIGNS
    points = np.einsum("mkij,mcj->mkci", turns[..., :2], flat)
    u, v = rays[:, None, :, 0], rays[:, None, :, 1]
    # Rows (1, 0, -u) and (0, 1, -v) times the place are the right side for each corner.
    side_u, side_v = u * points[..., 2] - points[..., 0], v * points[..., 2] - points[..., 1]
    sum_u, sum_v, squares = u.sum(axis=-1), v.sum(axis=-1), (u * u + v * v).sum(axis=-1)
    x, y, z = side_u.sum(axis=-1), side_v.sum(axis=-1), (u * side_u + v * side_v).sum(axis=-1)
    depth = 0.25 * (sum_u * x + sum_v * y) - z
    depth /= squares - 0.25 * (sum_u**2 + sum_v**2)
    return np.stack([0.25 * (x + sum_u * depth), 0.25 * (y + sum_v * depth), depth], axis=-1)
