"""Closed meshes from blocks: cells of a curved grid, some of them kept, with round holes.

The boundary of the kept cells is the mesh. No boolean engine is asked, so nothing depends on its
version or tolerances, and no face lies inside the body.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from skinplan.transforms import Array

# The grid is bent to a circle within this many radii of a hole's centre.
_REACH = 1.6
_RING = np.array([-_REACH, -1.3, -1.0, -0.5, 0.0, 0.5, 1.0, 1.3, _REACH])


@dataclass(frozen=True)
class Hole:
    """A round hole across a sheet: centre in the flat blank (u, v) and radius [m]."""

    u: float
    v: float
    radius: float


def lines(length: float, pitch: float, holes: Sequence[tuple[float, float]] = ()) -> Array:
    """Grid lines from 0 to a length, about a pitch apart, finer about holes.

    Args:
        length: Last line [m].
        pitch: Wanted distance of neighbours [m].
        holes: Centre and radius along the axis of the lines [m].

    Returns:
        Increasing values [m].
    """
    even = np.linspace(0.0, length, max(1, round(length / pitch)) + 1)
    inner = np.ones(len(even), dtype=bool)
    for centre, radius in holes:
        inner &= np.abs(even - centre) > (_REACH + 0.2) * radius
    inner[[0, -1]] = True
    rings = [centre + radius * _RING for centre, radius in holes]
    merged = np.sort(np.concatenate([even[inner], *rings]))
    # Holes in one row share their lines.
    return np.asarray(merged[np.concatenate([[True], np.diff(merged) > 1e-6])])


def boundary(
    x: Array,
    y: Array,
    z: Array,
    keep: NDArray[np.bool_],
    place: Callable[[Array], Array],
) -> trimesh.Trimesh:
    """Builds the mesh about the kept cells of a grid.

    Args:
        x: Grid lines along the first axis, shape (i + 1,) [m].
        y: Along the second, shape (j + 1,) [m].
        z: Along the third, shape (k + 1,) [m].
        keep: Which cells are kept, shape (i, j, k).
        place: Maps grid points, shape (n, 3), to the part's frame, keeping the orientation.

    Returns:
        A watertight mesh, normals outward [m].
    """
    shape = np.array(keep.shape) + 1
    padded = np.pad(keep, 1)
    quads = []
    for axis in range(3):
        for side in (0, 1):
            ahead = np.roll(padded, -1 if side else 1, axis=axis)[1:-1, 1:-1, 1:-1]
            cells = np.argwhere(keep & ~ahead)
            quads.append(_quads(cells, axis, side, shape))
    corners = np.concatenate(quads)
    faces = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
    used, faces = np.unique(faces, return_inverse=True)
    i, j, k = np.unravel_index(used, shape)
    points = place(np.stack([x[i], y[j], z[k]], axis=1))
    return trimesh.Trimesh(points, faces.reshape(-1, 3), process=False, validate=False)


def _quads(
    cells: NDArray[np.int64], axis: int, side: int, shape: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Numbers of the corners of the cells' faces, counter-clockwise seen from outside, (n, 4)."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    around = [(0, 0), (1, 0), (1, 1), (0, 1)]
    columns = []
    for a, b in around if side else around[::-1]:
        corner = cells.copy()
        corner[:, axis] += side
        corner[:, first] += a
        corner[:, second] += b
        columns.append(np.ravel_multi_index(tuple(corner.T), tuple(shape)))
    return np.stack(columns, axis=1)


def pierced(u: Array, v: Array, holes: Sequence[Hole]) -> NDArray[np.bool_]:
    """Says which cells of a sheet are outside all holes, shape (i, j)."""
    middle_u, middle_v = (u[1:] + u[:-1]) / 2.0, (v[1:] + v[:-1]) / 2.0
    keep = np.ones((len(middle_u), len(middle_v)), dtype=bool)
    for hole in holes:
        away = np.maximum(np.abs(middle_u - hole.u)[:, None], np.abs(middle_v - hole.v)[None, :])
        keep &= away > hole.radius
    return keep


def rounded(flat: Array, holes: Sequence[Hole]) -> Array:
    """Bends the grid about square openings so that they become round.

    Args:
        flat: Grid points in the blank, shape (n, 3), of which u and v are the first two [m].
        holes: The holes.

    Returns:
        The moved points, shape (n, 3) [m].
    """
    moved = flat.copy()
    for hole in holes:
        offset = flat[:, :2] - (hole.u, hole.v)
        square = np.abs(offset).max(axis=1)
        near = (square > 0.0) & (square < _REACH * hole.radius)
        offset, square = offset[near], square[near]
        round_offset = offset * (square / np.linalg.norm(offset, axis=1))[:, None]
        share = np.clip((_REACH - square / hole.radius) / (_REACH - 1.0), 0.0, 1.0)[:, None]
        moved[near, :2] = (hole.u, hole.v) + share * round_offset + (1.0 - share) * offset
    return moved
