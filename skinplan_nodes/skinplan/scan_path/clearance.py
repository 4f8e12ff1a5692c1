"""Keeps scan poses off the part."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skinplan.mesh.model import SurfaceMesh
from skinplan.scanner.rays import RayCaster
from skinplan.scanner.samples import sample_surface
from skinplan.transforms import Array

_SAMPLE_SPACING_M = 0.008
_LIFT_M = 0.002
_TILT_STEPS = 6


class Clearance:
    """Tells how near to the part a place is, and whether the view from it is free."""

    def __init__(self, mesh: SurfaceMesh, caster: RayCaster | None = None) -> None:
        """Prepares a part.

        Args:
            mesh: The part.
            caster: Rays against it, when they are at hand.
        """
        self._caster = caster or RayCaster(mesh)
        # Between samples a distance of 100 mm is overestimated by well under a millimetre.
        self._tree = cKDTree(
            np.concatenate([sample_surface(mesh, _SAMPLE_SPACING_M).points, mesh.vertices])
        )

    def distance(self, positions: Array) -> Array:
        """Returns the distance of positions, shape (n, 3), from the part, shape (n,) [m]."""
        distances, _ = self._tree.query(positions)
        return np.asarray(distances, dtype=float)

    def usable(
        self, targets: Array, normals: Array, standoff_m: float, clearance_m: float
    ) -> NDArray[np.bool_]:
        """Says which poses have the clearance and a free view of their target.

        Args:
            targets: shape (n, 3) [m].
            normals: Directions from the target to the scanner, unit, shape (n, 3).
            standoff_m: Distance of the scanner from the target [m].
            clearance_m: Least distance of the scanner from the part [m].

        Returns:
            shape (n,).
        """
        if len(targets) == 0:
            return np.zeros(0, dtype=bool)
        far = self.distance(targets + standoff_m * normals) >= clearance_m - 1e-9
        free = ~self._caster.occluded(targets + _LIFT_M * normals, normals, standoff_m - _LIFT_M)
        return far & free


@dataclass(frozen=True, eq=False)
class Repair:
    """What became of poses that were too near.

    Attributes:
        normals: Directions from target to scanner after the repair, shape (n, 3).
        usable: Whether a pose can be kept, shape (n,).
        tilted: Number of poses that were tilted.
    """

    normals: Array
    usable: NDArray[np.bool_]
    tilted: int


def repair_by_tilt(
    clearance: Clearance,
    targets: Array,
    normals: Array,
    bases: Array,
    standoff_m: float,
    clearance_m: float,
    tilt_max_rad: float,
) -> Repair:
    """Tilts poses without clearance or free view toward the base normal, as little as helps.

    The target stays where it is.

    Args:
        clearance: The part.
        targets: shape (n, 3) [m].
        normals: Unit directions from target to scanner, shape (n, 3).
        bases: Mean outward normal of the target's surroundings, unit, shape (n, 3).
        standoff_m: Distance of the scanner from the target [m].
        clearance_m: Least distance of the scanner from the part [m].
        tilt_max_rad: Largest tilt [rad].

    Returns:
        The repaired poses.
    """
    result = normals.copy()
    usable = clearance.usable(targets, normals, standoff_m, clearance_m)
    bad = np.flatnonzero(~usable)
    for step in range(1, _TILT_STEPS + 1):
        if len(bad) == 0:
            break
        tried = tilt_toward(normals[bad], bases[bad], tilt_max_rad * step / _TILT_STEPS)
        good = clearance.usable(targets[bad], tried, standoff_m, clearance_m)
        result[bad[good]] = tried[good]
        usable[bad[good]] = True
        bad = bad[~good]
    return Repair(result, usable, int(np.any(result != normals, axis=1).sum()))


def tilt_toward(normals: Array, bases: Array, angle_rad: Array | float) -> Array:
    """Turns unit vectors toward others by an angle, not beyond them.

    Args:
        normals: shape (n, 3).
        bases: shape (n, 3).
        angle_rad: Angle, shape (n,) or one number [rad].

    Returns:
        Unit vectors, shape (n, 3).
    """
    cosine = np.clip((normals * bases).sum(axis=1), -1.0, 1.0)
    side = bases - cosine[:, None] * normals
    length = np.linalg.norm(side, axis=1, keepdims=True)
    side = np.divide(side, length, out=np.zeros_like(side), where=length > 1e-9)
    angle = np.minimum(np.arccos(cosine), angle_rad)[:, None]
    turned = np.cos(angle) * normals + np.sin(angle) * side
    return turned / np.linalg.norm(turned, axis=1, keepdims=True)
