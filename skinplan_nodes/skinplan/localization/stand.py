"""What the camera will see of the markers from where the base is to stand (M1.2).

The approach asks it of its next goal, the stations of all their candidates.
"""

import numpy as np
from numpy.typing import NDArray

from skinplan.localization.camera import in_view
from skinplan.localization.model import CameraModel
from skinplan.localization.quality import angles_and_distances, marker_qualities
from skinplan.localization.square import square_corners
from skinplan.part.model import Fixture
from skinplan.robot.cell import CellConfig
from skinplan.transforms import Array, apply, inverse, planar

# Rim of the image that no wanted marker may touch [px].
_RIM_PX = 10.0
_ENOUGH_MARKERS = 2
# A marker is expected only when it is seen large enough and not too obliquely.
_LEAST_COSINE = 0.35
_LEAST_SIDE_PX = 28.0


def predicted_quality(
    poses: Array,
    T_map_workpiece: Array,
    fixture: Fixture,
    camera: CameraModel,
    cell: CellConfig,
    miss_m: float,
) -> Array:
    """Predicts the E of eq (3) that a localisation finds from places of the base.

    It is that of the best marker, as of a pose that is found. What stands between camera and
    markers is not asked.

    Args:
        poses: ``T_map_base_link``, shape (c, 4, 4) [m].
        T_map_workpiece: Part in the shop, shape (4, 4) [m].
        fixture: The markers.
        camera: The camera.
        cell: Camera mounting, figures of eq (3), stopping error of the base.
        miss_m: The camera may be so far from where it was sent, to either side [m].

    Returns:
        E; 0 where too few markers would be in the image, facing it and large enough, shape (c,).
    """
    sizes = np.array([marker.size_m for marker in fixture.markers])
    placed = marker_frames(T_map_workpiece, fixture)
    optical = inverse(poses @ cell.camera.T_base_link_optical)
    frames = optical[:, None] @ placed
    clear = clearly_seen(frames, sizes, camera)
    seen = clear & inside(marker_corners(frames, sizes), camera, _RIM_PX)
    corners = marker_corners(placed, sizes)
    enough = enough_in_image(poses, corners, miss_m, camera, cell, clear)
    quality = marker_qualities(*angles_and_distances(frames), cell.quality)
    best = np.where(seen, quality, 0.0).max(axis=1, initial=0.0)
    return np.where(enough, best, 0.0)


def marker_frames(T_a_workpiece: Array, fixture: Fixture) -> Array:
    """Returns ``T_a_marker`` of all markers, shape (m, 4, 4) [m]."""
    frames = [fixture.T_workpiece_marker(marker.id) for marker in fixture.markers]
    return np.asarray(T_a_workpiece @ np.array(frames).reshape(-1, 4, 4))


def marker_corners(T_a_marker: Array, sizes_m: Array) -> Array:
    """Returns the corners of markers.

    Args:
        T_a_marker: shape (..., m, 4, 4) [m].
        sizes_m: Sides of the squares, shape (m,) [m].

    Returns:
        shape (..., m, 4, 3) [m].
    """
    squares = np.array([square_corners(size) for size in sizes_m]).reshape(-1, 4, 3)
    turned = squares @ np.swapaxes(T_a_marker[..., :3, :3], -1, -2)
    return np.asarray(turned + T_a_marker[..., None, :3, 3])


def clearly_seen(T_camera_marker: Array, sizes_m: Array, camera: CameraModel) -> NDArray[np.bool_]:
    """Tells which markers face the camera and appear large enough, in the image or beside it.

    Args:
        T_camera_marker: shape (..., m, 4, 4) [m].
        sizes_m: Sides of the squares, shape (m,) [m].
        camera: The camera.

    Returns:
        shape (..., m).
    """
    places = T_camera_marker[..., :3, 3]
    away = np.maximum(np.linalg.norm(places, axis=-1), 1e-9)
    cosine = -np.einsum("...i,...i->...", T_camera_marker[..., :3, 2], places) / away
    side = sizes_m * cosine / np.maximum(places[..., 2], 1e-9) * camera.K[0, 0]
    near = (cosine >= _LEAST_COSINE) & (side >= _LEAST_SIDE_PX)
    return np.asarray((places[..., 2] > 0.0) & near)


def inside(corners: Array, camera: CameraModel, rim_px: float) -> NDArray[np.bool_]:
    """Tells which markers are wholly in the image.

    Args:
        corners: In the optical frame, shape (..., 4, 3) [m].
        camera: The camera.
        rim_px: Least distance from the rim of the image [px].

    Returns:
        shape (...).
    """
    seen = in_view(corners.reshape(-1, 3), camera, rim_px)
    return np.asarray(seen.reshape(corners.shape[:-1]).all(axis=-1))


def enough_in_image(
    poses: Array,
    corners: Array,
    miss_m: float,
    camera: CameraModel,
    cell: CellConfig,
    counted: NDArray[np.bool_] | None = None,
) -> NDArray[np.bool_]:
    """Tells whether enough markers stay in the image when the base stops beside its goal.

    Enough are two, or the one there is.

    Args:
        poses: ``T_map_base_link``, shape (c, 4, 4) [m].
        corners: Of the markers in map, shape (m, 4, 3) [m].
        miss_m: The base stops so far from its goal, forward or backward [m].
        camera: The camera.
        cell: Camera mounting, heading error of the base.
        counted: Which markers count from where, shape (c, m); None = all.

    Returns:
        shape (c,).
    """
    enough = min(_ENOUGH_MARKERS, len(corners))
    turn = 2.0 * cell.base_error_rad
    result = np.ones(len(poses), dtype=bool)
    for side, angle in ((-1.0, -turn), (-1.0, turn), (1.0, -turn), (1.0, turn)):
        stopped = poses @ planar(side * miss_m, 0.0, angle)
        optical = inverse(stopped @ cell.camera.T_base_link_optical)
        seen_from = np.array([apply(T, corners.reshape(-1, 3)) for T in optical])
        seen = inside(seen_from.reshape(-1, len(corners), 4, 3), camera, _RIM_PX)
        if counted is not None:
            seen &= counted
        result &= seen.sum(axis=1) >= enough
    return result
