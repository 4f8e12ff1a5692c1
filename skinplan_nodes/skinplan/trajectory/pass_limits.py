"""The constraints (a) to (d) that keep a scan pass usable (T S3)."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import InputError
from skinplan.mesh.model import SurfaceMesh
from skinplan.part.model import ScanSettings
from skinplan.scan_path.clearance import Clearance
from skinplan.scanner.model import ScannerModel
from skinplan.scanner.rays import RayCaster
from skinplan.trajectory.pass_error import PassSettings, effective_width
from skinplan.trajectory.pass_poses import DEPTH, IN_PLANE, OUT_OF_PLANE, Indices, PassPoses
from skinplan.transforms import Array

Feasible = Callable[[Array, Array], NDArray[np.bool_]]

NOT_FEASIBLE = "the robot can't make the motion"
TOO_NARROW = "the effective scan width would not exceed the distance of the passes"
TOO_OBLIQUE = "an angle or depth would be out of the scanner's limits"

_EPS = 1e-9
_EPS_TILT_RAD = 1e-6  # the arc cosine is not exact near 0


class PassLimits:
    """Says which constraint a move of a pass breaks.

    Attributes:
        depths_m: Least and greatest depth, the range less its margin [m].
        angle_max_rad: Greatest angle out of and in the plane, the incidence limit less its margin.

    Args:
        poses: The poses before any move.
        settings: Scanner, margins and tilt limit.
        spacing_m: Distance of each point from the neighbouring pass, shape (n,) [m].
    """

    def __init__(self, poses: PassPoses, settings: ScanSettings, spacing_m: Array) -> None:
        self._poses, self._spacing = poses, spacing_m
        self._scanner = ScannerModel.from_settings(settings)
        self._tilt_max_rad = settings.tilt_max_rad
        self.angle_max_rad = settings.incidence_max_rad - settings.incidence_margin_rad
        self.depths_m = (
            settings.range_min_m + settings.field_margin_m,
            settings.range_max_m - settings.field_margin_m,
        )

    def broken(
        self,
        which: Indices,
        values: Array,
        positions: Array,
        directions: Array,
        before: Array,
        feasible: Feasible,
    ) -> str:
        """Returns the constraint that moved poses break, as a reason; empty = none.

        Args:
            which: Their numbers, shape (k,).
            values: Depths and angles after the move, as `PassPoses.values`, shape (3, k).
            positions: Scanner origins after it, shape (k, 3) [m].
            directions: Unit view directions after it, shape (k, 3).
            before: Unit view directions before it, shape (k, 3).
            feasible: Constraint (a).
        """
        if not self._within_scanner(which, values, directions, before):
            return TOO_OBLIQUE
        normals, across = self._poses.normals[which], self._poses.across[which]
        width = effective_width(values[DEPTH], -directions, normals, across, self._scanner)
        if not (width > self._spacing[which]).all():
            return TOO_NARROW
        able = np.asarray(feasible(positions, directions), dtype=bool)
        if able.shape != (len(which),):
            raise InputError(
                f"pass optimisation: feasible was asked about {len(which)} poses; an answer of "
                f"shape ({len(which)},) is accepted, found {able.shape}"
            )
        return "" if able.all() else NOT_FEASIBLE

    def _within_scanner(
        self, which: Indices, values: Array, directions: Array, before: Array
    ) -> bool:
        depth, angles = values[DEPTH], np.abs(values[[IN_PLANE, OUT_OF_PLANE]])
        low, high = self.depths_m
        tilt = self._tilt(which, directions)
        most = np.maximum(self._tilt(which, before), self._tilt_max_rad)
        return bool(
            (angles <= self.angle_max_rad + _EPS).all()
            and (depth >= low - _EPS).all()
            and (depth <= high + _EPS).all()
            and (tilt <= most + _EPS_TILT_RAD).all()
        )

    def _tilt(self, which: Indices, directions: Array) -> Array:
        cosine = -np.einsum("ij,ij->i", directions, self._poses.normals[which])
        return np.arccos(np.clip(cosine, -1.0, 1.0))


def clear_of(mesh: SurfaceMesh, settings: ScanSettings, caster: RayCaster) -> Feasible:
    """Returns a constraint (a) without a robot: clear of the part, nothing nearer than d_min ahead.

    Args:
        mesh: The part.
        settings: Clearance and range.
        caster: Rays against the part and what stands about it.
    """
    clearance = Clearance(mesh, caster)

    def feasible(positions: Array, directions: Array) -> NDArray[np.bool_]:
        ahead, _ = caster.hits(positions, directions)
        far = clearance.distance(positions) >= settings.clearance_m - _EPS
        return np.asarray(far & (ahead >= settings.range_min_m - _EPS))

    return feasible


def require_reachable(options: PassSettings, settings: ScanSettings) -> None:
    """Makes sure that the best angles are within the settings' limits.

    Raises:
        InputError: They are not.
    """
    most = min(settings.incidence_max_rad - settings.incidence_margin_rad, settings.tilt_max_rad)
    for name in ("best_out_of_plane_rad", "best_in_plane_rad"):
        if getattr(options, name) > most + _EPS:
            raise InputError(
                f"pass optimisation: {name} of {getattr(options, name):.4g} rad was asked for; "
                f"accepted is up to {most:.4g} rad, the least of the settings' tilt and incidence"
            )
