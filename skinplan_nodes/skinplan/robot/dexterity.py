"""How far an arm is from its singular positions: elbow and wrist (a measure for any six-axis arm).

Elbow: the sine of the angle between the upper arm and the forearm, seen along the elbow's axis; 0
when the arm is stretched or folded. Wrist: the sine of the angle between the axes of joints 4 and
6; 0 when they are parallel and turn the tool alike. For a UR5 these are ``|sin q3|`` and
``|sin q5|``.
"""

import numpy as np
from numpy.typing import NDArray

from skinplan.robot.arm import ArmModel
from skinplan.transforms import Array

ELBOW_LEAST = 0.15
WRIST_LEAST = 0.10
_PARALLEL = 1e-9


class Dexterity:
    """Measures of one arm.

    Attributes:
        has_elbow: Joints 2 and 3 are parallel; otherwise the elbow's measure is 1 throughout.
    """

    def __init__(self, arm: ArmModel) -> None:
        origins, axes = joint_lines(arm)
        self._arm = arm
        # Across the first two axes, in the frame that turns with the first joint.
        self._before = arm.links(np.zeros((1, 6)))[0, 1, :3, :3].T @ np.cross(axes[0], axes[1])
        self.has_elbow = bool(np.linalg.norm(np.cross(axes[1], axes[2])) < _PARALLEL)
        upper = origins[2] - origins[1]
        # Where joint 4 is parallel too its axis is the forearm's end, else the wrist's centre is.
        parallel = np.linalg.norm(np.cross(axes[2], axes[3])) < _PARALLEL
        fore = (origins[3] if parallel else origins[4]) - origins[2]
        self._elbow_phase = _angle_about(axes[2], upper, fore)
        # Axis 6 turns about axis 5: its part across axis 5 and the part along it.
        a4, a5, a6 = axes[3], axes[4], axes[5]
        self._along = float((a4 @ a5) * (a5 @ a6))
        across4, across6 = a4 - (a4 @ a5) * a5, a6 - (a6 @ a5) * a5
        self._across = float(np.linalg.norm(across4) * np.linalg.norm(across6))
        self._wrist_phase = _angle_about(a5, across4, across6)

    def shoulder(self, q: Array) -> Array:
        """Returns how far the wrist is before (+) or behind (-) the first axis, shape (n,) [m]."""
        frames = self._arm.links(q)
        gap = frames[:, 5, :3, 3] - frames[:, 1, :3, 3]
        return np.asarray(np.einsum("ni,ni->n", gap, frames[:, 1, :3, :3] @ self._before))

    def elbow(self, q: Array) -> Array:
        """Returns the elbow's measure of joint positions, (n, 6) [rad], in [0, 1], shape (n,)."""
        if not self.has_elbow:
            return np.ones(len(q))
        return np.abs(np.sin(q[:, 2] + self._elbow_phase))

    def wrist(self, q: Array) -> Array:
        """Returns the wrist's measure of joint positions, (n, 6) [rad], in [0, 1], shape (n,)."""
        cosine = self._along + self._across * np.cos(q[:, 4] + self._wrist_phase)
        return np.sqrt(np.maximum(0.0, 1.0 - cosine**2))

    def measure(self, q: Array) -> Array:
        """Returns the smaller of both, shape (n,)."""
        return np.minimum(self.elbow(q), self.wrist(q))

    def branches(self, q: Array) -> NDArray[np.int64]:
        """Returns a number for the sides of the singular positions that q are on, shape (n,).

        Positions with different numbers can't be joined without passing a singular position of
        shoulder, elbow or wrist.
        """
        result = np.asarray(4 * (self.shoulder(q) > 0.0), dtype=np.int64)
        if self.has_elbow:
            result += np.sin(q[:, 2] + self._elbow_phase) > 0.0
        if abs(self._along) < _PARALLEL:
            # The sine's zeros are the singular positions only where axis 5 is across both others.
            result += 2 * (np.sin(q[:, 4] + self._wrist_phase) > 0.0)
        return result

    def clear(self, q: Array) -> NDArray[np.bool_]:
        """Tells which joint positions are far enough from singular ones, shape (n,)."""
        return (self.elbow(q) >= ELBOW_LEAST) & (self.wrist(q) >= WRIST_LEAST)


def joint_lines(arm: ArmModel) -> tuple[Array, Array]:
    """Returns points on the joint axes and their unit directions at zero, each (6, 3), arm base."""
    frames = arm.links(np.zeros((1, 6)))[0, 1:]
    return frames[:, :3, 3], np.einsum("jab,jb->ja", frames[:, :3, :3], arm.axes)


def _angle_about(axis: Array, first: Array, second: Array) -> float:
    """Angle from one vector to another about a unit axis [rad]."""
    a, b = first - (first @ axis) * axis, second - (second @ axis) * axis
    return float(np.arctan2(axis @ np.cross(a, b), a @ b))
