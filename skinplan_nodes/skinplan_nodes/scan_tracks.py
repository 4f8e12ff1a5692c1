"""Where scanner and arm were at a time. Needs no ROS but the conversions' types."""

import math
from collections import deque
from collections.abc import Callable

from skinplan.robot.arm import ArmModel
from skinplan.transforms import Array, inverse
from skinplan_nodes.conversions import LocatedPart

# Stamps nearer than this are one moment.
_SAME_MOMENT_S = 0.005
_HISTORY = 4000
# Between joint positions farther apart nothing is known [s].
_GAP_S = 0.1
# Poses may overtake each other by so much.
_DISORDER_S = 0.25


class Tracks:
    """The latest scanner poses and joint positions by time; needs no lock of its own.

    Args:
        arm: The arm.
        positions_of: Takes a serialised joint state apart, when it is needed: there are many of
            them; returns positions, shape (6,) [rad], or None when it can't be used.
    """

    def __init__(self, arm: ArmModel, positions_of: Callable[[bytes], Array | None]) -> None:
        self._arm = arm
        self._positions_of = positions_of
        self._joints: deque[tuple[float, bytes]] = deque(maxlen=_HISTORY)
        self._poses: deque[tuple[float, Array]] = deque(maxlen=_HISTORY)
        self.located: LocatedPart | None = None

    def add_joints(self, stamp_s: float, state: bytes) -> None:
        """Takes a serialised joint state."""
        self._joints.append((stamp_s, state))

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

    def joints_passed(self, stamp_s: float) -> bool:
        """Tells whether no joint positions of that time will come any more."""
        return bool(self._joints) and self._joints[-1][0] > stamp_s + _DISORDER_S

    def joints(self, stamp_s: float) -> Array | None:
        """Returns the joint positions at a time, linear between two; None = not known."""
        after: tuple[float, bytes] | None = None
        for at, state in reversed(self._joints):
            if at <= stamp_s + 1e-9:
                if stamp_s - at < 1e-6:
                    return self._positions_of(state)
                return None if after is None else self._between((at, state), after, stamp_s)
            after = (at, state)
        return None

    def _between(
        self, before: tuple[float, bytes], after: tuple[float, bytes], stamp_s: float
    ) -> Array | None:
        if after[0] - before[0] > _GAP_S:
            return None
        first, last = self._positions_of(before[1]), self._positions_of(after[1])
        if first is None or last is None:
            return None
        return first + (stamp_s - before[0]) / (after[0] - before[0]) * (last - first)

    def coarse(self, stamp_s: float) -> Array | None:
        """Returns ``T_tracker_workpiece`` by arm and localisation at a time; None = not known."""
        T_tracker_scanner, q = self.scanner(stamp_s), self.joints(stamp_s)
        if T_tracker_scanner is None or q is None or self.located is None:
            return None
        T_arm_base_scanner = self._arm.forward_scanner(q[None, :])[0]
        return T_tracker_scanner @ inverse(T_arm_base_scanner) @ self.located.T_arm_base_workpiece
