"""The next pose of the base while the marker view is not good enough (M1.2, approach-retry loop).

The paper turns the base until the view is fronto-parallel and then drives toward the marker. A base
with differential drive loses the marker when it turns on the spot, so both steps are goals for a
navigator: poses whose optical axis is the normal of the marker plane through the markers seen.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import QualityNotReachedError
from skinplan.localization.model import CameraModel, WorkpiecePose
from skinplan.localization.stand import enough_in_image, marker_corners, marker_frames
from skinplan.localization.way import plan_way
from skinplan.part.model import Fixture
from skinplan.robot.cell import CellConfig
from skinplan.transforms import Array, heading, planar, rotate

# Views turned farther than this from the normal, beyond what the base misses by, are faced first.
FACING_RAD = float(np.radians(3.0))
# An advance shorter than this is not worth a drive.
LEAST_ADVANCE_M = 0.02
# Plates that lie flatter than this can't be faced by a camera that looks level.
_LEAST_LEVEL_NORMAL = 0.3
# The camera steps back by this until enough markers are in the image [m].
_STEP_BACK_M = 0.05


@dataclass(frozen=True, eq=False)
class Approach:
    """Where the base has to drive next.

    Attributes:
        phase: ``turning`` (face the marker at the same distance) or ``advancing``.
        T_map_base_link: Goal on the floor, shape (4, 4) [m].
        distance_m: Distance of the camera from the marker plane at the goal [m].
        stops: Poses to drive to one after the other; the last is the goal.
        clearance_m: Least distance of the camera from the marker plane on the way, when the base
            stops where it was sent [m].
    """

    phase: str
    T_map_base_link: Array
    distance_m: float
    stops: tuple[Array, ...]
    clearance_m: float


def next_goal(
    T_map_base_link: Array,
    pose: WorkpiecePose,
    fixture: Fixture,
    camera: CameraModel,
    cell: CellConfig,
) -> Approach | None:
    """Plans the next step of the approach.

    The view is faced first if it is oblique; then the camera comes nearer by (d - d_min) / 2. The
    goal keeps so far away that the camera comes nowhere on the way nearer than d_min, with the
    stopping errors of the base at both ends, and that at least two markers (or the one there is)
    stay in the image for every such error.

    Args:
        T_map_base_link: Where the base believes to stand, shape (4, 4) [m].
        pose: The pose just found from there.
        fixture: The markers.
        camera: The camera.
        cell: Camera mounting, figures of eq (3), stopping error of the base.

    Returns:
        The goal, or None when the safe distance is reached: the view is faced, or no way to a
        better one keeps the distance.

    Raises:
        QualityNotReachedError: The markers lie so flat that a level camera can't face them.
    """
    T_map_optical = T_map_base_link @ cell.camera.T_base_link_optical
    target, normal, turned = _faced(T_map_optical, pose, fixture)
    distance = pose.distance_m
    lever = float(np.linalg.norm(cell.camera.T_base_link_optical[:2, 3]))
    facing = turned > FACING_RAD + 2.0 * cell.base_error_rad
    wanted = distance if facing else distance - 0.5 * (distance - cell.quality.distance_min_m)
    drive = float(np.linalg.norm(T_map_optical[:2, 3] - target[:2] - distance * normal[:2]))
    miss = stop_miss_m(cell, drive + distance - wanted + lever)
    wanted = max(wanted, cell.quality.distance_min_m + miss)
    markers = _plates(T_map_optical @ pose.T_camera_workpiece, fixture, pose.marker_ids)
    farthest = max(distance, float(np.linalg.norm(T_map_optical[:2, 3] - target[:2])), wanted)
    while wanted <= farthest + _STEP_BACK_M:
        goal = _pose_before(target, normal, wanted, cell)
        way = plan_way(T_map_base_link, goal, heading(goal), target, normal, cell)
        reach = max(float(np.linalg.norm(s[:2, 3] - T_map_base_link[:2, 3])) for s in way.stops)
        least = cell.quality.distance_min_m + stop_miss_m(cell, reach + lever)
        safe = way.clearance_m >= least
        if safe and enough_in_image(goal[None], markers, miss, camera, cell)[0]:
            break
        wanted += _STEP_BACK_M
    if not safe or (not facing and distance - wanted < LEAST_ADVANCE_M):
        return None
    phase = "turning" if facing else "advancing"
    return Approach(phase, goal, wanted, way.stops, way.clearance_m)


def stop_miss_m(cell: CellConfig, drive_m: float) -> float:
    """Returns how far the camera can be from where it was sent, seen from the part [m].

    The base misses by its stopping error at both ends of the drive: at the end beside the goal, at
    the start because the goal was planned from a place that is itself beside the believed one.

    Args:
        cell: Stopping error of the base.
        drive_m: Length of the drive and the camera's lever on the base, which an error of the
            heading acts on [m].
    """
    return 2.0 * cell.base_error_m + 2.0 * cell.base_error_rad * drive_m


def _faced(
    T_map_optical: Array, pose: WorkpiecePose, fixture: Fixture
) -> tuple[Array, Array, float]:
    """Looks at the markers seen from above.

    Returns:
        Their centre and their level normal in map, shape (3,) each, and the angle between that
        normal and the optical axis [rad].
    """
    T_map_workpiece = T_map_optical @ pose.T_camera_workpiece
    frames = [T_map_workpiece @ fixture.T_workpiece_marker(int(i)) for i in pose.marker_ids]
    target = np.mean([frame[:3, 3] for frame in frames], axis=0)
    normal = np.mean([frame[:3, 2] for frame in frames], axis=0) * [1.0, 1.0, 0.0]
    length = float(np.linalg.norm(normal))
    if length < _LEAST_LEVEL_NORMAL:
        raise QualityNotReachedError(
            f"markers {pose.marker_ids.tolist()} lie flat (level part of normal {length:.2f});"
            f" at least {_LEAST_LEVEL_NORMAL} is accepted to face them with a camera on a base"
        )
    normal = normal / length
    axis = rotate(T_map_optical, np.array([[0.0, 0.0, 1.0]]))[0] * [1.0, 1.0, 0.0]
    cosine = -float(axis @ normal) / max(float(np.linalg.norm(axis)), 1e-9)
    return target, normal, float(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _pose_before(target: Array, normal: Array, distance_m: float, cell: CellConfig) -> Array:
    """Returns the base pose whose camera looks along the normal at the target from a distance."""
    mounted = cell.camera.T_base_link_optical
    axis_heading = float(np.arctan2(mounted[1, 2], mounted[0, 2]))
    turn = float(np.arctan2(-normal[1], -normal[0])) - axis_heading
    place = target + distance_m * normal - rotate(planar(0.0, 0.0, turn), mounted[None, :3, 3])[0]
    return planar(place[0], place[1], heading(planar(0.0, 0.0, turn)))


def _plates(T_map_workpiece: Array, fixture: Fixture, ids: NDArray[np.int64]) -> Array:
    """Returns the corners of markers in map, shape (m, 4, 3) [m]."""
    wanted = replace(fixture, markers=tuple(m for m in fixture.markers if m.id in ids))
    sizes = np.array([marker.size_m for marker in wanted.markers])
    return marker_corners(marker_frames(T_map_workpiece, wanted), sizes)
