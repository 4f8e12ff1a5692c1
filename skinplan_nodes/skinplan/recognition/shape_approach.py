"""Where the base drives when a pose by the shape is not good enough: as before a marker.

The side of the part that the camera sees stands for the marker: the approach of
`skinplan.localization.approach` faces it, comes nearer by half of what is left, keeps the safe
distance, and keeps the middle of the part in the image.
"""

import numpy as np

from skinplan.errors import QualityNotReachedError
from skinplan.localization.approach import Approach, next_goal
from skinplan.localization.model import CameraModel, WorkpiecePose
from skinplan.mesh.model import SurfaceMesh
from skinplan.part.model import Fixture, Marker
from skinplan.robot.cell import CellConfig
from skinplan.transforms import Array, inverse, transform

_LEAST_SIDE_M = 0.05


def nearer(
    T_map_base_link: Array,
    T_camera_workpiece: Array,
    mesh: SurfaceMesh,
    camera: CameraModel,
    cell: CellConfig,
) -> Approach | None:
    """Plans the next step nearer to a part.

    Args:
        T_map_base_link: Where the base believes to stand, shape (4, 4) [m].
        T_camera_workpiece: Where the part is, shape (4, 4) [m].
        mesh: The part.
        camera: The camera.
        cell: Camera mounting, safe distance, stopping error of the base.

    Returns:
        The goal; None when the base may come no nearer.

    Raises:
        QualityNotReachedError: The side that is seen lies so flat that a level camera can't face
            it.
    """
    eye = inverse(T_camera_workpiece)[:3, 3]
    T_workpiece_plate, side_m = _plate(mesh, eye)
    normal = T_workpiece_plate[:3, 2]
    distance = float((eye - T_workpiece_plate[:3, 3]) @ normal)
    plate = Fixture("", np.eye(4), (Marker(0, side_m, T_workpiece_plate),))
    pose = WorkpiecePose(
        T_camera_workpiece=T_camera_workpiece,
        covariance=np.zeros((6, 6)),
        reprojection_error_px=0.0,
        quality=0.0,
        distance_m=distance,
        angle_rad=0.0,
        marker_ids=np.zeros(1, dtype=np.int64),
    )
    try:
        return next_goal(T_map_base_link, pose, plate, camera, cell)
    except QualityNotReachedError as error:
        raise QualityNotReachedError(
            "the side of the part that is seen lies flat; one that a level camera can face is "
            "accepted for an approach"
        ) from error


def _plate(mesh: SurfaceMesh, eye: Array) -> tuple[Array, float]:
    """Returns a square before the side that is seen, ``T_workpiece_plate``, and its side [m]."""
    ways = eye - mesh.corners.mean(axis=1)
    areas = 0.5 * np.linalg.norm(
        np.cross(mesh.corners[:, 1] - mesh.corners[:, 0], mesh.corners[:, 2] - mesh.corners[:, 0]),
        axis=1,
    )
    seen = np.einsum("ij,ij->i", mesh.face_normals, ways) > 0.0
    z = (areas[seen, None] * mesh.face_normals[seen]).sum(axis=0)
    z /= np.linalg.norm(z)
    x = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    axes = np.stack([x, np.cross(z, x), z], axis=1)
    local = mesh.vertices @ axes
    low, high = local.min(axis=0), local.max(axis=0)
    front = np.array([*(0.5 * (low + high))[:2], high[2]])
    side_m = max(_LEAST_SIDE_M, float(np.min((high - low)[:2])))
    return transform(axes @ front, axes), side_m
