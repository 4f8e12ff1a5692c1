"""Target points on rows (M2.2 steps 3 and 4)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.mesh.model import SurfaceMesh
from skinplan.scan_path.cut import Polylines, cut_mesh
from skinplan.scan_path.frame import LEAST_FACING, RowFrame
from skinplan.scan_path.spacing import equivalent_spacing
from skinplan.transforms import Array

Indices = NDArray[np.int64]

# Rows and their first and last points keep this share of the interval from the edge: an edge is
# never quite straight.
INSET_RATIO = 0.125
# A row goes on behind a gap shorter than this share of the interval, without new points at its
# sides.
GAP_RATIO = 0.5
# Pieces shorter than this share of the interval get no point of their own: their neighbours see
# them.
LEAST_PIECE_RATIO = 0.25
# d_e is at least this share of the interval.
FLOOR_RATIO = 0.2
_STEPS_PER_INTERVAL = 8
# Planes and places keep off the edges of a regular mesh by this: which face a point on an edge
# belongs to would be a matter of rounding. Far above rounding, far below what can be measured.
_NUDGE_M = 1e-7


@dataclass(frozen=True, eq=False)
class RowPoints:
    """Target points on rows.

    Attributes:
        targets: shape (n, 3) [m].
        normals: Unit normals of the smoothed surface, shape (n, 3).
        faces: Face of each, shape (n,).
        rows: Row number of each, from 0; points of a row stand in order, shape (n,).
        length_m: Length of all rows [m].
    """

    targets: Array
    normals: Array
    faces: Indices
    rows: Indices
    length_m: float


def scannable_faces(smoothed: SurfaceMesh, base: Array) -> NDArray[np.bool_]:
    """Says which faces look to the scanner's side, shape (f,)."""
    return smoothed.face_normals @ base > LEAST_FACING


def plane_offsets(
    mesh: SurfaceMesh, use: NDArray[np.bool_], across: Array, interval_m: float
) -> Array:
    """Spaces the planes: at most one interval apart, the outer ones just inside the edges.

    Args:
        mesh: The mesh.
        use: Faces that are to be cut, shape (f,).
        across: Normal of the planes, shape (3,).
        interval_m: d_interval [m].

    Returns:
        Rising offsets, shape (m,) [m].
    """
    used = np.zeros(len(mesh.vertices), dtype=bool)
    used[mesh.faces[use]] = True
    places = mesh.vertices[used] @ across
    low, high = float(places.min()), float(places.max())
    inset = INSET_RATIO * interval_m
    if high - low <= interval_m:
        return np.array([(low + high) / 2])
    intervals = int(np.ceil((high - low - 2 * inset) / interval_m - 1e-6))
    return np.linspace(low + inset, high - inset, intervals + 1)


def sample_rows(
    mesh: SurfaceMesh,
    smoothed: SurfaceMesh,
    frame: RowFrame,
    interval_m: float,
    complex_faces: NDArray[np.bool_],
    sensitivity: float,
) -> RowPoints:
    """Cuts the whole part into rows and puts targets on them.

    Args:
        mesh: The part; targets lie on it.
        smoothed: The same faces without small features; its normals count.
        frame: Row frame.
        interval_m: d_interval [m].
        complex_faces: Faces where the spacing is not narrowed by eq (4), shape (f,).
        sensitivity: Exponent k of eq (4) on the rest; 0 = constant spacing.

    Returns:
        The targets, those on complex faces included.
    """
    use = scannable_faces(smoothed, frame.base)
    offsets = plane_offsets(mesh, use, frame.across, interval_m) + _NUDGE_M
    lines = cut_mesh(mesh, smoothed.vertex_normals, use, frame, offsets)
    found = []
    length = 0.0
    for row in joined_curves(lines, GAP_RATIO * interval_m):
        arc = _arc_length(lines.points[row])
        if arc[-1] < LEAST_PIECE_RATIO * interval_m:
            continue
        length += float(arc[-1])
        found.append(_sample_row(lines, row, arc, interval_m, complex_faces, sensitivity))
    if not found:
        empty = np.zeros(0, dtype=np.int64)
        return RowPoints(np.zeros((0, 3)), np.zeros((0, 3)), empty, empty, 0.0)
    rows = np.repeat(np.arange(len(found)), [len(points[0]) for points in found])
    targets, normals, faces = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return RowPoints(targets, normals, faces, rows, length)


