"""Points on a surface that do not depend on its triangles: where the lines of a lattice meet it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.mesh.model import SurfaceMesh
from skinplan.scan_path.frame import RowFrame
from skinplan.transforms import Array

Indices = NDArray[np.int64]

_ROUNDING = 1e-9
# Vertices of a symmetric part stand at whole shares of its size, and its edges run between them:
# the lines keep off both.
_OFFSETS = 0.5 / np.sqrt([2.0, 3.0, 5.0])
# Multipliers of the finaliser of the generator SplitMix64.
_MIX = (np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB))
_STEP = np.uint64(0x9E3779B97F4A7C15)


@dataclass(frozen=True, eq=False)
class LatticePoints:
    """Points of a surface on the lines of a lattice, in a shuffled order that is always the same.

    Attributes:
        points: shape (n, 3) [m].
        faces: Face of each, shape (n,).
        shares: Shares of the three corners of the face, shape (n, 3), sum 1.
    """

    points: Array
    faces: Indices
    shares: Array


def lattice_points(
    mesh: SurfaceMesh, faces: NDArray[np.bool_], frame: RowFrame, pitch_m: float
) -> LatticePoints:
    """Meets a surface with three sets of parallel lines, each where it is steepest to them.

    The lattice stands in the middle of the part, along the axes of the row frame. Points and their
    order depend on the shape of the part alone: not on where it stands, nor on the order or size
    of its triangles.

    Args:
        mesh: The part.
        faces: Which faces, shape (f,).
        frame: Row frame.
        pitch_m: Distance of the lines [m]; neighbouring points are at most sqrt(3) times as far
            apart.

    Returns:
        The points.
    """
    axes = np.stack([frame.along, frame.across, frame.base])
    places = mesh.vertices @ axes.T
    low, high = places.min(axis=0), places.max(axis=0)
    cells = (places - (low + high) / 2) / pitch_m + _OFFSETS
    numbers = np.flatnonzero(faces)
    steepest = np.argmax(np.abs(mesh.face_normals[numbers] @ axes.T), axis=1)
    found = []
    ranks = []
    for axis in range(3):
        chosen = numbers[steepest == axis]
        aside = np.delete(np.arange(3), axis)
        face, line, shares = _met(mesh.faces, chosen, cells[:, aside])
        depth = np.einsum("nc,nc->n", shares, cells[mesh.faces[face], axis])
        found.append((face, shares))
        ranks.append((depth, _shuffled(line, axis)))
    face, shares = (np.concatenate(parts) for parts in zip(*found, strict=True))
    depth, rank = (np.concatenate(parts) for parts in zip(*ranks, strict=True))
    order = np.lexsort((depth, rank))
    face, shares = face[order], shares[order]
    points = np.einsum("nc,nci->ni", shares, mesh.vertices[mesh.faces[face]])
    return LatticePoints(points, face, shares)


def _met(faces: Indices, chosen: Indices, flat: Array) -> tuple[Indices, Indices, Array]:
    """Finds the points with whole coordinates inside triangles of the plane.

    Args:
        faces: shape (f, 3).
        chosen: Numbers of the faces that count, shape (m,).
        flat: Coordinates of the vertices in the plane, shape (v, 2).

    Returns:
        Face of each, shape (n,), its whole coordinates, shape (n, 2), and the shares of the
        corners, shape (n, 3).
    """
    corners = flat[faces[chosen]]
    first = np.ceil(corners.min(axis=1) - _ROUNDING).astype(np.int64)
    size = np.floor(corners.max(axis=1) + _ROUNDING).astype(np.int64) - first + 1
    hit = np.flatnonzero((size > 0).all(axis=1))
    counts = size[hit].prod(axis=1)
    owner = np.repeat(hit, counts)
    number = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
    line = first[owner] + np.stack(np.divmod(number, size[owner, 1]), axis=1)
    a, b, c = (corners[owner, corner] - line for corner in range(3))
    parts = np.stack([_cross(b, c), _cross(c, a), _cross(a, b)], axis=1)
    whole = parts.sum(axis=1, keepdims=True)
    shares = np.divide(parts, whole, out=np.full_like(parts, -1.0), where=np.abs(whole) > 1e-12)
    inside = (shares >= -_ROUNDING).all(axis=1)
    return chosen[owner[inside]], line[inside], shares[inside]


def _cross(first: Array, second: Array) -> Array:
    return first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]


def _shuffled(line: Indices, axis: int) -> NDArray[np.uint64]:
    """Mixes the numbers of lines, shape (n, 2), into ranks without visible order, shape (n,)."""
    mixed = np.full(len(line), axis + 1, dtype=np.uint64)
    for column in line.T:
        mixed = (mixed + column.astype(np.uint64)) * _STEP
        for shift, factor in zip((30, 27), _MIX, strict=True):
            mixed = (mixed ^ (mixed >> np.uint64(shift))) * factor
        mixed ^= mixed >> np.uint64(31)
    return mixed
