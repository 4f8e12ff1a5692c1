"""Nine aircraft details, each a parametric solid in metres.

`doubler` and `curved_skin` have the same outline and holes seen from above, but one is flat.
`rib_left` and `rib_right` are mirror twins: one outline turned over. None has a symmetry that maps
it onto itself, so that its pose is defined.
"""

from collections.abc import Callable

import numpy as np
import trimesh

from skinplan.errors import InputError
from skinplan.recognition.tray.blocks import Hole, boundary, lines
from skinplan.recognition.tray.sheets import Bend, folded_sheet
from skinplan.transforms import Array

_QUARTER = np.pi / 2.0
# Holes of the doubler and of the curved skin: one pattern in the same plan.
_PATTERN = (
    (0.020, 0.020, 0.0035),
    (0.180, 0.020, 0.0035),
    (0.020, 0.080, 0.0035),
    (0.140, 0.080, 0.0035),
    (0.085, 0.042, 0.016),
)
_PLAN_M = (0.2, 0.1)
_SKIN_RADIUS_M = 0.4


def angle_clip() -> trimesh.Trimesh:
    """A clip of L section, 80 mm long."""
    return folded_sheet(
        0.08,
        (0.036, Bend(0.0055, _QUARTER), 0.03),
        0.0025,
        (Hole(0.02, 0.016, 0.004), Hole(0.054, 0.06, 0.004)),
    )


def zee_clip() -> trimesh.Trimesh:
    """A clip of Z section, 110 mm long; one flange is wider than the other."""
    return folded_sheet(
        0.11,
        (0.032, Bend(0.0055, _QUARTER), 0.03, Bend(0.0055, -_QUARTER), 0.022),
        0.002,
        (Hole(0.025, 0.016, 0.005), Hole(0.085, 0.016, 0.003)),
    )


def doubler() -> trimesh.Trimesh:
    """A flat plate, 200 x 100 mm."""
    return folded_sheet(_PLAN_M[0], (_PLAN_M[1],), 0.003, [Hole(*hole) for hole in _PATTERN])


def curved_skin() -> trimesh.Trimesh:
    """A skin with the doubler's outline and holes from above, bent along its length.

    It is highest in the middle.
    """

    def bent(points: Array) -> Array:
        # About an axis across, keeping x of the outer face: the plan stays that of the doubler.
        x = points[:, 0] - _PLAN_M[0] / 2.0
        lean = np.arcsin(x / _SKIN_RADIUS_M)
        outer = _SKIN_RADIUS_M * (np.cos(lean) - np.cos(np.arcsin(_PLAN_M[0] / 2 / _SKIN_RADIUS_M)))
        depth = 0.003 - points[:, 2]
        return np.stack(
            [points[:, 0] - depth * np.sin(lean), points[:, 1], outer - depth * np.cos(lean)],
            axis=1,
        )

    return folded_sheet(
        _PLAN_M[0], (_PLAN_M[1],), 0.003, [Hole(*hole) for hole in _PATTERN], deform=bent
    )


def rib_left() -> trimesh.Trimesh:
    """A flanged rib, 260 mm long, that tapers toward one end; two lightening holes."""

    def tapered(points: Array) -> Array:
        share = 1.0 - 0.3 * points[:, 0] / 0.26
        return np.stack([points[:, 0], points[:, 1] * share, points[:, 2]], axis=1)

    return folded_sheet(
        0.26,
        (0.08, Bend(0.0055, _QUARTER), 0.018),
        0.002,
        (Hole(0.07, 0.042, 0.02), Hole(0.165, 0.042, 0.014)),
        deform=tapered,
    )


def rib_right() -> trimesh.Trimesh:
    """The mirror twin of the left rib."""
    mirrored = rib_left().copy()
    mirrored.vertices[:, 1] *= -1.0
    mirrored.faces = mirrored.faces[:, ::-1]
    return mirrored


def hat_stringer() -> trimesh.Trimesh:
    """A stringer of hat section, 400 mm long, with a drain hole near one end."""
    lean = np.deg2rad(70.0)
    return folded_sheet(
        0.4,
        (
            0.018,
            Bend(0.004, lean),
            0.024,
            Bend(0.006, -lean),
            0.026,
            Bend(0.006, -lean),
            0.024,
            Bend(0.004, lean),
            0.018,
        ),
        0.002,
        (Hole(0.05, 0.066, 0.006), Hole(0.36, 0.009, 0.0025)),
        keep=lambda u, v: (u < 0.37) | (v > 0.018),
    )


def machined_bracket() -> trimesh.Trimesh:
    """A base of 120 x 90 mm with an upright wall along one side and a rib beside its middle."""
    x = lines(0.12, 0.006)
    y = lines(0.09, 0.006)
    z = np.concatenate([[0.0, 0.006], 0.006 + lines(0.048, 0.006)[1:]])
    i, j, k = np.meshgrid(
        (x[1:] + x[:-1]) / 2.0, (y[1:] + y[:-1]) / 2.0, (z[1:] + z[:-1]) / 2.0, indexing="ij"
    )
    base = k < 0.006
    wall = (j > 0.084) & (i > 0.018)
    rib = (i > 0.066) & (i < 0.072) & (j > 0.03) & (k < 0.036)
    notch = (i > 0.096) & (j < 0.024)
    return boundary(x, y, z, (base & ~notch) | wall | rib, lambda grid: grid)


def formed_skin() -> trimesh.Trimesh:
    """A skin of double curvature, 300 x 180 mm, with a bead and one corner cut off."""

    def formed(points: Array) -> Array:
        x, y, height = points[:, 0] - 0.15, points[:, 1] - 0.09, points[:, 2]
        crown = -(x**2) / (2.0 * 0.9) - y**2 / (2.0 * 0.35)
        along, beside = (x + 0.03) / 0.07, (y - 0.025) / 0.022
        bead = 0.007 * np.exp(-(along**4) - beside**2)
        lowest = -(0.15**2) / 1.8 - 0.09**2 / 0.7
        return np.stack([points[:, 0], points[:, 1], height + crown + bead - lowest], axis=1)

    return folded_sheet(
        0.3,
        (0.18,),
        0.0016,
        keep=lambda u, v: (u < 0.246) | (v > 0.048),
        deform=formed,
    )


MAKERS: dict[str, Callable[[], trimesh.Trimesh]] = {
    "angle_clip": angle_clip,
    "zee_clip": zee_clip,
    "doubler": doubler,
    "curved_skin": curved_skin,
    "rib_left": rib_left,
    "rib_right": rib_right,
    "hat_stringer": hat_stringer,
    "machined_bracket": machined_bracket,
    "formed_skin": formed_skin,
}
TWINS = ("rib_left", "rib_right")


def part_mesh(name: str) -> trimesh.Trimesh:
    """Makes one of the nine parts, lying as it is put on the tray (z up) [m].

    Raises:
        InputError: No part of that name.
    """
    if name not in MAKERS:
        raise InputError(f"a part {name!r} was asked; {', '.join(MAKERS)} are accepted")
    return MAKERS[name]()
