"""How far a job is, and how long it will still take. Needs no ROS."""

import math
from dataclasses import dataclass, replace

from skinplan.robot.cell import CellConfig
from skinplan.stations.model import StationPlan
from skinplan.transforms import difference

# Until a station was planned: time per scan path point, from the sample parts [s].
_POINT_S = 0.6
# The drive to the first station, whose length is not in the plan [s].
_DRIVE_S = 6.0
# What was measured so far corrects what is estimated within this.
_CORRECTION_RANGE = (0.2, 5.0)
# In these no time of the plan passes.
_STANDS_STILL = ("stopping", "paused", "waiting", "recovering", "restoring")


@dataclass(frozen=True)
class Progress:
    """How far a job is.

    Attributes:
        sub_state: Name of the step.
        share: Share done, 0 to 1; never falls.
        station: Number of the station being worked on, from 1; 0 = none.
        station_count: Stations of the plan; 0 = not planned yet.
        rescan: Number of the re-scan of what was missing; 0 = first scan.
        scanner_on: Whether the scanner is switched on.
        later_s: Estimated time of each station of the plan [s].
        time_left_s: Estimate on the cell's clock, until the last point is scanned [s]; NaN =
            unknown.
        step: Number of the step of the plan, from 1; 0 = not begun.
        step_count: Steps of the plan as far as it is known.
        steps_before: Steps of the scan before a re-scan.
        at_s: When the present step began, cell time [s]; NaN = unknown.
        spent_s: Spent at the present station before that [s].
        actual_s: Spent at the stations that are done [s].
        estimated_s: Estimated for them [s].
    """

    sub_state: str = ""
    share: float = 0.0
    station: int = 0
    station_count: int = 0
    rescan: int = 0
    scanner_on: bool = False
    later_s: tuple[float, ...] = ()
    time_left_s: float = math.nan
    step: int = 0
    step_count: int = 0
    steps_before: int = 0
    at_s: float = math.nan
    spent_s: float = 0.0
    actual_s: float = 0.0
    estimated_s: float = 0.0

    @property
    def correction(self) -> float:
        """How much longer than estimated the stations took so far [1]."""
        if self.estimated_s <= 0.0:
            return 1.0
        low, high = _CORRECTION_RANGE
        return min(high, max(low, self.actual_s / self.estimated_s))

    @property
    def title(self) -> str:
        """The step in words, e.g. ``scanning at station 2 of 3``."""
        if self.station == 0:
            return self.sub_state
        again = f", re-scan {self.rescan}" if self.rescan else ""
        return f"{self.sub_state} at station {self.station} of {self.station_count}{again}"

    def at_state(self, sub_state: str, station: int, now_s: float = math.nan) -> "Progress":
        """Returns the progress at the begin of a state.

        Args:
            sub_state: Name of the step.
            station: Number of the station being worked on, from 1; 0 = none.
            now_s: Cell time [s]; NaN = unknown.
        """
        passed_s = now_s - self.at_s if self.sub_state not in _STANDS_STILL else 0.0
        spent_s = self.spent_s + (max(0.0, passed_s) if math.isfinite(passed_s) else 0.0)
        found = replace(self, sub_state=sub_state, at_s=now_s, spent_s=spent_s)
        if station != self.station:
            found = found._arrived(station)
        if sub_state in _STANDS_STILL or not 0 < station <= len(self.later_s):
            return found
        here_s = found.correction * self.later_s[station - 1] - found.spent_s
        return found.left(max(0.0, here_s))

    def _arrived(self, station: int) -> "Progress":
        """Returns the progress at the next station; what the one before took is learnt from."""
        found = replace(self, station=station, spent_s=0.0)
        if station != self.station + 1 or not 0 < self.station <= len(self.later_s):
            return found
        return replace(
            found,
            actual_s=self.actual_s + self.spent_s,
            estimated_s=self.estimated_s + self.later_s[self.station - 1],
        )

    def reached(self, share: float) -> "Progress":
        """Returns the progress with so much done; it never falls."""
        return replace(self, share=min(1.0, max(self.share, share)))

    def at_step(self, step: int, step_count: int) -> "Progress":
        """Returns the progress in a step of the present scan."""
        before = self.steps_before
        return replace(self, step=before + step, step_count=before + step_count)

    def planned(self, plan: StationPlan, config: CellConfig, rescan: int = 0) -> "Progress":
        """Returns the progress after the stations are known."""
        poses = [station.T_map_base_link for station in plan.stations]
        ways_m = [difference(a, b)[0] for a, b in zip(poses, poses[1:], strict=False)]
        drives_s = [_DRIVE_S, *(way / config.base_speed_m_s for way in ways_m)]
        later = tuple(
            len(station.points) * _POINT_S + config.settle_s + drive_s
            for station, drive_s in zip(plan.stations, drives_s, strict=False)
        )
        return replace(
            self,
            station=0,
            station_count=len(plan.stations),
            later_s=later,
            time_left_s=sum(later),
            rescan=rescan,
            spent_s=0.0,
            actual_s=0.0,
            estimated_s=0.0,
        )

    def left(self, here_s: float) -> "Progress":
        """Returns the progress with so much time left at the present station."""
        later_s = self.correction * sum(self.later_s[self.station :])
        return replace(self, time_left_s=here_s + later_s)

    def switched(self, scanner_on: bool) -> "Progress":
        """Returns the progress after the scanner was switched."""
        return replace(self, scanner_on=scanner_on)
