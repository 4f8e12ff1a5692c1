"""Stations that work although the base stops beside its goal (M3: +-50 mm).

The disturbed poses of a candidate are its eight neighbours on the candidate grid, whose step is the
base's error: places up to one step away along and across the part, and both. They must be free and
reach the point as well. The heading error turns a vertical first joint, which keeps clear of its
limits by that angle, and the base's box, which is larger for it in all collision checks. An arm
beside the middle of the base is also moved by a heading error: the step is larger by that.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from skinplan.robot.cell import CellConfig

_LEAST_STEP_M = 0.025
STEP_M = 0.05


def grid_step(cell: CellConfig) -> float:
    """Returns the step of the candidate grid: the base's error at the arm [m]."""
    if cell.base_error_m <= 0.0:
        return STEP_M
    offset = float(np.linalg.norm(cell.T_base_link_arm_base[:2, 3]))
    return max(_LEAST_STEP_M, cell.base_error_m + offset * cell.base_error_rad)


def widened(cell: CellConfig) -> CellConfig:
    """Returns the cell with the base's box as large as its heading error can make it appear."""
    length, width, height = cell.base_size_m
    more = 2.0 * 0.5 * float(np.hypot(length, width)) * np.sin(cell.base_error_rad)
    return dataclasses.replace(cell, base_size_m=(length + more, width + more, height))


def eroded(reached: NDArray[np.bool_], cells: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Keeps what a candidate and all eight neighbours reach.

    Args:
        reached: Which candidate reaches which point, shape (c, n).
        cells: Grid cells of the candidates, shape (c, 2). A cell that is not among them reaches
            nothing.

    Returns:
        Shape (c, n).
    """
    if not len(cells):
        return reached.copy()
    low = cells.min(axis=0) - 1
    size = cells.max(axis=0) - low + 2
    number = np.full(size, -1, dtype=np.int64)
    number[tuple((cells - low).T)] = np.arange(len(cells))
    result = reached.copy()
    for shift in np.ndindex(3, 3):
        neighbour = number[tuple((cells - low + np.array(shift) - 1).T)]
        result &= reached[neighbour] & (neighbour >= 0)[:, None]
    return result
