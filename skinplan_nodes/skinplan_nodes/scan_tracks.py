"""Where scanner and arm were at a time. Needs no ROS but the conversions' types."""

import math
from collections import deque

from skinplan.robot.arm import ArmModel
from skinplan.transforms import Array, inverse
from skinplan_nodes.conversions import LocatedPart

# Stamps nearer than this are one moment.
_SAME_MOMENT_S = 0.005
_HISTORY = 2000
# Poses may overtake each other by so much.
_DISORDER_S = 0.25


class Tracks:
    """The latest scanner poses and joint positions by time; needs no lock of its own.

    Args:
        arm: The arm.
    """

    def __init__(self, arm: ArmModel) -> None:
        self._arm = arm
        self._joints: deque[tuple[float, Array]] = deque(maxlen=_HISTORY)
        self._poses: deque[tuple[float, Array]] = deque(maxlen=_HISTORY)
        self.located: LocatedPart | None = None

    def add_joints(self, stamp_s: float, positions: Array) -> None:
        """Takes joint positions, shape (6,) [rad]."""
        self._joints.append((stamp_s, positions))

    def add_pose(self, stamp_s: float, T_tracker_scanner: Array) -> None:
        """Takes a scanner pose, shape (4, 4) [m]."""
        self._poses.append((stamp_s, T_tracker_scanner))

    def scanner(self, stamp_s: float) -> Array | None:
        """Returns ``T_tracker_scanner`` at a time; None = not known."""
        return next(
            (T for at, T in reversed(self._poses) if abs(at - stamp_s) < _SAME_MOMENT_S), None
        )

    def newest_s(self) -> float:
        """Returns the time of the newest scanner pose [s]; -inf = none."""
        return self._poses[-1][0] if self._poses else -math.inf

    def reached_s(self, seen: bool) -> float:
        """Returns up to when joint positions, and scanner poses while it is seen, have come [s]."""
        stamps = [self._joints[-1][0]] if self._joints else []
        if seen and self._poses:
            stamps.append(self._poses[-1][0])
        return min(stamps, default=0.0)

    def forget(self) -> None:
        """Forgets where scanner and arm were: the clock was set back, the times mean nothing."""
        self._joints.clear()
        self._poses.clear()

    def passed(self, stamp_s: float) -> bool:
        """Tells whether no pose of that time will come any more: much later ones are there."""
        return bool(self._poses) and self._poses[-1][0] > stamp_s + _DISORDER_S

    def joints(self, stamp_s: float) -> Array | None:
        """Returns the joint positions at a time, linear between two; None = not known."""
        after = None
        for at, positions in reversed(self._joints):
            if at <= stamp_s + 1e-9:
                if stamp_s - at < 1e-6:
                    return positions
                if after is None or after[0] - at > 0.1:
                    return None
                share = (stamp_s - at) / (after[0] - at)
                return positions + share * (after[1] - positions)
            after = (at, positions)
        return None

    def coarse(self, stamp_s: float) -> Array | None:
        """Returns ``T_tracker_workpiece`` by arm and localisation at a time; None = not known."""
        T_tracker_scanner, q = self.scanner(stamp_s), self.joints(stamp_s)
        if T_tracker_scanner is None or q is None or self.located is None:
            return None
        T_arm_base_scanner = self._arm.forward_scanner(q[None, :])[0]
        return T_tracker_scanner @ inverse(T_arm_base_scanner) @ self.located.T_arm_base_workpiece
