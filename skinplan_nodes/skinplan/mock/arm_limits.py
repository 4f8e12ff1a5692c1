"""What an arm takes as a trajectory, and a reason for everything else."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from skinplan.errors import InputError, JointsInvalidError, StartStateError
from skinplan.transforms import Array

# The velocity limit is checked on the pieces between points that planners sampled.
_VELOCITY_SLACK = 1.05
_POSITION_SLACK_RAD = 1e-6


class ArmLimits:
    """Joints and limits of an arm.

    Args:
        joint_names: Names of the joints, j of them.
        lower: Lower position limits, shape (j,) [rad].
        upper: Upper position limits, shape (j,) [rad].
        velocity_max_rad_s: Velocity limit of every joint, or one for all [rad/s].
        start_tolerance_rad: So far may the first point of a trajectory be from where the arm stands
            [rad].

    Raises:
        JointsInvalidError: Not as many limits as joints.
    """

    def __init__(
        self,
        joint_names: Sequence[str],
        lower: ArrayLike,
        upper: ArrayLike,
        velocity_max_rad_s: ArrayLike,
        start_tolerance_rad: float,
    ) -> None:
        self.joint_names = tuple(joint_names)
        self.lower = np.asarray(lower, dtype=float)
        self.upper = np.asarray(upper, dtype=float)
        count = len(self.joint_names)
        if not self.lower.shape == self.upper.shape == (count,):
            raise JointsInvalidError(
                f"an arm of {count} joints takes as many limits, found {self.lower.shape} and "
                f"{self.upper.shape}"
            )
        self.velocity = np.broadcast_to(np.asarray(velocity_max_rad_s, dtype=float), (count,))
        self._tolerance = float(start_tolerance_rad)

    def order(self, joint_names: Sequence[str]) -> list[int]:
        """Returns which column is which joint; every joint has to be there once."""
        names = list(joint_names)
        if sorted(names) != sorted(self.joint_names):
            raise JointsInvalidError(
                f"a trajectory of joints {names} was asked, the arm has "
                f"{list(self.joint_names)}; each of them once is accepted"
            )
        return [names.index(name) for name in self.joint_names]

    def points(
        self, times: ArrayLike, positions: ArrayLike, velocities: ArrayLike | None
    ) -> tuple[Array, Array, Array | None]:
        """Returns times, positions and velocities as arrays that fit together.

        Raises:
            InputError: No points, shapes that do not fit, values that are not finite, times that do
                not rise.
        """
        when, where = _array(times), _array(positions)
        speeds = None if velocities is None else _array(velocities)
        shape = (len(when) if when.ndim == 1 else -1, len(self.joint_names))
        if when.ndim != 1 or len(when) == 0 or where.shape != shape:
            raise InputError(
                f"a trajectory takes n >= 1 times and (n, {len(self.joint_names)}) positions, "
                f"found {when.shape} and {where.shape}"
            )
        if speeds is not None and speeds.shape != shape:
            raise InputError(
                f"a trajectory takes as many velocities as positions, {shape}, or none, found "
                f"{speeds.shape}"
            )
        if not all(np.all(np.isfinite(each)) for each in (when, where, speeds) if each is not None):
            raise InputError(
                "a trajectory with values that are not finite was asked; finite ones are accepted"
            )
        if when[0] < 0.0 or np.any(np.diff(when) <= 0.0):
            at = int(np.argmax(np.diff(when, prepend=-1e-12) <= 0.0))
            raise InputError(
                f"times that rise from 0 or later are accepted, found {when[at]} s at point {at} "
                f"of a trajectory, after {when[at - 1] if at else 0.0} s"
            )
        return when, where, speeds

    def require_positions(self, positions: Array) -> None:
        """Raises `JointsInvalidError` where positions, shape (n, j) [rad], are beyond limits."""
        lower, upper = self.lower, self.upper
        bad = (positions < lower - _POSITION_SLACK_RAD) | (positions > upper + _POSITION_SLACK_RAD)
        if np.any(bad):
            point, joint = np.argwhere(bad)[0]
            raise JointsInvalidError(
                f"{self.joint_names[joint]} at {positions[point, joint]:.4f} rad was asked at "
                f"point {point}; [{lower[joint]:.4f}, {upper[joint]:.4f}] is accepted"
            )

    def require_start(self, here: Array, first: Array) -> None:
        """Raises `StartStateError` where the first point is too far from where the arm is."""
        away = np.abs(first - here)
        joint = int(np.argmax(away))
        if away[joint] > self._tolerance:
            raise StartStateError(
                f"the trajectory starts with {self.joint_names[joint]} at {first[joint]:.4f} rad, "
                f"the arm stands at {here[joint]:.4f}; at most {self._tolerance} rad away is "
                f"accepted"
            )

    def require_speeds(self, speeds: Array) -> None:
        """Raises `JointsInvalidError` where speeds between points, (n, j) [rad/s], are too high."""
        excess = speeds / self.velocity
        if excess.size and excess.max() > _VELOCITY_SLACK:
            point, joint = np.unravel_index(int(excess.argmax()), excess.shape)
            raise JointsInvalidError(
                f"{self.joint_names[joint]} with {speeds[point, joint]:.3f} rad/s was asked after "
                f"point {point}; at most {self.velocity[joint]:.3f} rad/s is accepted"
            )


def _array(values: ArrayLike) -> Array:
    try:
        return np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(
            "a trajectory with points of different lengths was asked; equal ones are accepted"
        ) from None
