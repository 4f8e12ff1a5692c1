"""A mobile base with differential drive that stops a little beside its goal (MiR100, M4)."""

import logging

import numpy as np

from skinplan.errors import InputError
from skinplan.mock.base_ways import BaseConfig, Leg, Pose, Ways, end_of, flat, floor_pose
from skinplan.robot.cell import CellConfig
from skinplan.transforms import Array, inverse, planar

log = logging.getLogger(__name__)


class MockBase:
    """Turns, drives straight, turns; every state is a closed form of the time.

    The base believes that it reaches its goal. In truth it stands beside it: `true` is `believed`
    composed with an error that is drawn at every stop, uniform over a disc of radius
    ``base_error_m`` and over +-``base_error_rad``. While driving, the error passes smoothly from
    the old to the new one. Where its localisation jumps, the base brakes and drives to the goal
    anew; it never changes its speed at once.

    Args:
        config: How it drives.
        cell: Speed and stopping error.
        seed: Of the stopping errors.
        T_map_base_link: Where it believes to stand at the start, shape (4, 4) [m]; None = the work
            position of the cell.
    """

    def __init__(
        self, config: BaseConfig, cell: CellConfig, seed: int, T_map_base_link: Array | None = None
    ) -> None:
        self._config = config
        self._cell = cell
        self._ways = Ways(config, cell.base_speed_m_s)
        self._random = np.random.default_rng([seed, 0xBA5E])
        start = cell.T_map_work if T_map_base_link is None else T_map_base_link
        self._legs: list[Leg] = []
        self._started_s = 0.0
        self._now_s = 0.0
        self._rest = floor_pose(start, "start pose of the base")
        self._error_from = self._draw_error()
        self._error_to = self._error_from
        # What slips have cost so far, along the map's axes; odometry never notices.
        self._slip_from = self._slip_to = np.zeros(2)
        #: Where its localisation puts the origin of the odometry, shape (4, 4) [m].
        self.T_map_odom: Array = np.eye(4)
        self._goal: Pose | None = None
        # When the localisation jumps in this drive, and how far [s], [m].
        self._jump: tuple[float, float] | None = None

    @property
    def believed(self) -> Array:
        """Where it believes to be: ``T_map_base_link``, shape (4, 4) [m]."""
        return planar(*self._state()[0])

    @property
    def odometry(self) -> Array:
        """What the wheels say: ``T_odom_base_link``, shape (4, 4) [m]; it never jumps."""
        return inverse(self.T_map_odom) @ self.believed

    @property
    def true(self) -> Array:
        """Where the base stands: ``T_map_base_link``, shape (4, 4) [m]."""
        slip = self._slip
        return planar(slip[0], slip[1], 0.0) @ self.believed @ planar(*self._error)

    @property
    def speed(self) -> float:
        """Forward speed [m/s]; negative = backwards."""
        return self._state()[1]

    @property
    def turn_rate(self) -> float:
        """Turn rate about z [rad/s]."""
        return self._state()[2]

    @property
    def moving(self) -> bool:
        """Whether the motion is still going on."""
        return self._now_s < self._started_s + self._duration

    @property
    def remaining_s(self) -> float:
        """Time until the base stands [s]."""
        return max(0.0, self._started_s + self._duration - self._now_s)

    @property
    def remaining_m(self) -> float:
        """Straight distance from the believed place to the end of the motion [m]."""
        x, y, _ = self._state()[0]
        return float(np.hypot(self._rest[0] - x, self._rest[1] - y))

    def stand(self) -> Array:
        """Returns all that tells where it is and believes to be, for `place`, shape (11,)."""
        return np.concatenate([flat(self.believed), flat(self.T_map_odom), self._error, self._slip])

    def place(self, stand: Array) -> None:
        """Puts it where another one stood, see `stand`; it does not move.

        Raises:
            InputError: Not as many numbers.
        """
        if np.shape(stand) != (11,):
            raise InputError(f"a stand of 11 numbers is accepted, found {np.shape(stand)}")
        self._legs, self._goal, self._jump = [], None, None
        self._rest = (float(stand[0]), float(stand[1]), float(stand[2]))
        self.T_map_odom = planar(*stand[3:6])
        self._error_from = self._error_to = np.array(stand[6:9])
        self._slip_from = self._slip_to = np.array(stand[9:11])

    def step(self, now_s: float) -> None:
        """Moves the base's clock on; steps of any size give the same states.

        Time never runs backwards: an earlier time changes nothing.

        Args:
            now_s: Time [s].

        Raises:
            InputError: The time is not finite.
        """
        if not np.isfinite(now_s):
            raise InputError(f"the base was stepped to {now_s} s; a finite time is accepted")
        if self._jump is not None and self._jump[0] <= now_s:
            (at_s, length_m), self._jump = self._jump, None
            self._now_s = max(self._now_s, at_s)
            self.jump(length_m)
        self._now_s = max(self._now_s, float(now_s))

    def goal(self, T_map_base_link: Array, now_s: float | None = None) -> None:
        """Starts to drive to a pose; in the middle of a motion it brakes first.

        Args:
            T_map_base_link: Goal on the floor, shape (4, 4) [m].
            now_s: Time of the start [s]; None = time of the last `step`.

        Raises:
            InputError: The goal is not finite, not on the floor plane or too far away.
        """
        target = floor_pose(T_map_base_link, "goal of the base")
        if now_s is not None:
            self.step(now_s)
        here = self._state()[0]
        distance = float(np.hypot(target[0] - here[0], target[1] - here[1]))
        if distance > self._config.goal_distance_max_m:
            raise InputError(
                f"goal of the base: at most {self._config.goal_distance_max_m} m away is accepted, "
                f"found {distance:.1f} m"
            )
        self._goal = target
        self._drive(target)
        self._draw_jump()

    def cancel(self, now_s: float | None = None) -> None:
        """Brakes to rest on the present line; without a motion nothing happens.

        Args:
            now_s: Time [s]; None = time of the last `step`.
        """
        self._brake(now_s, hard=False)

    def stop(self, now_s: float | None = None) -> None:
        """Brakes to rest as hard as it can.

        Args:
            now_s: Time [s]; None = time of the last `step`.
        """
        self._brake(now_s, hard=True)

    def jump(self, length_m: float) -> None:
        """The localisation jumps: it believes to be elsewhere, and drives to its goal from there.

        Args:
            length_m: How far, in a direction that is drawn [m].
        """
        bearing = self._random.uniform(-np.pi, np.pi)
        believed, odometry = self.believed, self.odometry
        moved = believed @ planar(length_m * np.cos(bearing), length_m * np.sin(bearing), 0.0)
        self.T_map_odom = moved @ inverse(odometry)
        # The base itself has not moved: what it believes wrongly is more than before.
        error = flat(inverse(moved) @ believed @ planar(*self._error))
        _, speed, rate = self._state()
        going = self._goal if self.moving else None
        legs = self._ways.braking(_pose(moved), speed, rate)
        here = end_of(legs, _pose(moved))
        if going is not None:
            legs, here = legs + self._ways.plan(here, going), going
        self._begin(legs, here)
        self._error_from = error
        if not legs:
            self._error_to = error

    def _drive(self, target: Pose) -> None:
        pose, speed, rate = self._state()
        legs = self._ways.braking(pose, speed, rate)
        self._begin(legs + self._ways.plan(end_of(legs, pose), target), target)

    def _brake(self, now_s: float | None, hard: bool) -> None:
        if now_s is not None:
            self.step(now_s)
        self._goal = self._jump = None
        if self.moving:
            pose, speed, rate = self._state()
            legs = self._ways.braking(pose, speed, rate, hard)
            self._begin(legs, end_of(legs, pose))

    @property
    def _error(self) -> Array:
        """How it stands beside where it believes to stand: x, y [m] and heading [rad]."""
        return np.asarray(self._error_from + self._share * (self._error_to - self._error_from))

    @property
    def _slip(self) -> Array:
        """What slips have cost so far along the map's axes [m]."""
        return np.asarray(self._slip_from + self._share * (self._slip_to - self._slip_from))

    @property
    def _share(self) -> float:
        """How much of the motion is done, 0 to 1."""
        elapsed, duration = self._now_s - self._started_s, self._duration
        return 1.0 if duration == 0.0 else float(np.clip(elapsed / duration, 0.0, 1.0))

    def _draw_jump(self) -> None:
        self._jump = None
        if self._config.jump_probability <= 0.0 or not self.moving:
            return
        share, jumps, length = self._random.uniform(size=3)
        if jumps < self._config.jump_probability:
            self._jump = (
                self._now_s + share * self._duration,
                length * self._config.jump_max_m,
            )

    def _begin(self, legs: list[Leg], rest: Pose) -> None:
        self._error_from, self._slip_from = self._error, self._slip
        self._slip_to = self._slip_from + self._draw_slip(legs)
        self._legs, self._rest, self._started_s = legs, rest, self._now_s
        self._error_to = self._draw_error() if legs else self._error_from
        log.debug("base: %d legs, %.2f s to %s", len(legs), self._duration, rest)

    @property
    def _duration(self) -> float:
        return sum(leg.profile.duration for leg in self._legs)

    def _state(self) -> tuple[Pose, float, float]:
        elapsed = self._now_s - self._started_s
        for leg in self._legs:
            if elapsed < leg.profile.duration:
                return leg.at(elapsed)
            elapsed -= leg.profile.duration
        return self._rest, 0.0, 0.0

    def _draw_slip(self, legs: list[Leg]) -> Array:
        """Returns what is lost of a motion along the map's axes, shape (2,) [m]."""
        if self._config.slip_probability <= 0.0 or not any(leg.drive for leg in legs):
            return np.zeros(2)
        slips = self._random.uniform() < self._config.slip_probability
        share = self._random.uniform() if slips else 0.0
        driven = [leg for leg in legs if leg.drive]
        ends = [leg.at(leg.profile.duration)[0] for leg in driven]
        ways = [np.subtract(e[:2], leg.start[:2]) for e, leg in zip(ends, driven, strict=True)]
        return np.asarray(-share * np.sum(ways, axis=0), dtype=float)

    def _draw_error(self) -> Array:
        radius = self._cell.base_error_m * np.sqrt(self._random.uniform())
        bearing = self._random.uniform(-np.pi, np.pi)
        turn = self._random.uniform(-1.0, 1.0) * self._cell.base_error_rad
        return np.array([radius * np.cos(bearing), radius * np.sin(bearing), turn])


def _pose(T_map_base_link: Array) -> Pose:
    x, y, angle = flat(T_map_base_link)
    return float(x), float(y), float(angle)
