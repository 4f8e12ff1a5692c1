"""A panel with a row of markers, and a camera on a base in front of it, for the tests."""

import numpy as np

from skinplan.localization.camera import camera_model, in_view, project
from skinplan.localization.judge import exact_detection, observations
from skinplan.localization.model import Sighting
from skinplan.localization.square import square_corners
from skinplan.part.model import Fixture, Marker
from skinplan.robot.cell import CellConfig
from skinplan.transforms import apply, inverse, planar, transform

CELL = CellConfig()
CAMERA = camera_model(CELL.camera)
T_OPTICAL = CELL.camera.T_base_link_optical
# Workpiece x along the map's x, y up, z toward the base.
T_MAP_WORKPIECE = transform((0.0, 0.0, 1.05), [[1, 0, 0], [0, 0, -1], [0, 1, 0]])


def row_fixture(count: int = 8, size_m: float = 0.10, first_id: int = 10) -> Fixture:
    places = (np.arange(count) - 0.5 * (count - 1)) * 0.4
    markers = tuple(
        Marker(first_id + i, size_m, transform((x, 0.0, 0.0))) for i, x in enumerate(places)
    )
    return Fixture("DICT_5X5_100", transform((0.0, -0.5, 0.0)), markers)


def base_facing(x: float, distance: float, angle: float, turn: float = 0.0):
    """Base whose camera looks at (x, 0) from a distance, `angle` beside the normal, `turn` off."""
    heading = angle + turn
    offset = (planar(0.0, 0.0, heading) @ T_OPTICAL)[:3, 3]
    camera = (x + distance * np.sin(angle), -distance * np.cos(angle))
    return planar(camera[0] - offset[0], camera[1] - offset[1], heading)


def camera_pose(T_map_base_link, T_map_workpiece=T_MAP_WORKPIECE):
    """T_camera_workpiece from where the base stands."""
    return inverse(T_map_base_link @ T_OPTICAL) @ T_map_workpiece


def true_corners(T_camera_workpiece, fixture):
    """Ids and corners of all markers that are wholly in the image and seen from the front."""
    ids, corners = [], []
    for marker in fixture.markers:
        pose = T_camera_workpiece @ fixture.T_workpiece_marker(marker.id)
        points = apply(pose, square_corners(marker.size_m))
        if pose[:3, 2] @ pose[:3, 3] < 0 and in_view(points, CAMERA, 4.0).all():
            ids.append(marker.id)
            corners.append(project(points, CAMERA))
    return np.array(ids, dtype=np.int64), np.array(corners).reshape(-1, 4, 2)


def observed(T_camera_workpiece, fixture, random=None, noise_px=0.0, only=None):
    """What is seen by projected corners with noise, which the solver knows, without an image."""
    ids, corners = true_corners(T_camera_workpiece, fixture)
    if only is not None:
        keep = np.isin(ids, only)
        ids, corners = ids[keep], corners[keep]
    if random is not None:
        corners = corners + random.normal(0.0, noise_px, corners.shape)
    found = exact_detection(ids, corners, noise_px or 0.02)
    return Sighting(observations(found, CAMERA, fixture, CELL.quality))
