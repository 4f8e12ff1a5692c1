"""How far a job is, and how long it will still take. Needs no ROS."""

import math
from dataclasses import dataclass, replace

from skinplan.stations.model import StationPlan

# Until a station was planned: time per scan path point, from the sample parts [s].
_POINT_S = 0.6
# One drive between stations [s].
_DRIVE_S = 6.0


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
        later_s: Estimated time of the stations still to come, each [s].
        time_left_s: Estimate on the cell's clock [s]; NaN = unknown.
    """

    sub_state: str = ""
    share: float = 0.0
    station: int = 0
    station_count: int = 0
    rescan: int = 0
    scanner_on: bool = False
    later_s: tuple[float, ...] = ()
    time_left_s: float = math.nan

    @property
    def title(self) -> str:
        """The step in words, e.g. ``scanning at station 2 of 3``."""
        if self.station == 0:
            return self.sub_state
        again = f", re-scan {self.rescan}" if self.rescan else ""
        return f"{self.sub_state} at station {self.station} of {self.station_count}{again}"

    def at_state(self, sub_state: str, station: int) -> "Progress":
        """Returns the progress at the begin of a state."""
        left = self.time_left_s
        if station != self.station and self.later_s:
            left = sum(self.later_s[max(0, station - 1) :])
        return replace(self, sub_state=sub_state, station=station, time_left_s=left)

    def reached(self, share: float) -> "Progress":
        """Returns the progress with so much done; it never falls."""
        return replace(self, share=min(1.0, max(self.share, share)))

    def planned(self, plan: StationPlan, settle_s: float, rescan: int = 0) -> "Progress":
        """Returns the progress after the stations are known."""
        later = tuple(len(s.points) * _POINT_S + settle_s + _DRIVE_S for s in plan.stations)
        return replace(
            self,
            station_count=len(plan.stations),
            later_s=later,
            time_left_s=sum(later),
            rescan=rescan,
        )

    def left(self, here_s: float) -> "Progress":
        """Returns the progress with so much time left at the present station."""
        return replace(self, time_left_s=here_s + sum(self.later_s[self.station :]))

    def switched(self, scanner_on: bool) -> "Progress":
        """Returns the progress after the scanner was switched."""
        return replace(self, scanner_on=scanner_on)