def joined_curves(lines: Polylines, gap_m: float) -> list[Indices]:
    """Lists the points of each row: curves of one plane, joined over small gaps.

    Args:
        lines: The curves.
        gap_m: A row goes on behind a shorter gap [m].
    """
    rows: list[Indices] = []
    for begin, end in zip(lines.starts[:-1], lines.starts[1:], strict=True):
        curve = np.arange(begin, end)
        if rows:
            last = rows[-1][-1]
            near = np.linalg.norm(lines.points[begin] - lines.points[last]) < gap_m
            if near and lines.planes[begin] == lines.planes[last]:
                rows[-1] = np.concatenate([rows[-1], curve])
                continue
        rows.append(curve)
    return rows


def _arc_length(points: Array) -> Array:
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))


def _sample_row(
    lines: Polylines,
    row: Indices,
    arc: Array,
    interval_m: float,
    complex_faces: NDArray[np.bool_],
    sensitivity: float,
) -> tuple[Array, Array, Indices]:
    places = _places(lines, row, arc, interval_m, complex_faces, sensitivity)
    return _at(lines, row, arc, places)


def _places(
    lines: Polylines,
    row: Indices,
    arc: Array,
    interval_m: float,
    complex_faces: NDArray[np.bool_],
    sensitivity: float,
) -> Array:
    """Returns arc lengths of the targets, shape (n,) [m]: evenly spaced, measured in d_e."""
    if arc[-1] <= interval_m:
        return np.array([arc[-1] / 2])
    inset = INSET_RATIO * interval_m
    fine = np.linspace(
        inset, arc[-1] - inset, max(2, int(arc[-1] / interval_m * _STEPS_PER_INTERVAL))
    )
    density = _density(lines, row, arc, fine, interval_m, complex_faces, sensitivity)
    equivalent = np.append(0.0, np.cumsum(np.diff(fine) * (density[1:] + density[:-1]) / 2))
    # A row that is longer by less than a hundredth of an interval gets no further point.
    count = max(1, int(np.ceil(equivalent[-1] / interval_m - 0.01)))
    return np.interp(np.linspace(0.0, equivalent[-1], count + 1), equivalent, fine)


def _density(
    lines: Polylines,
    row: Indices,
    arc: Array,
    fine: Array,
    interval_m: float,
    complex_faces: NDArray[np.bool_],
    sensitivity: float,
) -> Array:
    """Returns d_interval / d_e of the normals half an interval before and behind, shape (n,)."""
    if sensitivity == 0:
        return np.ones(len(fine))
    _, before, face_before = _at(lines, row, arc, np.maximum(fine - interval_m / 2, 0.0))
    _, behind, face_behind = _at(lines, row, arc, np.minimum(fine + interval_m / 2, arc[-1]))
    spacing = equivalent_spacing(before, behind, interval_m, sensitivity)
    density = interval_m / np.maximum(spacing, FLOOR_RATIO * interval_m)
    return np.where(complex_faces[face_before] | complex_faces[face_behind], 1.0, density)


def _at(lines: Polylines, row: Indices, arc: Array, places: Array) -> tuple[Array, Array, Indices]:
    """Returns points, normals and faces at arc lengths; inside a gap those of the nearer side."""
    places = places + _NUDGE_M
    before = np.clip(np.searchsorted(arc, places, side="right") - 1, 0, len(row) - 2)
    step = np.maximum(arc[before + 1] - arc[before], 1e-12)
    share = np.clip((places - arc[before]) / step, 0.0, 1.0)
    gap = lines.faces[row[before]] < 0
    share = np.where(gap, np.round(share), share)[:, None]
    points = (1 - share) * lines.points[row[before]] + share * lines.points[row[before + 1]]
    normals = (1 - share) * lines.normals[row[before]] + share * lines.normals[row[before + 1]]
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    beside = np.where(
        share[:, 0] > 0.5, np.minimum(before + 1, len(row) - 2), np.maximum(before - 1, 0)
    )
    faces = lines.faces[row[np.where(gap, beside, before)]]
    return points, normals, faces
