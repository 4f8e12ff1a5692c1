"""Bent sheets: a flat blank, pierced, thickened and folded along its length."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from skinplan.recognition.tray.blocks import Hole, boundary, lines, pierced, rounded
from skinplan.transforms import Array

_PITCH_M = 0.006
_ARC_STEP_RAD = np.pi / 10.0


@dataclass(frozen=True)
class Bend:
    """A fold of the section: radius of the sheet's lower face [m], angle, positive = upward [rad].

    A downward fold (negative angle) turns about the upper side; its radius must exceed the sheet's
    thickness.
    """

    radius_m: float
    angle_rad: float

    @property
    def length_m(self) -> float:
        """Length of the arc [m]."""
        return self.radius_m * abs(self.angle_rad)


Section = Sequence[float | Bend]


def folded_sheet(
    length_m: float,
    section: Section,
    thickness_m: float,
    holes: Sequence[Hole] = (),
    keep: Callable[[Array, Array], NDArray[np.bool_]] | None = None,
    deform: Callable[[Array], Array] | None = None,
) -> trimesh.Trimesh:
    """Makes a sheet that is folded along u.

    Args:
        length_m: Along u = x of the part.
        section: Across: lengths of flats [m] and the bends between them, from v = 0.
        thickness_m: Toward the side that upward bends turn to.
        holes: In flats of the blank, away from the bends by 0.6 radii at least.
        keep: Which cells of the blank are kept, by their middle (u, v); None = all.
        deform: Last change of the points, shape (n, 3) [m], smooth and without folding over.

    Returns:
        A watertight mesh in the part's frame: x along u, y along the first flat, z its normal [m].
    """
    u = lines(length_m, _PITCH_M, [(hole.u, hole.radius) for hole in holes])
    v = _across(section, holes)
    cells = pierced(u, v, holes)
    if keep is not None:
        middle_u, middle_v = np.meshgrid(
            (u[1:] + u[:-1]) / 2.0, (v[1:] + v[:-1]) / 2.0, indexing="ij"
        )
        cells &= keep(middle_u, middle_v)

    def place(grid: Array) -> Array:
        points = _folded(rounded(grid, holes), section)
        return points if deform is None else deform(points)

    return boundary(u, v, np.array([0.0, thickness_m]), cells[:, :, None], place)


def _across(section: Section, holes: Sequence[Hole]) -> Array:
    found, start = [np.zeros(1)], 0.0
    for piece in section:
        if isinstance(piece, Bend):
            steps = max(2, round(abs(piece.angle_rad) / _ARC_STEP_RAD))
            along = np.linspace(0.0, piece.length_m, steps + 1)
        else:
            inside = [h for h in holes if start < h.v < start + piece]
            along = lines(piece, _PITCH_M, [(h.v - start, h.radius) for h in inside])
        found.append(start + along[1:])
        start += float(along[-1])
    return np.concatenate(found)


def _folded(blank: Array, section: Section) -> Array:
    """Folds points (u, v, height over the lower face), shape (n, 3) [m]."""
    u, v, height = blank.T
    across, up = np.zeros_like(v), np.zeros_like(v)
    start, angle, corner = 0.0, 0.0, np.zeros(2)
    for piece in section:
        span = piece.length_m if isinstance(piece, Bend) else piece
        # Lines of neighbouring pieces share their last and first line; both map it alike.
        inside = (v >= start - 1e-9) & (v <= start + span + 1e-9)
        along = v[inside] - start
        if isinstance(piece, Bend):
            turned = angle + np.sign(piece.angle_rad) * along / piece.radius_m
            foot = corner[:, None] + _arc(angle, turned, piece)
        else:
            turned = np.full_like(along, angle)
            foot = corner[:, None] + along * np.array([[np.cos(angle)], [np.sin(angle)]])
        across[inside] = foot[0] - np.sin(turned) * height[inside]
        up[inside] = foot[1] + np.cos(turned) * height[inside]
        if isinstance(piece, Bend):
            corner = corner + _arc(angle, np.array([angle + piece.angle_rad]), piece)[:, 0]
            angle += piece.angle_rad
        else:
            corner = corner + span * np.array([np.cos(angle), np.sin(angle)])
        start += span
    return np.stack([u, across, up], axis=1)


def _arc(start: float, turned: Array, bend: Bend) -> Array:
    """Way along an arc from a start direction to others, shape (2, n) [m]."""
    radius = np.sign(bend.angle_rad) * bend.radius_m
    return np.asarray(
        radius * np.stack([np.sin(turned) - np.sin(start), np.cos(start) - np.cos(turned)])
    )
