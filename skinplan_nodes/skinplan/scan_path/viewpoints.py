"""Single viewpoints, straight and tilted into features (strategy ``coverage``)."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from skinplan.scan_path.averages import AveragedSurface
from skinplan.scan_path.frame import RowFrame
from skinplan.scan_path.poses import SINGLE, Poses
from skinplan.transforms import Array


def viewpoints(
    surface: AveragedSurface,
    places: Array,
    frame: RowFrame,
    standoff_m: float,
    tilts_rad: Sequence[float],
    sides: int,
) -> Poses:
    """Makes single views of places: along the averaged normal, and tilted to all sides.

    Args:
        surface: Averages of the part.
        places: Points on or near the part, shape (n, 3) [m].
        frame: Directions of the passes, from which the sides are counted.
        standoff_m: Distance from the place [m].
        tilts_rad: Angles of tilt [rad].
        sides: Number of sides to tilt to.

    Returns:
        ``n * (1 + len(tilts_rad) * sides)`` poses.
    """
    points, normals = surface.at(places)
    return views_about(points, normals, frame, standoff_m, tilts_rad, sides)


def views_about(
    places: Array,
    normals: Array,
    frame: RowFrame,
    standoff_m: float,
    tilts_rad: Sequence[float],
    sides: int,
) -> Poses:
    """Makes single views of places along given normals, shape (n, 3), and tilted to all sides."""
    views = _tilted(normals, frame, tilts_rad, sides)
    targets = np.repeat(places, views.shape[1], axis=0)
    return Poses.looking(targets, views.reshape(-1, 3), standoff_m, np.full(len(targets), SINGLE))


def shifted(poses: Poses, shift_m: float) -> Poses:
    """Returns each pose moved sideways to four sides: about the same view from beside."""
    helper = np.eye(3)[np.argmin(np.abs(poses.directions), axis=1)]
    first = np.cross(poses.directions, helper)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-12)
    second = np.cross(poses.directions, first)
    moves = np.concatenate([first, -first, second, -second]) * shift_m
    four = Poses.joined([poses] * 4)
    return Poses(
        four.positions + moves, four.directions, four.targets + moves, np.full(len(four), SINGLE)
    )


def _tilted(normals: Array, frame: RowFrame, tilts_rad: Sequence[float], sides: int) -> Array:
    """Returns unit vectors about normals, shape (n, 1 + tilts * sides, 3)."""
    first = frame.along - (normals @ frame.along)[:, None] * normals
    # A normal along the passes has no direction of its own: any will do.
    first = np.where(np.linalg.norm(first, axis=1, keepdims=True) > 1e-3, first, frame.across)
    first = first / np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(normals, first)
    angles = 2.0 * np.pi * np.arange(sides) / sides
    around = np.cos(angles)[:, None, None] * first + np.sin(angles)[:, None, None] * second
    views = [normals]
    for tilt in tilts_rad:
        views += list(np.cos(tilt) * normals + np.sin(tilt) * around)
    return np.stack(views, axis=1)


def thinned(points: Array, frame: RowFrame, spacing_m: float) -> NDArray[np.int64]:
    """Picks one point per cube of a grid, the one nearest to the mean of its cube.

    Args:
        points: shape (n, 3) [m].
        frame: Directions of the grid.
        spacing_m: Side of a cube [m].

    Returns:
        Numbers of the points picked, shape (m,).
    """
    if not len(points):
        return np.zeros(0, dtype=np.int64)
    local = points @ np.stack([frame.along, frame.across, frame.base], axis=1)
    # A micrometre keeps rounding from moving the grid's first plane behind the first point.
    cells = np.floor((local - local.min(axis=0) + 1e-6) / spacing_m).astype(np.int64)
    _, cube = np.unique(cells, axis=0, return_inverse=True)
    cube = cube.reshape(-1)
    count = np.bincount(cube)
    means = np.stack([np.bincount(cube, weights=axis) / count for axis in points.T], axis=1)
    gap = np.round(np.linalg.norm(points - means[cube], axis=1), 9)
    order = np.lexsort((np.arange(len(points)), gap, cube))
    return order[np.searchsorted(cube[order], np.arange(len(count)))]
