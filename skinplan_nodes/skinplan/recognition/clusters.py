"""Clouds thinned, taken apart by gaps, and given normals."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from skinplan.errors import InputError
from skinplan.transforms import Array

# Points nearer than this many spacings stand for the same place.
_CLOSE = 0.7


def thinned(points: Array, spacing_m: float) -> NDArray[np.int64]:
    """Numbers of the points that stand for the cubes of a grid: in each the one nearest its middle.

    Args:
        points: shape (n, 3) [m].
        spacing_m: Side of the cubes [m].

    Returns:
        Increasing indices, shape (m,).

    Raises:
        InputError: A spacing that is not positive.
    """
    if not spacing_m > 0.0:
        raise InputError(f"a positive spacing is accepted, found {spacing_m} m")
    if len(points) == 0:
        return np.zeros(0, dtype=np.int64)
    scaled = points / spacing_m
    cells = np.floor(scaled)
    away = scaled - cells - 0.5
    off = np.einsum("ij,ij->i", away, away)
    keys = _keys(cells.astype(np.int64))[0]
    # Points of a camera lie nearly in order: a stable sort is much faster than lexsort.
    order = np.argsort(keys, kind="stable")
    begins = np.flatnonzero(np.diff(keys[order], prepend=-1))
    counts = np.diff(begins, append=len(keys))
    off = off[order]
    nearest = np.flatnonzero(off == np.repeat(np.minimum.reduceat(off, begins), counts))
    # Where two are equally near, the first of them.
    first = np.diff(np.repeat(np.arange(len(begins)), counts)[nearest], prepend=-1) > 0
    return np.sort(order[nearest[first]])


def spread(points: Array, spacing_m: float) -> NDArray[np.int64]:
    """Thins a cloud so that its density is the same everywhere: `thinned`, without close pairs.

    A surface along a wall of the grid would have points on both sides of it, twice as many.

    Args:
        points: shape (n, 3) [m].
        spacing_m: About the distance of neighbours [m].

    Returns:
        Increasing indices, shape (m,).

    Raises:
        InputError: A spacing that is not positive.
    """
    chosen = thinned(points, spacing_m)
    if len(chosen) == 0:
        return chosen
    pairs = cKDTree(points[chosen]).query_pairs(_CLOSE * spacing_m, output_type="ndarray")
    kept = np.ones(len(chosen), dtype=bool)
    # In order of their numbers, the first of a pair stays unless it has gone itself.
    for first, second in pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))].tolist():
        if kept[first]:
            kept[second] = False
    return chosen[kept]


def crowd(points: Array, chosen: NDArray[np.int64], side_m: float) -> NDArray[np.int64]:
    """Counts the points of a cloud about some of them.

    Where the depth jumps, cameras see single points in mid-air: few others are about these.

    Args:
        points: shape (n, 3) [m].
        chosen: Which are asked about, shape (m,).
        side_m: Counted in a cube of 3 cells of this side about the cell of the point [m].

    Returns:
        Number of points in the cube, the point itself included, shape (m,).
    """
    if len(points) == 0:
        return np.zeros(0, dtype=np.int64)
    keys, steps = _keys(np.floor(points / side_m).astype(np.int64))
    known = np.sort(keys, kind="stable")
    total = np.zeros(len(chosen), dtype=np.int64)
    # Three cells along the last axis have neighbouring keys: one range of the points in order.
    for first in (-1, 0, 1):
        for second in (-1, 0, 1):
            middle = keys[chosen] + first * steps[0] + second * steps[1]
            low = np.searchsorted(known, middle - 1)
            high = np.searchsorted(known, middle + 1, side="right")
            total += high - low
    return total


def _keys(cells: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """One number >= 0 for each cell, shape (n, 3), and its step along each axis, shape (3,).

    Cells beside one another along the last axis have neighbouring numbers; there is room for one
    more cell on all sides.
    """
    columns = [column - column.min() + 1 for column in cells.T]
    sizes = [int(column.max()) + 2 for column in columns]
    steps = np.array([sizes[1] * sizes[2], sizes[2], 1])
    return columns[0] * steps[0] + columns[1] * steps[1] + columns[2], steps


def clusters(
    points: Array, gap_m: float, fewest: int = 1, height_weight: float = 1.0
) -> list[NDArray[np.int64]]:
    """Takes a cloud apart where gaps are wider than a bound.

    Args:
        points: shape (n, 3) [m].
        gap_m: Points this near belong together [m].
        fewest: Smaller clusters are dropped.
        height_weight: Of distances along z: 0 = from above only. A Z section seen from above is one
            part although its flanges lie far below each other.

    Returns:
        Numbers of the points of each cluster, the largest first.
    """
    if len(points) == 0:
        return []
    scaled = points * (1.0, 1.0, height_weight)
    # One point to a cell decides which cells hang together: dense clouds have too many pairs.
    side = gap_m / 4.0
    cells = np.floor(scaled / side).astype(np.int64)
    places, owner = np.unique(cells, axis=0, return_inverse=True)
    owner = owner.reshape(-1)
    sums = np.stack([np.bincount(owner, scaled[:, k]) for k in range(3)], axis=1)
    middles = sums / np.bincount(owner)[:, None]
    pairs = cKDTree(middles).query_pairs(gap_m, output_type="ndarray")
    ones = np.ones(len(pairs), dtype=np.int8)
    graph = coo_array((ones, (pairs[:, 0], pairs[:, 1])), shape=(len(places), len(places)))
    _, number = connected_components(graph, directed=False)
    labels = number[owner]
    order = np.argsort(labels, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(labels[order])) + 1)
    kept = [group for group in groups if len(group) >= fewest]
    return sorted(kept, key=lambda group: (-len(group), int(group[0])))


def normals(points: Array, seen_from: Array, neighbours: int = 12) -> Array:
    """Normals of a cloud: planes through each point's neighbours, toward the camera.

    Args:
        points: shape (n, 3) [m], at least 3.
        seen_from: Where each was seen from, shape (n, 3) or (3,) [m].
        neighbours: Points in a plane, the point itself included.

    Returns:
        Unit vectors, shape (n, 3).

    Raises:
        InputError: Too few points.
    """
    if len(points) < 3:
        raise InputError(f"normals were asked for; 3 points are accepted, found {len(points)}")
    _, near = cKDTree(points).query(points, k=min(neighbours, len(points)))
    about = points[near]
    about -= about.mean(axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(np.swapaxes(about, 1, 2) @ about)
    found = vectors[:, :, 0]
    away = np.einsum("ij,ij->i", found, seen_from - points) < 0.0
    return np.asarray(np.where(away[:, None], -found, found))
