"""A mobile base with differential drive that stops a little beside its goal (MiR100, M4)."""

import logging
from dataclasses import dataclass

import numpy as np

from skinplan.errors import InputError
from skinplan.mock.profile import Braking, Profile
from skinplan.robot.cell import CellConfig
from skinplan.transforms import Array, heading, inverse, planar, require_transform

log = logging.getLogger(__name__)

# A goal nearer than this is where the base already stands: it does not move.
_SAME_PLACE_M = 1e-4
_SAME_HEADING_RAD = 1e-4
_FLAT_M = 1e-3
_FLAT_RAD = 1e-3


@dataclass(frozen=True)
class BaseConfig:
    """How the base drives; its speed and its stopping error are in `CellConfig`.

    Attributes:
        speed_max_m_s: The cell's speed counts up to this one [m/s].
        acceleration_m_s2: Of driving [m/s^2].
        stop_deceleration_m_s2: Of a stop [m/s^2].
        stop_turn_deceleration_rad_s2: Of a stop while turning [rad/s^2].
        turn_speed_rad_s: Greatest speed of turning on the spot [rad/s].
        turn_acceleration_rad_s2: Of turning [rad/s^2].
        goal_distance_max_m: Goals farther away are refused [m].
        slip_probability: Share of the drives in which the wheels slip [1]: the base covers only a
            part of the way, and goes on as if it had covered all of it.
        jump_probability: Share of the drives in which the localisation jumps [1].
        jump_max_m: Longest such jump [m].
    """

    speed_max_m_s: float = 1.5
    acceleration_m_s2: float = 0.5
    stop_deceleration_m_s2: float = 1.5
    stop_turn_deceleration_rad_s2: float = 3.0
    turn_speed_rad_s: float = 1.0
    turn_acceleration_rad_s2: float = 1.0
    goal_distance_max_m: float = 50.0
    slip_probability: float = 0.0
    jump_probability: float = 0.0
    jump_max_m: float = 0.1


