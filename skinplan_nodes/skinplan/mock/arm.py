"""An arm that follows joint trajectories and refuses what the real one refuses (UR5, M4)."""

import logging
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skinplan.errors import InputError, JointsInvalidError, StartStateError
from skinplan.transforms import Array

log = logging.getLogger(__name__)

# Finished motions that are kept, so that a state of some seconds ago can still be asked for.
_HISTORY = 8
# The velocity limit is checked on the straight pieces between points that planners sampled.
_VELOCITY_SLACK = 1.05
_POSITION_SLACK_RAD = 1e-6


@dataclass(frozen=True, eq=False)
class _Motion:
    """Points in time, (n,) [s] from the start and (n, j) [rad]; before and after the arm stands."""

    start_s: float
    times: Array
    positions: Array

    @property
    def end_s(self) -> float:
        return self.start_s + float(self.times[-1])

    def at(self, now_s: float) -> tuple[Array, Array]:
        elapsed = now_s - self.start_s
        if elapsed <= self.times[0] or len(self.times) == 1:
            return self.positions[0].copy(), np.zeros(self.positions.shape[1])
        if elapsed >= self.times[-1]:
            return self.positions[-1].copy(), np.zeros(self.positions.shape[1])
        after = int(np.searchsorted(self.times, elapsed, side="right"))
        step = self.times[after] - self.times[after - 1]
        velocity = (self.positions[after] - self.positions[after - 1]) / step
        return self.positions[after - 1] + (elapsed - self.times[after - 1]) * velocity, velocity


