"""One motion of an arm: a path over its own time, and how fast it is carried out."""

import numpy as np
from numpy.typing import NDArray

from skinplan.mock.pace import Pace
from skinplan.transforms import Array

_SHARES = np.linspace(0.0, 1.0, 9)


class ArmMotion:
    """Joint positions over time: straight between points, or cubic where they have velocities.

    The controller's idea of the motion goes by `commanded`, the arm itself by `actual`; as long as
    the arm follows they are the same. At its end the arm stands `offset` beside the last point.

    Args:
        start_s: Time of the begin [s].
        times: From the begin, rising from 0, shape (n,) [s].
        positions: shape (n, j) [rad].
        velocities: shape (n, j) [rad/s]; None = straight between the points.
        offset: shape (j,) [rad].
        rate: Rate at the begin [1].
    """

    def __init__(
        self,
        start_s: float,
        times: Array,
        positions: Array,
        velocities: Array | None,
        offset: Array,
        rate: float,
    ) -> None:
        self.start_s = start_s
        self.times = times
        self.positions = positions
        self.offset = offset
        self.commanded = Pace(start_s, rate)
        self.actual = self.commanded
        #: What is left of it is forgotten.
        self.stopped = False
        self._velocities = velocities
        #: Highest speed of each joint between two points, shape (n - 1, j) [rad/s].
        self.speeds = self._speeds()

    @classmethod
    def hold(cls, start_s: float, positions: Array) -> "ArmMotion":
        """Standing at positions, shape (j,) [rad]."""
        return cls(start_s, np.zeros(1), positions[None, :], None, np.zeros(len(positions)), 1.0)

    @property
    def length_s(self) -> float:
        """Planned duration [s]."""
        return float(self.times[-1])

    def desired(self, times: Array) -> tuple[Array, Array]:
        """Returns where the controller believes the arm to be, (n, j) [rad] and [rad/s]."""
        progress, rate = self.commanded.many(times)
        where, speed = self._on_path(progress)
        return where, speed * rate[:, None]

    def at(self, times: Array) -> tuple[Array, Array]:
        """Returns where the arm is, positions (n, j) [rad] and velocities (n, j) [rad/s]."""
        progress, rate = self.actual.many(times)
        where, speed = self._on_path(progress)
        if self.length_s > 0.0:
            share = np.clip(progress / self.length_s, 0.0, 1.0)
            where = where + share[:, None] * self.offset
            going = (progress > 0.0) & (progress < self.length_s)
            speed = speed + going[:, None] * self.offset / self.length_s
        return where, speed * rate[:, None]

    def ramp_s(self, pace: Pace, now_s: float, rate: float, acceleration: float) -> float:
        """Returns how long a change of rate has to take [s], so that no joint brakes harder."""
        progress, before = pace.at(now_s)
        if not len(self.speeds) or before == rate:
            return 0.0
        ahead = max(before, rate) ** 2 * float(self.speeds.max()) / acceleration
        first = int(np.clip(np.searchsorted(self.times, progress, "right") - 1, 0, None))
        last = int(np.searchsorted(self.times, progress + ahead, "left"))
        near = self.speeds[first : max(last, first + 1)]
        fastest = float(near.max()) if len(near) else 0.0
        return abs(before - rate) * fastest / acceleration

    def done_s(self) -> float:
        """Returns when the arm stands for good: at the end, or where it was stopped [s]."""
        end_s = self.actual.reaches(self.length_s)
        return min(end_s, self.actual.stands_at()) if self.stopped else end_s

    def _on_path(self, progress: Array) -> tuple[Array, Array]:
        """Returns positions (n, j) [rad] and velocities at rate 1, (n, j) [rad/s]."""
        progress = np.asarray(progress, dtype=float)
        if len(self.times) == 1:
            where = np.repeat(self.positions, len(progress), axis=0)
            return where, np.zeros_like(where)
        inside = np.clip(progress, 0.0, self.length_s)
        after = np.clip(np.searchsorted(self.times, inside, "right"), 1, len(self.times) - 1)
        where, speed = self._piece(after, inside)
        standing = (progress <= 0.0) | (progress >= self.length_s)
        speed[standing] = 0.0
        return where, speed

    def _piece(self, after: NDArray[np.int64], inside: Array) -> tuple[Array, Array]:
        begin, end = self.positions[after - 1], self.positions[after]
        step = (self.times[after] - self.times[after - 1])[:, None]
        spent = inside[:, None] - self.times[after - 1][:, None]
        if self._velocities is None:
            speed = (end - begin) / step
            return begin + spent * speed, speed
        share = spent / step
        first, last = self._velocities[after - 1] * step, self._velocities[after] * step
        way = end - begin
        square, cube = 3.0 * way - 2.0 * first - last, first + last - 2.0 * way
        where = begin + share * (first + share * (square + share * cube))
        speed = (first + share * (2.0 * square + 3.0 * share * cube)) / step
        return where, speed

    def _speeds(self) -> Array:
        count = len(self.times) - 1
        if count < 1:
            return np.zeros((0, self.positions.shape[1]))
        after = np.repeat(np.arange(1, count + 1), len(_SHARES))
        steps = np.diff(self.times)
        inside = np.repeat(self.times[:-1], len(_SHARES)) + np.outer(steps, _SHARES).ravel()
        speed = np.abs(self._piece(after, inside)[1])
        return np.asarray(speed.reshape(count, len(_SHARES), -1).max(axis=1))
