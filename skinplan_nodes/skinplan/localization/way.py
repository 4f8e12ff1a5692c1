"""The way to the next stand: the camera keeps its distance and its view while the base drives.

A base with differential drive turns, drives straight and turns; a camera beside its centre swings
with every turn. A camera that looks sideways would lose the markers if the base turned toward the
part and drove straight at it. So the base stays turned within a bound of the heading that faces the
markers, and comes nearer slantwise: forward with one slant and backward with the other.
"""

from dataclasses import dataclass
from itertools import permutations

import numpy as np

from skinplan.robot.cell import CellConfig
from skinplan.transforms import Array, heading, planar

# How far the base turns away from facing the markers while it drives.
SLANT_RAD = float(np.radians(25.0))
_STEP_RAD, _STEP_M = 0.02, 0.02
_SHORT_M = 1e-6


@dataclass(frozen=True, eq=False)
class Way:
    """How to get to a goal.

    Attributes:
        stops: Poses of the base in map where it stops, the goal is the last, shape (4, 4) [m] each.
        clearance_m: Least distance of the camera from the marker plane on the way [m].
        length_m: Of the driving [m].
    """

    stops: tuple[Array, ...]
    clearance_m: float
    length_m: float


def plan_way(
    here: Array, goal: Array, facing_rad: float, target: Array, normal: Array, cell: CellConfig
) -> Way:
    """Finds the way on which the camera stays farthest from the markers; then the shortest one.

    Args:
        here: ``T_map_base_link`` now, shape (4, 4) [m].
        goal: ... at the goal.
        facing_rad: Heading of the base that faces the markers [rad].
        target: Place on the marker plane in map, shape (3,) [m].
        normal: Level normal of that plane in map, shape (3,).
        cell: Camera mounting, safe distance.
    """
    ways = [
        _way(here, stops, target, normal, cell) for stops in _candidates(here, goal, facing_rad)
    ]
    # Beyond the goal's own distance nothing is gained by more.
    enough = _distances(goal[None], target, normal, cell)[0] - _STEP_M
    return max(ways, key=lambda way: (round(min(way.clearance_m, enough), 3), -way.length_m))


def _candidates(here: Array, goal: Array, facing_rad: float) -> list[tuple[Array, ...]]:
    """Returns stops of ways whose drives are slanted by no more than the bound."""
    move = goal[:2, 3] - here[:2, 3]
    length = float(np.linalg.norm(move))
    if length < _SHORT_M:
        return [(goal,)]
    off = abs(_wrapped(2.0 * (float(np.arctan2(move[1], move[0])) - facing_rad))) / 2.0
    if off <= SLANT_RAD:
        return [(goal,)]
    slants = (facing_rad - SLANT_RAD, facing_rad + SLANT_RAD)
    found: list[tuple[Array, ...]] = []
    for first, second in permutations(slants):
        courses = np.array([[np.cos(a), np.sin(a)] for a in (first, second)]).T
        lengths = np.linalg.solve(courses, move)
        via = here[:2, 3] + lengths[0] * courses[:, 0]
        found.append((planar(via[0], via[1], first), goal))
    return found


def _way(
    here: Array, stops: tuple[Array, ...], target: Array, normal: Array, cell: CellConfig
) -> Way:
    poses, length, start = [], 0.0, here
    for stop in stops:
        poses.append(swept(start, stop))
        length += float(np.linalg.norm(stop[:2, 3] - start[:2, 3]))
        start = stop
    clearance = _distances(np.concatenate(poses), target, normal, cell).min()
    return Way(stops, float(clearance), length)


def swept(start: Array, stop: Array) -> Array:
    """Returns poses of a base that turns, drives straight, forward or backward, and turns.

    It takes the direction that needs less turning.

    Args:
        start: ``T_map_base_link``, shape (4, 4) [m].
        stop: The same at the end.

    Returns:
        shape (n, 4, 4), start and stop included.
    """
    move = stop[:2, 3] - start[:2, 3]
    length, angle, end = float(np.linalg.norm(move)), heading(start), heading(stop)
    if length < _SHORT_M:
        return _turned(start[:2, 3], angle, _wrapped(end - angle))
    along = float(np.arctan2(move[1], move[0]))
    turns = [
        (_wrapped(course - angle), _wrapped(end - course)) for course in (along, along + np.pi)
    ]
    first, last = min(turns, key=lambda turn: round(abs(turn[0]) + abs(turn[1]), 6))
    shares = np.linspace(0.0, 1.0, 2 + int(length / _STEP_M))
    places = start[:2, 3] + shares[:, None] * move
    drive = _poses(places, np.full(len(places), angle + first))
    return np.concatenate(
        [_turned(start[:2, 3], angle, first), drive, _turned(stop[:2, 3], angle + first, last)]
    )


def _turned(place: Array, angle: float, turn: float) -> Array:
    shares = np.linspace(0.0, 1.0, 2 + int(abs(turn) / _STEP_RAD))
    return _poses(np.tile(place, (len(shares), 1)), angle + shares * turn)


def _poses(places: Array, angles: Array) -> Array:
    """Poses on the floor: places, shape (n, 2) [m], headings, shape (n,) [rad]: (n, 4, 4)."""
    poses = np.tile(np.eye(4), (len(angles), 1, 1))
    poses[:, 0, 0] = poses[:, 1, 1] = np.cos(angles)
    poses[:, 1, 0] = np.sin(angles)
    poses[:, 0, 1] = -poses[:, 1, 0]
    poses[:, :2, 3] = places
    return poses


def _distances(poses: Array, target: Array, normal: Array, cell: CellConfig) -> Array:
    """Returns how far the camera is from the marker plane at poses of the base, shape (n,) [m]."""
    cameras = poses @ cell.camera.T_base_link_optical
    return np.asarray((cameras[:, :3, 3] - target) @ normal)


def _wrapped(angle: float) -> float:
    return float((angle + np.pi) % (2.0 * np.pi) - np.pi)
