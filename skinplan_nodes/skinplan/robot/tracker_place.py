"""Does a tracker position serve a whole plan, and which one would?"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import InputError, TrackerBlindError
from skinplan.mesh.model import SurfaceMesh
from skinplan.robot.arm import ArmModel
from skinplan.robot.bodies import Bodies
from skinplan.robot.cell import CellConfig
from skinplan.robot.tracker import TrackerSight
from skinplan.transforms import Array, apply, transform

_HEIGHTS_M = (1.2, 1.7, 2.2, 2.7)
_STEP_M = 0.5
_AWAY_M = 0.7  # the tracker stands so far from every station's middle at least


@dataclass(frozen=True, eq=False)
class Postures:
    """Joint positions of a plan, wherever they are taken.

    Attributes:
        q: Joint positions, shape (n, 6) [rad].
        T_map_arm: Arm base in the shop for each of them, shape (n, 4, 4) [m].
    """

    q: Array
    T_map_arm: Array

    def __post_init__(self) -> None:
        if np.ndim(self.q) != 2 or len(self.q) == 0 or self.T_map_arm.shape != (len(self.q), 4, 4):
            raise InputError(
                "at least one posture of shape (n, 6) with arm bases (n, 4, 4) is accepted, found "
                f"{np.shape(self.q)} and {self.T_map_arm.shape}"
            )


@dataclass(frozen=True, eq=False)
class TrackerCheck:
    """What the tracker sees of a plan.

    Attributes:
        seen: For each posture, shape (n,).
        reasons: Why not, by the number of the posture.
    """

    seen: NDArray[np.bool_]
    reasons: dict[int, str]


def check_tracker(
    cell: CellConfig,
    mesh: SurfaceMesh | None,
    T_map_workpiece: Array | None,
    postures: Postures,
    T_map_tracker: Array | None = None,
) -> TrackerCheck:
    """Checks a tracker position for all postures of a plan.

    Args:
        cell: The cell.
        mesh: The part, workpiece frame; None = no part.
        T_map_workpiece: Part in the shop, shape (4, 4) [m]; needed with a part.
        postures: Where the arm holds the scanner.
        T_map_tracker: Tracker in the shop, shape (4, 4) [m]; None = the cell's.
    """
    sight = TrackerSight(cell, mesh, T_map_workpiece, T_map_tracker)
    bodies = Bodies(ArmModel.load(cell), cell)
    segments, T_arm_scanner = bodies.placed(postures.q)
    codes = sight.codes(bodies, segments, T_arm_scanner, postures.T_map_arm)
    reasons = {int(n): sight.names[int(codes[n])] for n in np.flatnonzero(codes)}
    return TrackerCheck(codes == 0, reasons)


def propose_tracker(
    cell: CellConfig, mesh: SurfaceMesh, T_map_workpiece: Array, postures: Postures
) -> Array:
    """Finds a place for the tracker from where it sees the scanner at as many postures as it can.

    Places on a grid of 0.5 m around the part, at four heights, looking at the middle of the
    scanner's ways, are compared: most postures seen, then the nearest to the middle of the
    tracker's range, then the first.

    Args:
        cell: The cell; its own tracker position is not asked.
        mesh: The part, workpiece frame.
        T_map_workpiece: Part in the shop, shape (4, 4) [m].
        postures: Where the arm holds the scanner.

    Returns:
        ``T_map_tracker``, shape (4, 4) [m]; +x looks at the part.

    Raises:
        TrackerBlindError: From nowhere any posture is seen.
    """
    bodies = Bodies(ArmModel.load(cell), cell)
    segments, T_arm_scanner = bodies.placed(postures.q)
    T_map_scanner = postures.T_map_arm @ T_arm_scanner
    aim = T_map_scanner[:, :3, 3].mean(axis=0)
    wanted = 0.5 * (cell.tracker.range_min_m + cell.tracker.range_max_m)
    best, place = (0, 0.0), None
    anywhere = TrackerSight(cell, mesh, T_map_workpiece)
    for T_map_tracker in _places(cell, aim, postures.T_map_arm[:, :2, 3], mesh, T_map_workpiece):
        sight = anywhere.placed(T_map_tracker)
        if int(sight.in_view(T_map_scanner).sum()) < best[0]:
            continue
        seen = sight.codes(bodies, segments, T_arm_scanner, postures.T_map_arm) == 0
        off = abs(float(np.linalg.norm(T_map_tracker[:3, 3] - aim)) - wanted)
        if (int(seen.sum()), -off) > best and seen.any():
            best, place = (int(seen.sum()), -off), T_map_tracker
    if place is None:
        raise TrackerBlindError(
            f"no place for the tracker sees the scanner at any of {len(postures.q)} postures; "
            f"range {cell.tracker.range_min_m:g} to {cell.tracker.range_max_m:g} m and cone "
            f"{cell.tracker.cone_rad:g} rad leave none"
        )
    return place


def _places(
    cell: CellConfig, aim: Array, stations: Array, mesh: SurfaceMesh, T_map_workpiece: Array
) -> list[Array]:
    """Tracker poses that look at a point, clear of the stations and the part's box."""
    far = cell.tracker.range_max_m
    steps = np.arange(-np.floor(far / _STEP_M), np.floor(far / _STEP_M) + 1) * _STEP_M
    corners = apply(T_map_workpiece, mesh.vertices)
    low, high = corners.min(axis=0), corners.max(axis=0)
    result = []
    for dx in steps:
        for dy in steps:
            place = aim[:2] + (dx, dy)
            if np.linalg.norm(stations - place, axis=1).min() < _AWAY_M:
                continue
            if np.all(place > low[:2] - _STEP_M) and np.all(place < high[:2] + _STEP_M):
                continue
            for height in _HEIGHTS_M:
                way = aim - [*place, height]
                distance = float(np.linalg.norm(way))
                if cell.tracker.range_min_m <= distance <= far:
                    result.append(transform([*place, height], _looking(way / distance)))
    return result


def _looking(x: Array) -> Array:
    """Rotation whose first column is x and whose z is as near to up as can be, shape (3, 3)."""
    up = np.array([0.0, 0.0, 1.0]) if abs(x[2]) < 0.99 else np.array([0.0, 1.0, 0.0])
    y = np.cross(up, x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], axis=1)
