"""Where the base can stand: clear of part and shop, the markers in the camera's view."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skinplan.mesh.model import SurfaceMesh
from skinplan.robot.cell import CellConfig
from skinplan.robot.cell_check import PEDESTAL_RADIUS_M, base_box
from skinplan.robot.distance_field import distance_field
from skinplan.robot.shapes import box_distances
from skinplan.stations.marker_view import MarkerView
from skinplan.transforms import Array, apply, inverse

_PITCH_M = 0.05  # spacing of the points on the base that are checked against obstacles


@dataclass(frozen=True, eq=False)
class Standing:
    """Where the base can stand.

    Attributes:
        free: Where nothing is against it, shape (c,).
        blind: Where base and pedestal are clear, but the part could not be located, shape (c,).
        blocked: What most of the others stand in, or lack.
    """

    free: NDArray[np.bool_]
    blind: NDArray[np.bool_]
    blocked: str


def standing(
    cell: CellConfig,
    mesh: SurfaceMesh,
    T_map_workpiece: Array,
    poses: Array,
    markers: MarkerView | None = None,
) -> Standing:
    """Tells where base and pedestal are clear of part and obstacles, and the markers are seen.

    Args:
        cell: The cell.
        mesh: The part, workpiece frame.
        T_map_workpiece: Part in the shop, shape (4, 4) [m].
        poses: ``T_map_base_link``, shape (c, 4, 4) [m].
        markers: What the camera is to see; None = nothing.
    """
    field = distance_field(mesh)
    points = apply(T_map_workpiece, field.samples)
    margin = cell.collision_margin_m + field.spacing
    blocked = {
        "base with part": _in_base(cell, points, margin, poses),
        "pedestal with part": _in_pedestal(cell, points, margin, poses),
    }
    for obstacle in cell.obstacles:
        half = 0.5 * np.array(obstacle.size_m)
        T_box_map = inverse(obstacle.T_map_box)
        blocked[f"base with {obstacle.name}"] = np.array(
            [
                box_distances(apply(T_box_map @ pose, _base_points(cell)), -half, half).min()
                < cell.collision_margin_m
                for pose in poses
            ],
            dtype=bool,
        )
    clear = ~np.any(list(blocked.values()), axis=0)
    blind = np.zeros(len(poses), dtype=bool)
    if markers is not None:
        blind = clear & ~markers.suffices(cell, T_map_workpiece, poses)
        blocked[markers.words(cell)] = blind
    most = max(blocked, key=lambda name: int(blocked[name].sum()))
    return Standing(clear & ~blind, blind, most)


def _in_base(cell: CellConfig, points: Array, margin: float, poses: Array) -> NDArray[np.bool_]:
    """Which poses have points of the part in the base's box."""
    low, high = base_box(cell)
    below = points[points[:, 2] < high[2] + margin]
    hits = np.zeros(len(poses), dtype=bool)
    if not len(below):
        return hits
    near, _ = cKDTree(below[:, :2]).query(poses[:, :2, 3])
    for number in np.flatnonzero(near < np.linalg.norm(high[:2]) + margin):
        hits[number] = box_distances(apply(inverse(poses[number]), below), low, high).min() < margin
    return hits


def _in_pedestal(cell: CellConfig, points: Array, margin: float, poses: Array) -> NDArray[np.bool_]:
    """Which poses have points of the part in the pedestal below the arm."""
    arm = cell.T_base_link_arm_base[:3, 3]
    beside = points[(points[:, 2] < arm[2] + margin) & (points[:, 2] > cell.base_size_m[2])]
    if not len(beside):
        return np.zeros(len(poses), dtype=bool)
    near, _ = cKDTree(beside[:, :2]).query(apply_each(poses, arm)[:, :2])
    return np.asarray(near < PEDESTAL_RADIUS_M + margin)


def apply_each(poses: Array, point: Array) -> Array:
    """Maps one point, (3,), by each of the poses, (c, 4, 4); shape (c, 3)."""
    return np.asarray(poses[:, :3, :3] @ point + poses[:, :3, 3])


def _base_points(cell: CellConfig) -> Array:
    low, high = base_box(cell)
    counts = np.ceil((high - low) / _PITCH_M).astype(int) + 1
    axes = [np.linspace(low[a], high[a], counts[a]) for a in range(3)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
