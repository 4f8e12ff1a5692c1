"""Whether arm and base move, and where they are: from joint states and odometry."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from skinplan.errors import SkinplanError
from skinplan.transforms import Array, difference
from skinplan_nodes.conversions import joint_state_from_msg, pose_from_msg, stamp_from_msg
from skinplan_nodes.draining import subscribe_draining
from skinplan_nodes.qos import STATE
from skinplan_nodes.supervisor.waiting import Waiter

# Slower than this is standing still: far above noise, far below any motion on purpose.
_JOINT_RAD_S, _BASE_M_S, _BASE_RAD_S = 0.005, 0.003, 0.003
# A device that tells nothing new for so long of wall time tells nothing about its motion [s].
_SILENT_S = 1.0
_APART_S = 0.03


class Motion:
    """Listens to ``joint_states`` and ``odom``; messages are taken apart only when asked for.

    Args:
        node: The supervisor.
        waiter: Waits for what devices tell.
    """

    def __init__(self, node: Node, waiter: Waiter) -> None:
        self._waiter = waiter
        self._joints: bytes | None = None
        self._odometry: bytes | None = None
        subscribe_draining(node, JointState, "joint_states", self._on_joints, STATE, raw=True)
        node.create_subscription(Odometry, "odom", self._on_odometry, STATE, raw=True)

    def joint_state(self) -> JointState:
        """Returns the newest joint state; without names = there was none."""
        raw = self._joints
        state: JointState = JointState() if raw is None else deserialize_message(raw, JointState)
        return state

    def joints(self) -> Array | None:
        """Returns where the arm stands, shape (6,) [rad]; None = not known."""
        try:
            return joint_state_from_msg(self.joint_state())[0]
        except SkinplanError:
            return None

    def base(self) -> Array | None:
        """Returns the base's pose in ``odom``, shape (4, 4) [m]; None = not known."""
        raw = self._odometry
        if raw is None:
            return None
        try:
            return pose_from_msg(deserialize_message(raw, Odometry).pose.pose)
        except SkinplanError:
            return None

    def joints_since(self, stamp_s: float) -> Array | None:
        """Returns where the arm stands at a time or later, shape (6,) [rad]; None = not known.

        Args:
            stamp_s: Time [s]; waited for as long as a device may be silent.
        """
        self._await(lambda: self._joints, JointState, stamp_s)
        return self.joints()

    def base_since(self, stamp_s: float) -> Array | None:
        """Returns the base's pose at a time or later, shape (4, 4) [m]; None = not known.

        Odometry on its way tells of a time when the base was still elsewhere.

        Args:
            stamp_s: Time [s]; waited for as long as a device may be silent.
        """
        self._await(lambda: self._odometry, Odometry, stamp_s)
        return self.base()

    def moving(self, timeout_s: float) -> str:
        """Waits until arm and base stand still.

        Args:
            timeout_s: Longest wait, wall time [s].

        Returns:
            What still moves, and how fast; empty = nothing, as far as they tell.
        """
        found = ""

        def stands() -> bool:
            nonlocal found
            seen = self._arm_moving() or self._base_moving()
            # A look that the end of the program cuts short tells nothing new.
            found = seen if seen or not self._waiter.is_over() else found
            return not found

        self._waiter.until(stands, timeout_s)
        return found

    def _arm_moving(self) -> str:
        if self._joints is None:
            return ""
        before = self.joint_state()
        later = self._newer(before, self.joint_state)
        if later is None:
            return ""
        try:
            change = joint_state_from_msg(later)[0] - joint_state_from_msg(before)[0]
        except SkinplanError:
            return ""
        speed = float(np.abs(change).max()) / _between(before, later)
        return f"the arm moves at {speed:.3f} rad/s" if speed > _JOINT_RAD_S else ""

    def _base_moving(self) -> str:
        def newest() -> Odometry:
            raw = self._odometry
            return Odometry() if raw is None else deserialize_message(raw, Odometry)

        if self._odometry is None:
            return ""
        before = newest()
        later = self._newer(before, newest)
        if later is None:
            return ""
        try:
            way, angle = difference(
                pose_from_msg(before.pose.pose), pose_from_msg(later.pose.pose)
            )[:2]
        except SkinplanError:
            return ""
        spent = _between(before, later)
        if way / spent > _BASE_M_S or angle / spent > _BASE_RAD_S:
            return f"the base moves at {way / spent:.3f} m/s"
        return ""

    def _await(self, newest: Callable[[], bytes | None], kind: Any, stamp_s: float) -> None:
        def told() -> bool:
            raw = newest()
            return raw is None or _stamp_s(deserialize_message(raw, kind)) >= stamp_s

        self._waiter.until(told, _SILENT_S)

    def _newer(self, before: Any, newest: Callable[[], Any]) -> Any:
        """Returns a message of a later time; None = none comes."""
        found = before

        def later() -> bool:
            nonlocal found
            found = newest()
            return _between(before, found) > _APART_S

        return found if self._waiter.until(later, _SILENT_S) else None

    def _on_joints(self, raw: bytes) -> None:
        self._joints = raw

    def _on_odometry(self, raw: bytes) -> None:
        self._odometry = raw


def distance_m(first: Array | None, second: Array | None) -> float:
    """Returns how far two poses are apart; NaN = one is not known [m]."""
    if first is None or second is None:
        return math.nan
    return float(difference(first, second)[0])


def _between(before: Any, later: Any) -> float:
    return _stamp_s(later) - _stamp_s(before)


def _stamp_s(message: Any) -> float:
    return stamp_from_msg(message.header.stamp)
