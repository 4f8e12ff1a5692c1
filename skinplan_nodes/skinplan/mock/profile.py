"""Closed-form motion profiles: one jump of simulated time tells the same as many small steps."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Profile:
    """Trapezoid: accelerate, cruise, brake; a triangle when the distance is short.

    Attributes:
        distance: Length of the way, >= 0 [m or rad].
        speed: Greatest speed, > 0 [1/s].
        acceleration: Of both ramps, > 0 [1/s^2].
    """

    distance: float
    speed: float
    acceleration: float

    @property
    def peak(self) -> float:
        """Speed that is reached [1/s]."""
        return float(min(self.speed, np.sqrt(self.distance * self.acceleration)))

    @property
    def duration(self) -> float:
        """Time for the whole way [s]."""
        if self.distance <= 0.0:
            return 0.0
        return self.peak / self.acceleration + self.distance / self.peak

    def at(self, elapsed_s: float) -> tuple[float, float]:
        """Returns way [m or rad] and speed [1/s] after a time; before and after it stands."""
        duration = self.duration
        if elapsed_s <= 0.0 or duration == 0.0:
            return 0.0, 0.0
        if elapsed_s >= duration:
            return self.distance, 0.0
        ramp = self.peak / self.acceleration
        if elapsed_s < ramp:
            return 0.5 * self.acceleration * elapsed_s**2, self.acceleration * elapsed_s
        left = duration - elapsed_s
        if left < ramp:
            return self.distance - 0.5 * self.acceleration * left**2, self.acceleration * left
        return self.peak * (elapsed_s - 0.5 * ramp), self.peak


@dataclass(frozen=True)
class Braking:
    """Comes to rest from a speed.

    Attributes:
        start_speed: >= 0 [1/s].
        acceleration: > 0 [1/s^2].
    """

    start_speed: float
    acceleration: float

    @property
    def distance(self) -> float:
        """Way until rest [m or rad]."""
        return self.start_speed**2 / (2.0 * self.acceleration)

    @property
    def duration(self) -> float:
        """Time until rest [s]."""
        return self.start_speed / self.acceleration

    def at(self, elapsed_s: float) -> tuple[float, float]:
        """Returns way [m or rad] and speed [1/s] after a time."""
        time = float(np.clip(elapsed_s, 0.0, self.duration))
        return (
            self.start_speed * time - 0.5 * self.acceleration * time**2,
            self.start_speed - self.acceleration * time,
        )
