"""Ways of a base with differential drive: turn on the spot, drive straight, brake."""

from dataclasses import dataclass

import numpy as np

from skinplan.errors import InputError
from skinplan.mock.profile import Braking, Profile
from skinplan.transforms import Array, heading, inverse, planar, require_transform

#: x, y [m] and heading [rad].
Pose = tuple[float, float, float]

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
class Leg:
    """One part of a motion: turning on the spot or driving straight, from (x, y, heading)."""

    start: Pose
    drive: float
    turn: float
    profile: Profile | Braking

    def at(self, elapsed_s: float) -> tuple[Pose, float, float]:
        """Returns (x, y, heading), speed [m/s] and turn rate [rad/s]."""
        way, speed = self.profile.at(elapsed_s)
        x, y, angle = self.start
        pose = (
            x + self.drive * way * np.cos(angle),
            y + self.drive * way * np.sin(angle),
            angle + self.turn * way,
        )
        return pose, self.drive * speed, self.turn * speed


class Ways:
    """Makes legs of goals.

    Args:
        config: How the base drives.
        speed_m_s: Speed of the cell [m/s].
    """

    def __init__(self, config: BaseConfig, speed_m_s: float) -> None:
        self._config = config
        self._speed = min(speed_m_s, config.speed_max_m_s)

    def braking(self, pose: Pose, speed: float, rate: float, hard: bool = False) -> list[Leg]:
        """Returns the leg to a rest; none where it stands.

        Args:
            pose: Where it is.
            speed: Of driving [m/s].
            rate: Of turning [rad/s].
            hard: As hard as it can.
        """
        config = self._config
        driving = config.stop_deceleration_m_s2 if hard else config.acceleration_m_s2
        turning = config.stop_turn_deceleration_rad_s2 if hard else config.turn_acceleration_rad_s2
        if speed != 0.0:
            return [Leg(pose, float(np.sign(speed)), 0.0, Braking(abs(speed), driving))]
        if rate != 0.0:
            return [Leg(pose, 0.0, float(np.sign(rate)), Braking(abs(rate), turning))]
        return []

    def plan(self, here: Pose, target: Pose) -> list[Leg]:
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
        drive = Profile(distance, self._speed, self._config.acceleration_m_s2)
        legs.append(Leg((x, y, angle + first), -sign, 0.0, drive))
        return legs + self._turning((target[0], target[1], angle + first), last)

    def _turning(self, start: Pose, angle: float) -> list[Leg]:
        if abs(angle) < _SAME_HEADING_RAD:
            return []
        profile = Profile(
            abs(angle), self._config.turn_speed_rad_s, self._config.turn_acceleration_rad_s2
        )
        return [Leg(start, 0.0, float(np.sign(angle)), profile)]


def end_of(legs: list[Leg], pose: Pose) -> Pose:
    """Returns where legs end; without legs where it stands."""
    return legs[-1].at(legs[-1].profile.duration)[0] if legs else pose


def flat(T_a_b: Array) -> Array:
    """Returns x, y [m] and heading [rad] of a planar transform, shape (3,)."""
    return np.array([T_a_b[0, 3], T_a_b[1, 3], heading(T_a_b)])


def _wrapped(angle: float) -> float:
    return float((angle + np.pi) % (2.0 * np.pi) - np.pi)


def floor_pose(T_map_base_link: Array, name: str) -> Pose:
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
