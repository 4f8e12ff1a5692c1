"""An arm that follows joint trajectories and refuses what the real one refuses (UR5, M4)."""

import logging
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike

from skinplan.errors import InputError, JointsInvalidError
from skinplan.mock.arm_limits import ArmLimits
from skinplan.mock.arm_motion import ArmMotion
from skinplan.transforms import Array

log = logging.getLogger(__name__)

# Finished motions that are kept, so that a state of some seconds ago can still be asked for.
_HISTORY = 8
_DECELERATION_RAD_S2 = 5.0


class Ending(Enum):
    """How a trajectory ends."""

    REACHED = "reached"
    PATH_VIOLATED = "path tolerance violated"
    GOAL_VIOLATED = "goal tolerance violated"


@dataclass(frozen=True, eq=False)
class Tolerances:
    """How far the arm may be from where it should be; inf = no limit.

    Attributes:
        path: While it moves, shape (j,) [rad].
        path_velocity: While it moves, shape (j,) [rad/s].
        goal: At the end, shape (j,) [rad].
        goal_velocity: At the end, shape (j,) [rad/s].
        goal_time_s: So much later than planned may it get there [s].
    """

    path: Array
    path_velocity: Array
    goal: Array
    goal_velocity: Array
    goal_time_s: float

    @classmethod
    def same(
        cls, joints: int, path: float = 0.2, goal: float = 0.1, goal_time_s: float = 0.6
    ) -> "Tolerances":
        """The same for all joints; velocities without limit."""
        none = np.full(joints, np.inf)
        return cls(np.full(joints, path), none, np.full(joints, goal), none, goal_time_s)


