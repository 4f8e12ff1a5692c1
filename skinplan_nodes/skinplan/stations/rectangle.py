"""The workspace rectangle of M2.3, derived from the arm's reach.

The floor is divided into a grid in the frame of the arm (x along the base, y to its left, where the
part is). A cell counts
as reached when the scanner can look along +y, straight, from there at every height of a band of
`BAND_M` about the first joint: inverse kinematics within limits, free of collision with arm and
base. The rectangle is as deep as the working distance: the views of a plane stand between 0 (along
it) and that distance (facing it) in front of it. Of all rectangles of that depth that are symmetric
about x = 0 and hold reached cells only, the longest one is taken, the nearest to the arm among
equals. No figure of any part enters but the working distance.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import NoCandidatesError
from skinplan.robot.cell import CellConfig
from skinplan.robot.collision import CollisionWorld
from skinplan.robot.reach import Views, reach
from skinplan.transforms import Array

BAND_M = 0.8
_GRID_M = 0.05
_HEIGHTS = 7


@dataclass(frozen=True)
class Rectangle:
    """A workspace rectangle.

    Attributes:
        length_m: Extent along the base [m].
        depth_m: Extent across [m].
        offset_m: Its middle lies so far to the left of the arm axis [m].
    """

    length_m: float
    depth_m: float
    offset_m: float


def workspace_rectangle(cell: CellConfig, depth_m: float) -> Rectangle:
    """Derives the rectangle for the cell's arm.

    Args:
        cell: The cell.
        depth_m: Least depth of the rectangle [m].

    Raises:
        NoCandidatesError: The arm reaches no cell at all heights.
    """
    pose = (cell.T_base_link_arm_base, cell.T_tool0_scanner)
    key = tuple(np.concatenate([p.ravel() for p in pose]).tolist())
    scalars = (
        cell.robot,
        cell.home_rad,
        cell.scanner_radius_m,
        cell.base_size_m,
        cell.collision_margin_m,
    )
    return longest_rectangle(*_derive(key, *scalars), depth_m)


@lru_cache(maxsize=8)
def _derive(
    poses: tuple[float, ...],
    robot: str,
    home_rad: tuple[float, ...],
    scanner_radius_m: float,
    base_size_m: tuple[float, float, float],
    margin_m: float,
) -> tuple[Array, Array, NDArray[np.bool_]]:
    cell = CellConfig(
        robot=robot,
        home_rad=home_rad,
        scanner_radius_m=scanner_radius_m,
        base_size_m=base_size_m,
        collision_margin_m=margin_m,
        T_base_link_arm_base=np.array(poses[:16]).reshape(4, 4),
        T_tool0_scanner=np.array(poses[16:]).reshape(4, 4),
    )
    world = CollisionWorld(cell, None)
    far = float(world.arm.lever_arms()[0])
    half = np.arange(0.0, far, _GRID_M)
    x, y = np.concatenate([-half[:0:-1], half]), half
    return x, y, _reached_cells(world, x, y, np.array(home_rad))


def longest_rectangle(x: Array, y: Array, mask: NDArray[np.bool_], depth_m: float) -> Rectangle:
    """Finds the longest rectangle of reached cells of a depth that is symmetric about x = 0.

    Args:
        x: Grid places along the base, symmetric about 0, shape (a,) [m].
        y: Grid places across, evenly rising, shape (b,) [m].
        mask: Reached cells, shape (a, b).
        depth_m: Least depth [m].

    Raises:
        NoCandidatesError: There is none.
    """
    middle = len(x) // 2
    both = mask[middle:] & mask[middle::-1]
    # How far from the middle each row is reached without a gap [cells].
    run = np.where(both.all(axis=0), len(both), np.argmin(both, axis=0))
    rows = int(np.ceil(depth_m / (y[1] - y[0]) - 1e-9)) + 1
    lengths = [
        2.0 * x[middle + max(int(run[low : low + rows].min()), 1) - 1]
        for low in range(max(0, len(y) - rows + 1))
    ]
    if not lengths or max(lengths) <= 0.0:
        raise NoCandidatesError(
            f"no workspace rectangle of {depth_m:g} m depth: the arm does not reach that far "
            "beside the base at all heights"
        )
    low = int(np.argmax(np.round(lengths, 9)))
    return Rectangle(
        float(lengths[low]),
        float(y[low + rows - 1] - y[low]),
        float(0.5 * (y[low] + y[low + rows - 1])),
    )


def _reached_cells(world: CollisionWorld, x: Array, y: Array, home: Array) -> NDArray[np.bool_]:
    heights = world.arm.first_axis[2] + np.linspace(-0.5 * BAND_M, 0.5 * BAND_M, _HEIGHTS)
    positions = np.stack(np.meshgrid(x, y, heights, indexing="ij"), axis=-1).reshape(-1, 3)
    view = np.array([0.0, 1.0, 0.0])
    directions = np.tile(view, (len(positions), 1))
    seen = reach(world, Views(positions, directions, positions + 0.3 * view, view), 0.0, home).view
    reached = np.zeros(len(positions), dtype=bool)
    reached[seen] = True
    return np.asarray(reached.reshape(len(x), len(y), len(heights)).all(axis=2))
