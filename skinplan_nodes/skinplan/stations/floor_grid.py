"""Places on the floor from where the part might be scanned: a grid with headings."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.stations.candidates import floor_frame
from skinplan.transforms import Array, planar

_BEYOND_M = 0.30  # the grid goes so far beyond the ends of the part
_HEADINGS = np.pi / 4.0  # headings differ from the main one by whole numbers of these


@dataclass(frozen=True, eq=False)
class FloorGrid:
    """Candidate poses of the base.

    Attributes:
        cells: Numbers of the grid cell along and across the part, shape (c, 2).
        poses: ``T_map_base_link``, shape (c, 4, 4) [m].
        step_m: Side of a cell [m].
        heading_rad: Main heading: parallel to the part, which is on the left.
    """

    cells: NDArray[np.int64]
    poses: Array
    step_m: float
    heading_rad: float

    def __len__(self) -> int:
        return len(self.cells)

    @property
    def along(self) -> Array:
        """Unit direction along the part on the floor, shape (2,), map frame."""
        return np.array([np.cos(self.heading_rad), np.sin(self.heading_rad)])

    def take(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> "FloorGrid":
        """Returns some of the cells."""
        return FloorGrid(self.cells[which], self.poses[which], self.step_m, self.heading_rad)


def floor_grid(
    positions: Array, directions: Array, arm_offset: Array, reach_m: float, step_m: float
) -> FloorGrid:
    """Lays a grid before the part.

    The grid is parallel to the part, with a node at the middle of the points' extent, so that it
    moves with the part. A place counts when some point is within horizontal reach of the arm and is
    looked at away from the arm. There the base stands with its long side across the mean view of
    the points in reach, in steps of 45 degrees from the main heading.

    Args:
        positions: Scanner origins in the shop, shape (n, 3) [m].
        directions: Unit view directions in the shop, shape (n, 3).
        arm_offset: Arm on the base, (x, y), shape (2,) [m].
        reach_m: Horizontal reach of the arm [m].
        step_m: Side of a cell [m].
    """
    heading = floor_frame(positions[:, :2], directions)
    turn = planar(0.0, 0.0, heading)[:2, :2]
    points, looks = positions[:, :2] @ turn, directions[:, :2] @ turn
    low, high = points.min(axis=0), points.max(axis=0)
    middle = 0.5 * (low + high)
    # The last term keeps the count from hanging on rounding errors.
    counts = np.ceil((0.5 * (high - low) + [_BEYOND_M, reach_m]) / step_m - 1e-6).astype(np.int64)
    cells = np.stack(
        np.meshgrid(*(np.arange(-c, c + 1) for c in counts), indexing="ij"), axis=-1
    ).reshape(-1, 2)
    places = middle + step_m * cells
    useful = np.zeros(len(cells), dtype=bool)
    turns = np.zeros(len(cells))
    for number, place in enumerate(places):
        way = points - place
        near = np.einsum("ni,ni->n", way, way) <= (reach_m + 1e-6) ** 2
        if np.any(np.einsum("ni,ni->n", way[near], looks[near]) > -1e-9):
            useful[number] = True
            turns[number] = _local_heading(looks[near])
    cells, places, turns = cells[useful], places[useful] @ turn.T, turns[useful]
    poses = np.array([planar(0.0, 0.0, heading + angle) for angle in turns]).reshape(-1, 4, 4)
    poses[:, :2, 3] = places - np.einsum("nij,j->ni", poses[:, :2, :2], arm_offset)
    return FloorGrid(cells, poses, step_m, heading)


def _local_heading(looks: Array) -> float:
    """Heading across the mean view, from the main one (whose left is y), in steps of 45 degrees."""
    mean = looks.mean(axis=0)
    if np.linalg.norm(mean) < 0.2:
        return 0.0
    return float(np.round(np.arctan2(-mean[0], mean[1]) / _HEADINGS) * _HEADINGS)