class MockArm:
    """Joint motion along a trajectory in time; every state is a closed form of the time.

    Args:
        joint_names: Names of the joints, j of them.
        lower: Lower position limits, shape (j,) [rad].
        upper: Upper position limits, shape (j,) [rad].
        velocity_max_rad_s: Velocity limit of every joint, or one for all [rad/s].
        home: Positions at the start, shape (j,) [rad].
        start_tolerance_rad: So far may the first point of a trajectory be from where the arm stands
            [rad].
        repeatability_rad: A motion ends at most so far beside its goal, shape (j,) [rad].
        deceleration_rad_s2: Of a stop, the fastest joint [rad/s^2].
        seed: Of where motions end.
    """

    def __init__(
        self,
        joint_names: Sequence[str],
        lower: ArrayLike,
        upper: ArrayLike,
        velocity_max_rad_s: ArrayLike,
        home: ArrayLike,
        start_tolerance_rad: float = 0.02,
        repeatability_rad: ArrayLike = 0.0,
        deceleration_rad_s2: float = _DECELERATION_RAD_S2,
        seed: int = 0,
    ) -> None:
        self._limits = ArmLimits(joint_names, lower, upper, velocity_max_rad_s, start_tolerance_rad)
        self.joint_names = self._limits.joint_names
        start = np.asarray(home, dtype=float)
        count = len(self.joint_names)
        if start.shape != (count,):
            raise JointsInvalidError(
                f"an arm of {count} joints takes as many home positions, found {start.shape}"
            )
        self._limits.require_positions(start[None, :])
        self._repeatability = np.broadcast_to(np.asarray(repeatability_rad, dtype=float), (count,))
        self._deceleration = float(deceleration_rad_s2)
        self._random = np.random.default_rng([seed, 0xA53])
        self._rate = 1.0
        self._stuck = False
        self._tolerances = Tolerances.same(count)
        self._motions: deque[ArmMotion] = deque([ArmMotion.hold(0.0, start)], maxlen=_HISTORY)

    def accept(
        self,
        joint_names: Sequence[str],
        times: ArrayLike,
        positions: ArrayLike,
        now_s: float,
        velocities: ArrayLike | None = None,
        tolerances: Tolerances | None = None,
    ) -> None:
        """Takes a trajectory and starts it; a motion that is going on is replaced.

        Args:
            joint_names: Joints in the order of the columns; all of the arm's, in any order.
            times: From the start of the trajectory, rising, >= 0, shape (n,) [s].
            positions: shape (n, j) [rad].
            now_s: Time of the start [s].
            velocities: shape (n, j) [rad/s]; None = straight between the points.
            tolerances: In the arm's order of joints; None = the default ones.

        Raises:
            JointsInvalidError: Other joints than the arm's, or positions or velocities beyond the
                limits.
            InputError: No points, shapes that do not fit, values that are not finite, times that do
                not rise.
            StartStateError: The first point is due at once and too far from where the arm is.
        """
        order = self._limits.order(joint_names)
        when, where, speeds = self._limits.points(times, positions, velocities)
        where, speeds = where[:, order], None if speeds is None else speeds[:, order]
        self._limits.require_positions(where)
        here = self.state(now_s)[0]
        if when[0] > 0.0:
            when, where = np.concatenate([[0.0], when]), np.vstack([here, where])
            speeds = None if speeds is None else np.vstack([np.zeros(len(here)), speeds])
        self._limits.require_start(here, where[0])
        motion = ArmMotion(float(now_s), when, where, speeds, self._offset(where[-1]), self._rate)
        self._limits.require_speeds(motion.speeds)
        where[0] = here  # within the tolerance: the arm does not jump
        if self._stuck:
            motion.actual = motion.actual.copy()
            motion.actual.change(now_s, 0.0, 0.0)
        self._motions.append(motion)
        count = len(self.joint_names)
        self._tolerances = Tolerances.same(count) if tolerances is None else tolerances
        log.debug("arm: %d points in %.2f s", len(when), when[-1])

    def place(self, positions: ArrayLike, now_s: float) -> None:
        """Puts the arm somewhere, shape (j,) [rad]; it stands there.

        Raises:
            JointsInvalidError: Beyond the limits.
        """
        where = np.asarray(positions, dtype=float)
        self._limits.require_positions(where[None, :])
        self._motions.clear()
        self._motions.append(ArmMotion.hold(float(now_s), where))

    def state(self, now_s: float) -> tuple[Array, Array]:
        """Returns the state at a time, also one of the last seconds.

        Returns:
            Positions [rad] and velocities [rad/s], shape (j,) each.
        """
        positions, velocities = self.states(np.array([now_s]))
        return positions[0], velocities[0]

    def states(self, times: Array) -> tuple[Array, Array]:
        """Returns the states at many times, (n,) [s]: (n, j) [rad] and (n, j) [rad/s]."""
        starts = np.array([motion.start_s for motion in self._motions])
        number = np.clip(np.searchsorted(starts, times, "right") - 1, 0, None)
        positions = np.empty((len(times), len(self.joint_names)))
        velocities = np.empty_like(positions)
        for each in np.unique(number):
            here = number == each
            positions[here], velocities[here] = self._motions[int(each)].at(times[here])
        return positions, velocities

    def desired(self, now_s: float) -> tuple[Array, Array]:
        """Returns where the controller believes the arm to be, (j,) [rad] and [rad/s]."""
        positions, velocities = self._motions[-1].desired(np.array([now_s]))
        return positions[0], velocities[0]

    def ending(self, now_s: float) -> tuple[Ending, str] | None:
        """Returns how the trajectory ends, with one sentence; None = it goes on."""
        motion, limits = self._motions[-1], self._tolerances
        where, speed = self.state(now_s)
        wanted, wanted_speed = self.desired(now_s)
        progress, rate = motion.commanded.at(now_s)
        if progress < motion.length_s:
            late = self._beyond(where - wanted, limits.path, "rad")
            late = late or self._beyond(speed - wanted_speed, limits.path_velocity, "rad/s")
            return (Ending.PATH_VIOLATED, late) if late else None
        late = self._beyond(where - wanted, limits.goal, "rad")
        late = late or self._beyond(speed - wanted_speed, limits.goal_velocity, "rad/s")
        if not late:
            return Ending.REACHED, ""
        if progress > motion.length_s + limits.goal_time_s:
            return Ending.GOAL_VIOLATED, f"{late}, {progress - motion.length_s:.2f} s late"
        return None

    def set_speed(self, rate: float, now_s: float) -> None:
        """Scales the speed of this and all later motions; 1 = as planned, 0 = stands.

        Raises:
            InputError: Not within 0 to 1.
        """
        if not 0.0 <= rate <= 1.0:
            raise InputError(f"a speed scaling from 0 to 1 is accepted, found {rate}")
        self._rate = float(rate)
        motion = self._motions[-1]
        if self.done(now_s):
            return
        ramp_s = motion.ramp_s(motion.commanded, now_s, rate, self._deceleration)
        follows = motion.actual is motion.commanded
        motion.commanded.change(now_s, rate, ramp_s)
        if not follows and not self._stuck:
            motion.actual = motion.commanded

    @property
    def speed(self) -> float:
        """Speed scaling, 0 to 1."""
        return self._rate

    def stick(self, now_s: float) -> None:
        """The arm stands, while the controller believes that it follows."""
        self._stuck = True
        motion = self._motions[-1]
        if not self.done(now_s):
            motion.actual = motion.actual.copy()
            ramp_s = motion.ramp_s(motion.actual, now_s, 0.0, self._deceleration)
            motion.actual.change(now_s, 0.0, ramp_s)

    def release(self) -> None:
        """Ends `stick`: the next trajectory is followed."""
        self._stuck = False

    def stop(self, now_s: float) -> None:
        """Brakes along the path, bounded; what is left of the trajectory is forgotten."""
        motion = self._motions[-1]
        if self.done(now_s):
            return
        ramp_s = motion.ramp_s(motion.actual, now_s, 0.0, self._deceleration)
        motion.actual.change(now_s, 0.0, ramp_s)
        motion.commanded, motion.stopped = motion.actual, True

    def done(self, now_s: float) -> bool:
        """Returns whether the arm stands: the trajectory has ended, or was stopped."""
        return now_s >= self._motions[-1].done_s()

    def moving(self, now_s: float) -> bool:
        """Returns whether the arm moves at a time."""
        return bool(np.any(self.state(now_s)[1] != 0.0))

    def remaining_s(self, now_s: float) -> float:
        """Returns the time until the arm stands [s]; inf = its speed is scaled to 0."""
        return max(0.0, self._motions[-1].done_s() - now_s)

    def _offset(self, end: Array) -> Array:
        drawn = self._repeatability * self._random.uniform(-1.0, 1.0, len(end))
        return np.clip(end + drawn, self._limits.lower, self._limits.upper) - end

    def _beyond(self, error: Array, limit: Array, unit: str) -> str:
        excess = np.abs(error) - limit
        joint = int(np.argmax(excess))
        if excess[joint] <= 0.0:
            return ""
        return (
            f"{self.joint_names[joint]} is {abs(error[joint]):.4f} {unit} from where it should be; "
            f"at most {limit[joint]:g} {unit} is accepted"
        )