class MockArm:
    """Straight joint motion between the points of a trajectory, exactly on time.

    Args:
        joint_names: Names of the joints, j of them.
        lower: Lower position limits, shape (j,) [rad].
        upper: Upper position limits, shape (j,) [rad].
        velocity_max_rad_s: Velocity limit of every joint [rad/s].
        home: Positions at the start, shape (j,) [rad].
        start_tolerance_rad: So far may the first point of a trajectory be from where the arm stands
            [rad].
    """

    def __init__(
        self,
        joint_names: Sequence[str],
        lower: ArrayLike,
        upper: ArrayLike,
        velocity_max_rad_s: float,
        home: ArrayLike,
        start_tolerance_rad: float = 0.02,
    ) -> None:
        self.joint_names = tuple(joint_names)
        self._lower = np.asarray(lower, dtype=float)
        self._upper = np.asarray(upper, dtype=float)
        self._velocity_max = float(velocity_max_rad_s)
        self._tolerance = float(start_tolerance_rad)
        start = np.asarray(home, dtype=float)
        count = len(self.joint_names)
        if not self._lower.shape == self._upper.shape == start.shape == (count,):
            raise JointsInvalidError(
                f"an arm of {count} joints takes as many limits and home positions, found "
                f"{self._lower.shape}, {self._upper.shape} and {start.shape}"
            )
        self._require_limits(start[None, :], self._lower, self._upper)
        self._motions: deque[_Motion] = deque(
            [_Motion(0.0, np.zeros(1), start[None, :])], maxlen=_HISTORY
        )

    def accept(
        self, joint_names: Sequence[str], times: ArrayLike, positions: ArrayLike, now_s: float
    ) -> None:
        """Takes a trajectory and starts it; a motion that is going on is replaced.

        Args:
            joint_names: Joints in the order of the columns; all of the arm's, in any order.
            times: From the start of the trajectory, rising, >= 0, shape (n,) [s].
            positions: shape (n, j) [rad].
            now_s: Time of the start [s].

        Raises:
            JointsInvalidError: Other joints than the arm's, or positions or velocities beyond the
                limits.
            InputError: No points, shapes that do not fit, values that are not finite, times that do
                not rise.
            StartStateError: The first point is due at once and too far from where the arm is.
        """
        order = self._order(joint_names)
        when, where = self._points(times, positions)
        where = where[:, order]
        self._require_limits(where, self._lower, self._upper)
        here = self.state(now_s)[0]
        if when[0] > 0.0:
            when, where = np.concatenate([[0.0], when]), np.vstack([here, where])
        self._require_start(here, where[0])
        self._require_velocity(when, where)
        where[0] = here  # within the tolerance: the arm does not jump
        self._motions.append(_Motion(float(now_s), when, where))
        log.debug("arm: %d points in %.2f s", len(when), when[-1])

    def state(self, now_s: float) -> tuple[Array, Array]:
        """Returns the state at a time, also one of the last seconds.

        Returns:
            Positions [rad] and velocities [rad/s], shape (j,) each.
        """
        for motion in reversed(self._motions):
            if motion.start_s <= now_s:
                return motion.at(now_s)
        return self._motions[0].at(now_s)

    def stop(self, now_s: float) -> None:
        """Holds the arm where it is; what was left of the trajectory is forgotten."""
        if self.done(now_s):
            return
        self._motions.append(_Motion(float(now_s), np.zeros(1), self.state(now_s)[0][None, :]))

    def done(self, now_s: float) -> bool:
        """Returns whether the last trajectory has ended."""
        return now_s >= self._motions[-1].end_s

    def remaining_s(self, now_s: float) -> float:
        """Returns the time until the last trajectory ends [s]."""
        return max(0.0, self._motions[-1].end_s - now_s)

    def _order(self, joint_names: Sequence[str]) -> list[int]:
        names = list(joint_names)
        if sorted(names) != sorted(self.joint_names):
            raise JointsInvalidError(
                f"a trajectory of joints {names} was asked, the arm has "
                f"{list(self.joint_names)}; each of them once is accepted"
            )
        return [names.index(name) for name in self.joint_names]

    def _points(self, times: ArrayLike, positions: ArrayLike) -> tuple[Array, Array]:
        try:
            when, where = np.asarray(times, dtype=float), np.asarray(positions, dtype=float)
        except (TypeError, ValueError):
            raise InputError(
                "a trajectory with points of different lengths was asked; equal ones are accepted"
            ) from None
        if when.ndim != 1 or len(when) == 0 or where.shape != (len(when), len(self.joint_names)):
            raise InputError(
                f"a trajectory takes n >= 1 times and (n, {len(self.joint_names)}) positions, "
                f"found {when.shape} and {where.shape}"
            )
        if not (np.all(np.isfinite(when)) and np.all(np.isfinite(where))):
            raise InputError(
                "a trajectory with values that are not finite was asked; finite ones are accepted"
            )
        if when[0] < 0.0 or np.any(np.diff(when) <= 0.0):
            at = int(np.argmax(np.diff(when, prepend=-1e-12) <= 0.0))
            raise InputError(
                f"times that rise from 0 or later are accepted, found {when[at]} s at point {at} "
                f"of a trajectory, after {when[at - 1] if at else 0.0} s"
            )
        return when, where

    def _require_limits(self, positions: Array, lower: Array, upper: Array) -> None:
        bad = (positions < lower - _POSITION_SLACK_RAD) | (positions > upper + _POSITION_SLACK_RAD)
        if np.any(bad):
            point, joint = np.argwhere(bad)[0]
            raise JointsInvalidError(
                f"{self.joint_names[joint]} at {positions[point, joint]:.4f} rad was asked at "
                f"point {point}; [{lower[joint]:.4f}, {upper[joint]:.4f}] is accepted"
            )

    def _require_start(self, here: Array, first: Array) -> None:
        away = np.abs(first - here)
        joint = int(np.argmax(away))
        if away[joint] > self._tolerance:
            raise StartStateError(
                f"the trajectory starts with {self.joint_names[joint]} at {first[joint]:.4f} rad, "
                f"the arm stands at {here[joint]:.4f}; at most {self._tolerance} rad away is "
                f"accepted"
            )

    def _require_velocity(self, times: Array, positions: Array) -> None:
        if len(times) < 2:
            return
        speed = np.abs(np.diff(positions, axis=0)) / np.diff(times)[:, None]
        if speed.max() > _VELOCITY_SLACK * self._velocity_max:
            point, joint = np.unravel_index(int(speed.argmax()), speed.shape)
            raise JointsInvalidError(
                f"{self.joint_names[joint]} with {speed[point, joint]:.3f} rad/s was asked after "
                f"point {point}; at most {self._velocity_max:.3f} rad/s is accepted"
            )
