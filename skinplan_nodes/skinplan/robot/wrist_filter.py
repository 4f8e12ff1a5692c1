"""Which views can have inverse kinematics at all: a quick exact test in front of the solver.

For arms whose joints 2, 3 and 4 are parallel, at right angles to joint 1, with axes 4 and 5, and 5
and 6, crossing at right angles (UR, GCR and alike), the wrist's centre and the last axis follow
from the view alone. Joint 1 has two positions that bring the wrist's centre to its fixed offset
beside the shoulder; for each, axis 5 has two directions; the forearm's end then lies at a distance
from the shoulder that upper arm and forearm must be able to make.
"""

import numpy as np
from numpy.typing import NDArray

from skinplan.robot.arm import ArmModel
from skinplan.robot.dexterity import ELBOW_LEAST, WRIST_LEAST, joint_lines
from skinplan.transforms import Array, inverse

NONE, SINGULAR, SOME = 0, 1, 2
_EXACT = 1e-9
_SLACK = 1e-9  # on squared distances [m^2]: nothing that the solver would solve is left out


class WristFilter:
    """The test for one arm.

    Attributes:
        applies: The arm is of the kind described; otherwise every view passes.
        centre_tool0: Wrist centre in the flange frame, shape (3,) [m].
        axis_tool0: Last axis in the flange frame, shape (3,).
    """

    def __init__(self, arm: ArmModel) -> None:
        origins, axes = joint_lines(arm)
        T_tool0_base = inverse(arm.forward(np.zeros((1, 6)))[0])
        self.axis_tool0 = T_tool0_base[:3, :3] @ axes[5]
        gap5, centre = _crossing(origins[4], axes[4], origins[5], axes[5])
        gap4, _ = _crossing(origins[3], axes[3], centre, axes[4])
        self.centre_tool0 = T_tool0_base[:3, :3] @ centre + T_tool0_base[:3, 3]
        square = max(abs(axes[0] @ axes[1]), abs(axes[3] @ axes[4]), abs(axes[4] @ axes[5]))
        bent = max(np.linalg.norm(np.cross(axes[1], axes[k])) for k in (2, 3))
        self.applies = bool(max(gap4, gap5, square, bent) < _EXACT)
        # Coordinates about joint 1 at zero: along axis 2, across, up.
        self._frame = np.stack([axes[1], np.cross(axes[0], axes[1]), axes[0]])
        self._origin = origins[0]
        local = (np.vstack([origins, centre]) - origins[0]) @ self._frame.T
        self._offset = float(local[6, 0])
        self._shoulder = local[1, 1:]
        upper = np.linalg.norm((local[2] - local[1])[1:])
        fore = np.linalg.norm((local[3] - local[2])[1:])
        self._drop = float((centre - origins[3]) @ axes[4])
        self._sum, self._product = float(upper**2 + fore**2), float(2.0 * upper * fore)

    def grade(self, centres: Array, axes: Array) -> NDArray[np.int8]:
        """Tells for each view whether it has no solution, singular ones only, or some, (n,).

        Args:
            centres: Wrist centres in the arm base, shape (n, 3) [m].
            axes: Unit last axes in the arm base, shape (n, 3).
        """
        if not self.applies:
            return np.full(len(centres), SOME, dtype=np.int8)
        d, a = (centres - self._origin) @ self._frame.T, axes @ self._frame.T
        x, y, up = d[:, 0], d[:, 1], d[:, 2]
        square = x * x + y * y
        side = np.sqrt(np.maximum(square - self._offset**2, 0.0))
        possible = square >= self._offset**2 - _SLACK
        safe = np.maximum(square, 1e-12)
        best = np.full(len(d), NONE, dtype=np.int8)
        for sign in (1.0, -1.0):
            n_x = (self._offset * x - sign * side * y) / safe
            n_y = (self._offset * y + sign * side * x) / safe
            across = n_x * y - n_y * x
            a_across = n_x * a[:, 1] - n_y * a[:, 0]
            bend = np.sqrt(a_across**2 + a[:, 2] ** 2)  # sine of the angle between axes 4 and 6
            scale = self._drop / np.maximum(bend, 1e-9)
            for turn in (scale, -scale):
                u = across + turn * a[:, 2] - self._shoulder[0]
                v = up - turn * a_across - self._shoulder[1]
                reach = u * u + v * v - self._sum
                some = (np.abs(reach) <= self._product + _SLACK) | (bend < 1e-6)
                clear = np.abs(reach) <= self._product * np.sqrt(1.0 - ELBOW_LEAST**2) + _SLACK
                clear &= bend >= WRIST_LEAST - _SLACK
                found = np.where(clear & some, SOME, np.where(some, SINGULAR, NONE))
                np.maximum(best, np.where(possible, found, NONE).astype(np.int8), out=best)
        return best


def _crossing(point: Array, along: Array, other: Array, other_along: Array) -> tuple[float, Array]:
    """Distance of two lines, and the point of the first one nearest to the second."""
    normal = np.cross(along, other_along)
    square = float(normal @ normal)
    if square < _EXACT:
        return np.inf, point
    share = float(np.cross(other - point, other_along) @ normal) / square
    return abs(float((other - point) @ normal)) / np.sqrt(square), point + share * along