@dataclass(frozen=True)
class _Leg:
    """One part of a motion: turning on the spot or driving straight, from (x, y, heading)."""

    start: tuple[float, float, float]
    drive: float
    turn: float
    profile: Profile | Braking

    def at(self, elapsed_s: float) -> tuple[tuple[float, float, float], float, float]:
        """Returns (x, y, heading), speed [m/s] and turn rate [rad/s]."""
        way, speed = self.profile.at(elapsed_s)
        x, y, angle = self.start
        pose = (
            x + self.drive * way * np.cos(angle),
            y + self.drive * way * np.sin(angle),
            angle + self.turn * way,
        )
        return pose, self.drive * speed, self.turn * speed


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
        self._random = np.random.default_rng([seed, 0xBA5E])
        start = cell.T_map_work if T_map_base_link is None else T_map_base_link
        self._legs: list[_Leg] = []
        self._started_s = 0.0
        self._now_s = 0.0
        self._rest = _floor_pose(start, "start pose of the base")
        self._error_from = self._draw_error()
        self._error_to = self._error_from
        # What slips have cost so far, along the map's axes; odometry never notices.
        self._slip_from = self._slip_to = np.zeros(2)
        #: Where its localisation puts the origin of the odometry, shape (4, 4) [m].
        self.T_map_odom: Array = np.eye(4)
        self._goal: tuple[float, float, float] | None = None
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
        elapsed, duration = self._now_s - self._started_s, self._duration
        share = 1.0 if duration == 0.0 else float(np.clip(elapsed / duration, 0.0, 1.0))
        slip = self._slip_from + share * (self._slip_to - self._slip_from)
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
        target = _floor_pose(T_map_base_link, "goal of the base")
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
        self._brake(now_s, self._config.acceleration_m_s2, self._config.turn_acceleration_rad_s2)

    def stop(self, now_s: float | None = None) -> None:
        """Brakes to rest as hard as it can.

        Args:
            now_s: Time [s]; None = time of the last `step`.
        """
        self._brake(
            now_s, self._config.stop_deceleration_m_s2, self._config.stop_turn_deceleration_rad_s2
        )

    def jump(self, length_m: float) -> None:
        """The localisation jumps: it believes to be elsewhere, and drives to its goal from there.

        Args:
            length_m: How far, in a direction that is drawn [m].
        """
        bearing = self._random.uniform(-np.pi, np.pi)
        believed, odometry, error = self.believed, self.odometry, self._error
        moved = believed @ planar(length_m * np.cos(bearing), length_m * np.sin(bearing), 0.0)
        self.T_map_odom = moved @ inverse(odometry)
        # The base itself has not moved: what it believes wrongly is more than before.
        error = _flat(inverse(moved) @ believed @ planar(*error))
        pose, legs = _flat(moved), []
        _, speed, rate = self._state()
        going = self._goal if self.moving else None
        if self.moving:
            legs = self._braking(
                (pose[0], pose[1], pose[2]),
                speed,
                rate,
                self._config.acceleration_m_s2,
                self._config.turn_acceleration_rad_s2,
            )
        here = legs[-1].at(legs[-1].profile.duration)[0] if legs else (pose[0], pose[1], pose[2])
        if going is not None:
            legs, here = legs + self._plan(here, going), going
        self._begin(legs, here)
        self._error_from = error
        if not legs:
            self._error_to = error

    def _drive(self, target: tuple[float, float, float]) -> None:
        pose, speed, rate = self._state()
        legs = self._braking(
            pose,
            speed,
            rate,
            self._config.acceleration_m_s2,
            self._config.turn_acceleration_rad_s2,
        )
        here = legs[-1].at(legs[-1].profile.duration)[0] if legs else pose
        self._begin(legs + self._plan(here, target), target)

    def _brake(self, now_s: float | None, driving: float, turning: float) -> None:
        if now_s is not None:
            self.step(now_s)
        self._goal = self._jump = None
        if not self.moving:
            return
        legs = self._braking(*self._state(), driving, turning)
        here = legs[-1].at(legs[-1].profile.duration)[0] if legs else self._state()[0]
        self._begin(legs, here)

    def _braking(
        self,
        pose: tuple[float, float, float],
        speed: float,
        rate: float,
        driving: float,
        turning: float,
    ) -> list[_Leg]:
        if speed != 0.0:
            return [_Leg(pose, float(np.sign(speed)), 0.0, Braking(abs(speed), driving))]
        if rate != 0.0:
            return [_Leg(pose, 0.0, float(np.sign(rate)), Braking(abs(rate), turning))]
        return []

    @property
    def _error(self) -> Array:
        """How it stands beside where it believes to stand: x, y [m] and heading [rad]."""
        elapsed, duration = self._now_s - self._started_s, self._duration
        share = 1.0 if duration == 0.0 else float(np.clip(elapsed / duration, 0.0, 1.0))
        return np.asarray(self._error_from + share * (self._error_to - self._error_from))

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

    def _begin(self, legs: list[_Leg], rest: tuple[float, float, float]) -> None:
        elapsed, duration = self._now_s - self._started_s, self._duration
        share = 1.0 if duration == 0.0 else float(np.clip(elapsed / duration, 0.0, 1.0))
        self._error_from = self._error_from + share * (self._error_to - self._error_from)
        self._slip_from = self._slip_from + share * (self._slip_to - self._slip_from)
        self._slip_to = self._slip_from + self._draw_slip(legs)
        self._legs, self._rest, self._started_s = legs, rest, self._now_s
        self._error_to = self._draw_error() if legs else self._error_from
        log.debug("base: %d legs, %.2f s to %s", len(legs), self._duration, rest)

    def _plan(
        self, here: tuple[float, float, float], target: tuple[float, float, float]
    ) -> list[_Leg]:
        """Turn, drive, turn; backwards where that needs less turning."""
        x, y, angle = here
        distance = float(np.hypot(target[0] - x, target[1] - y))
        if distance < _SAME_PLACE_M:
            return self._turning((x, y, angle), _wrapped(target[2] - angle))
        along = float(np.arctan2(target[1] - y, target[0] - x))
        ways = []
        for sign, course in ((1.0, along), (-1.0, along + np.pi)):
            first, last = _wrapped(course - angle), _wrapped(target[2] - course)
            ways.append((round(abs(first) + abs(last), 6), -sign, first, last))
        _, sign, first, last = min(ways)
        legs = self._turning((x, y, angle), first)
        speed = min(self._cell.base_speed_m_s, self._config.speed_max_m_s)
        drive = Profile(distance, speed, self._config.acceleration_m_s2)
        legs.append(_Leg((x, y, angle + first), -sign, 0.0, drive))
        return legs + self._turning((target[0], target[1], angle + first), last)

    def _turning(self, start: tuple[float, float, float], angle: float) -> list[_Leg]:
        if abs(angle) < _SAME_HEADING_RAD:
            return []
        profile = Profile(
            abs(angle), self._config.turn_speed_rad_s, self._config.turn_acceleration_rad_s2
        )
        return [_Leg(start, 0.0, float(np.sign(angle)), profile)]

    @property
    def _duration(self) -> float:
        return sum(leg.profile.duration for leg in self._legs)

    def _state(self) -> tuple[tuple[float, float, float], float, float]:
        elapsed = self._now_s - self._started_s
        for leg in self._legs:
            if elapsed < leg.profile.duration:
                return leg.at(elapsed)
            elapsed -= leg.profile.duration
        return self._rest, 0.0, 0.0

    def _draw_slip(self, legs: list[_Leg]) -> Array:
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


def _flat(T_a_b: Array) -> Array:
    """Returns x, y [m] and heading [rad] of a planar transform, shape (3,)."""
    return np.array([T_a_b[0, 3], T_a_b[1, 3], heading(T_a_b)])


def _wrapped(angle: float) -> float:
    return float((angle + np.pi) % (2.0 * np.pi) - np.pi)


def _floor_pose(T_map_base_link: Array, name: str) -> tuple[float, float, float]:
    """Returns (x, y, heading) of a pose on the floor, or says why it is none."""
    pose = require_transform(T_map_base_link, name)
    flat = planar(pose[0, 3], pose[1, 3], heading(pose))
    delta = inverse(flat) @ pose
    if abs(delta[2, 3]) > _FLAT_M or np.abs(delta[:3, :3] - np.eye(3)).max() > _FLAT_RAD:
        raise InputError(
            f"{name}: a pose on the floor (z = 0, turned about z alone) is accepted, found "
            f"z = {pose[2, 3]:.3f} m and an upward axis of "
            f"({pose[0, 2]:.3f}, {pose[1, 2]:.3f}, {pose[2, 2]:.3f})"
        )
    return float(pose[0, 3]), float(pose[1, 3]), heading(pose)
