"""Eq (1): from the camera to the workpiece in the arm base, covariance carried along."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.localization.model import WorkpiecePose
from skinplan.transforms import Array, difference


@dataclass(frozen=True, eq=False)
class LocatedPart:
    """Where the part is, as seen from one stand of the base.

    Attributes:
        T_arm_base_workpiece: shape (4, 4) [m].
        covariance: shape (6, 6), x y z [m] rx ry rz [rad] in arm_base.
        quality: E of eq (3).
        reprojection_error_px: Root mean square over all corners used [px].
        marker_ids: Markers used, shape (m,).
        stamp_s: Time of the image [s].
    """

    T_arm_base_workpiece: Array
    covariance: Array
    quality: float
    reprojection_error_px: float
    marker_ids: NDArray[np.int64]
    stamp_s: float

    @classmethod
    def from_camera(
        cls,
        pose: WorkpiecePose,
        T_arm_base_camera: Array,
        stamp_s: float,
        mounting_error_m: float = 0.0,
        mounting_error_rad: float = 0.0,
    ) -> "LocatedPart":
        """Maps a pose from the camera's optical frame to the arm base, eq (1).

        Args:
            pose: In the optical frame.
            T_arm_base_camera: Hand-eye calibration, shape (4, 4) [m].
            stamp_s: Time of the image [s].
            mounting_error_m: Standard deviation of its translation, each axis [m].
            mounting_error_rad: Standard deviation of its rotation, each axis [rad].
        """
        T_arm_base_workpiece = T_arm_base_camera @ pose.T_camera_workpiece
        turn = np.kron(np.eye(2), T_arm_base_camera[:3, :3])
        covariance = turn @ pose.covariance @ turn.T
        # A turn of the camera moves the workpiece by the lever between the two.
        x, y, z = T_arm_base_workpiece[:3, 3] - T_arm_base_camera[:3, 3]
        carried = np.eye(6)
        carried[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
        squares = [mounting_error_m**2] * 3 + [mounting_error_rad**2] * 3
        covariance = covariance + carried @ np.diag(squares) @ carried.T
        return cls(
            T_arm_base_workpiece,
            covariance,
            pose.quality,
            pose.reprojection_error_px,
            pose.marker_ids,
            stamp_s,
        )


def moved_by(T_a_before: Array, T_a_now: Array, bound_m: float, bound_rad: float) -> str:
    """Says how far a part has moved, where that is more than a bound; empty = it has not.

    Args:
        T_a_before: Where it was, shape (4, 4) [m].
        T_a_now: Where it is, shape (4, 4) [m].
        bound_m: Largest distance that is none [m].
        bound_rad: Largest turn that is none [rad].
    """
    distance, angle = difference(T_a_before, T_a_now)
    if distance <= bound_m and angle <= bound_rad:
        return ""
    return (
        f"it is {distance:.3f} m and {np.degrees(angle):.1f} deg from where it was; up to "
        f"{bound_m:g} m and {np.degrees(bound_rad):.1f} deg are accepted"
    )
