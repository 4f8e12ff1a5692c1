"""The frame in which a part is cut into rows."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from skinplan.errors import MeshRefusedError, PartInvalidError
from skinplan.mesh.model import SurfaceMesh
from skinplan.transforms import Array

# A face whose normal is farther than this from the base normal (cosine) can't be looked at from the
# scanner's side.
LEAST_FACING = 0.05
# Ends of a part whose third moments differ by less are alike but for rounding.
_ENDS_ALIKE = 1e-7
_RIM_DIRECTIONS = 8


@dataclass(frozen=True, eq=False)
class RowFrame:
    """Directions of row cutting, orthonormal, in the workpiece frame.

    Attributes:
        along: Direction of the rows, shape (3,).
        across: Normal of the cutting planes, shape (3,).
        base: Mean outward normal of the part, shape (3,).
    """

    along: Array
    across: Array
    base: Array


def base_normal(mesh: SurfaceMesh, faces: NDArray[np.bool_] | None = None) -> Array:
    """Returns the area-weighted mean outward normal of (some) faces, shape (3,).

    Args:
        mesh: The mesh.
        faces: Which faces, shape (f,); None = all.

    Raises:
        MeshRefusedError: The normals cancel out: the surface has no side that faces the scanner.
    """
    weighted = mesh.face_normals * mesh.face_areas[:, None]
    mean = (weighted if faces is None else weighted[faces]).sum(axis=0)
    area = float(mesh.face_areas.sum() if faces is None else mesh.face_areas[faces].sum())
    if np.linalg.norm(mean) < 0.05 * area:
        raise MeshRefusedError(
            "the surface looks to all sides alike (its mean normal is zero); a skin with one "
            "side to scan is accepted"
        )
    return mean / np.linalg.norm(mean)


def given_frame(base: Array, direction: tuple[float, float, float]) -> RowFrame:
    """Makes the frame of a given row direction, projected to the part's mean plane.

    Raises:
        PartInvalidError: The direction is perpendicular to the part.
    """
    wanted = np.asarray(direction, dtype=float)
    if is_across(base, direction):
        raise PartInvalidError(
            f"scan.row_direction {list(direction)} is perpendicular to the part; a direction "
            "along its surface is accepted"
        )
    flat = wanted - (wanted @ base) * base
    along = flat / float(np.linalg.norm(flat))
    return RowFrame(along, np.cross(base, along), base)


def is_across(base: Array, direction: tuple[float, float, float]) -> bool:
    """Tells whether a row direction is perpendicular to a surface of this mean normal, (3,)."""
    wanted = np.asarray(direction, dtype=float)
    length = float(np.linalg.norm(wanted - (wanted @ base) * base))
    return not np.isfinite(length) or length < 0.1 * float(np.linalg.norm(wanted))


def candidate_frames(
    vertices: Array, base: Array, weights: Array | None = None
) -> tuple[RowFrame, ...]:
    """Returns the frames along the two sides of the smallest rectangle around the part.

    Args:
        vertices: Points of the part, shape (v, 3) [m].
        base: Mean normal, shape (3,).
        weights: What each point weighs when ends are told apart, shape (v,); None = all the same.

    Returns:
        Two frames, the one along the longer side first.
    """
    helper = np.eye(3)[np.argmin(np.abs(base))]
    first = np.cross(helper, base) / np.linalg.norm(np.cross(helper, base))
    second = np.cross(base, first)
    flat = np.stack([vertices @ first, vertices @ second], axis=1)
    angle = _rectangle_angle(flat)
    along = np.cos(angle) * first + np.sin(angle) * second
    across = np.cross(base, along)
    frames = [_oriented(axis, base, vertices, weights) for axis in (along, across)]
    frames.sort(key=lambda frame: -float(np.ptp(vertices @ frame.along)))
    return tuple(frames)


def part_frame(mesh: SurfaceMesh, base: Array) -> RowFrame:
    """Returns the frame along the longer side of a part; it moves with the part.

    Args:
        mesh: The part.
        base: Mean normal, shape (3,).
    """
    return candidate_frames(mesh.vertices, base, vertex_areas(mesh))[0]


def vertex_areas(mesh: SurfaceMesh) -> Array:
    """Returns the area of all faces around each vertex, shape (v,) [m^2]."""
    areas = np.zeros(len(mesh.vertices))
    for corner in mesh.faces.T:
        areas += np.bincount(corner, weights=mesh.face_areas, minlength=len(areas))
    return areas


def _oriented(along: Array, base: Array, vertices: Array, weights: Array | None) -> RowFrame:
    """Rows run toward the end with the longer tail: turned parts have turned rows.

    A part whose ends are alike has no such end; rows then run toward the positive side of the axis
    that they are nearest to.
    """
    places = vertices @ along
    low, high = places.min(), places.max()
    offsets = (places - (low + high) / 2) / max(high - low, 1e-12)
    tail = float(np.average(offsets * offsets * offsets, weights=weights))
    if abs(tail) < _ENDS_ALIKE:
        tail = along[np.argmax(np.abs(along))]
    if tail < 0:
        along = -along
    return RowFrame(along, np.cross(base, along), base)


def _rectangle_angle(flat: Array) -> float:
    """Returns the angle [rad] of the rectangle of least area around points, shape (v, 2)."""
    try:
        rim = flat[_near_rim(flat)]
        hull = rim[ConvexHull(rim).vertices]
    except QhullError as error:
        raise MeshRefusedError(
            "the part is a line seen from the scanner; a surface is accepted"
        ) from error
    sides = np.roll(hull, -1, axis=0) - hull
    angles = np.unique(np.round(np.arctan2(sides[:, 1], sides[:, 0]) % (np.pi / 2), 9))
    turned = np.stack([np.cos(angles), np.sin(angles)], axis=1) @ hull.T
    lifted = np.stack([-np.sin(angles), np.cos(angles)], axis=1) @ hull.T
    return float(angles[np.argmin(np.ptp(turned, axis=1) * np.ptp(lifted, axis=1))])


def _near_rim(flat: Array) -> NDArray[np.bool_]:
    """Leaves out points inside the polygon of a few outermost points: the hull has none of them."""
    angles = np.arange(0.0, np.pi, np.pi / _RIM_DIRECTIONS)
    spans = [flat @ np.array([np.cos(angle), np.sin(angle)]) for angle in angles]
    ends = [np.argmax(span) for span in spans] + [np.argmin(span) for span in spans]
    corners = flat[np.append(ends, ends[0])]
    inside = np.ones(len(flat), dtype=bool)
    margin = 1e-9 * float(np.ptp(spans[0]) + np.ptp(spans[_RIM_DIRECTIONS // 2]))
    for begin, end in zip(corners[:-1], corners[1:], strict=True):
        side = end - begin
        length = float(np.hypot(*side))
        if length > 0:
            left = (flat - begin) @ (np.array([-side[1], side[0]]) / length)
            inside &= left > margin
    return ~inside
