"""How fast a planned motion is carried out: closed form of its progress over time."""

import math

import numpy as np

from skinplan.transforms import Array


class Pace:
    """Progress along a plan's own time: rate 1 is as planned, 0 stands; the rate changes in ramps.

    Args:
        start_s: When it begins [s].
        rate: Rate at the begin [1].
    """

    def __init__(self, start_s: float, rate: float) -> None:
        # Begin of each ramp [s], progress [s], rate before and after [1], length [s].
        self._ramps: list[tuple[float, float, float, float, float]] = [
            (start_s, 0.0, rate, rate, 0.0)
        ]

    def copy(self) -> "Pace":
        """Returns one that can be changed apart."""
        other = Pace(0.0, 0.0)
        other._ramps = list(self._ramps)
        return other

    def change(self, now_s: float, rate: float, ramp_s: float) -> None:
        """Passes to another rate in a ramp; what was to come later is forgotten."""
        progress, before = self.at(now_s)
        while len(self._ramps) > 1 and self._ramps[-1][0] > now_s:
            self._ramps.pop()
        self._ramps.append((now_s, float(progress), float(before), rate, max(ramp_s, 0.0)))

    def at(self, now_s: float) -> tuple[float, float]:
        """Returns progress [s] and rate [1]."""
        ramp = self._ramps[0]
        for candidate in reversed(self._ramps):
            if candidate[0] <= now_s:
                ramp = candidate
                break
        begin, progress, before, after, length = ramp
        spent = max(now_s - begin, 0.0)
        if spent < length:
            gain = (after - before) / length
            return progress + before * spent + 0.5 * gain * spent**2, before + gain * spent
        return progress + 0.5 * (before + after) * length + after * (spent - length), after

    def many(self, times: Array) -> tuple[Array, Array]:
        """Returns progress [s] and rate [1] at many times, shape (n,) each."""
        found = np.array([self.at(float(time)) for time in times]).reshape(-1, 2)
        return found[:, 0], found[:, 1]

    def stands_at(self) -> float:
        """Returns from when on it stands [s]; inf = it goes on."""
        begin, _, _, after, length = self._ramps[-1]
        return begin + length if after == 0.0 else math.inf

    def reaches(self, progress_s: float) -> float:
        """Returns when a progress later than now is reached [s]; inf = never."""
        begin, progress, before, after, length = self._ramps[-1]
        at_end = progress + 0.5 * (before + after) * length
        if progress_s <= progress:
            return begin
        if progress_s <= at_end:
            # Within the ramp: gain/2 t^2 + before t = wanted, in the form that takes gain 0, too.
            gain, wanted = (after - before) / length, progress_s - progress
            root = math.sqrt(max(before**2 + 2.0 * gain * wanted, 0.0))
            return begin + 2.0 * wanted / (before + root)
        return begin + length + (progress_s - at_end) / after if after > 0.0 else math.inf
