"""Trajectories, as the rooms exchange them."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from skinplan.stations.model import SkippedPoint
from skinplan.transforms import Array

TRANSIT = 0
SCAN = 1


@dataclass(frozen=True, eq=False)
class Segment:
    """A continuous piece of motion.

    Attributes:
        kind: TRANSIT or SCAN.
        times: From the segment's start, strictly rising from 0, shape (t,) [s].
        positions: Joint positions, shape (t, 6) [rad]; linear between samples.
        velocities: Joint velocities, shape (t, 6) [rad/s].
        points: Indices of the scan path points passed, in the order of visit; empty for TRANSIT.
        tcp_path_m: Length of the scanner's way [m].
        point_s: When each of the points is passed, from the segment's start, not falling, shape
            (len(points),) [s].
    """

    kind: int
    times: Array
    positions: Array
    velocities: Array
    points: NDArray[np.int64]
    tcp_path_m: float
    point_s: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def duration_s(self) -> float:
        """Duration [s]."""
        return float(self.times[-1]) if len(self.times) else 0.0


@dataclass(frozen=True)
class StationTrajectory:
    """Everything that the arm does at one station, from the start state asked for to home.

    Attributes:
        station_id: Number of the station.
        segments: In the order of execution; each begins where the one before ends.
        skipped: Points of this station that are not scanned, with the reason.
        order: Name of the order strategy; empty = not known.
        order_cost: What the strategy made small, in its own unit (``tour``: seconds of the graph's
            estimates); NaN = nothing was, or not known.
        order_bound: No order of the same points has a smaller cost; NaN = not known.
    """

    station_id: int
    segments: tuple[Segment, ...]
    skipped: tuple[SkippedPoint, ...]
    order: str = ""
    order_cost: float = float("nan")
    order_bound: float = float("nan")

    @property
    def scan_s(self) -> float:
        """Sum of the scan segments' durations [s]."""
        return sum(s.duration_s for s in self.segments if s.kind == SCAN)

    @property
    def transit_s(self) -> float:
        """Sum of the transit segments' durations [s]."""
        return sum(s.duration_s for s in self.segments if s.kind == TRANSIT)

    @property
    def breaks(self) -> int:
        """Number of interruptions of the scan."""
        return max(0, sum(s.kind == SCAN for s in self.segments) - 1)

    @property
    def tcp_path_m(self) -> float:
        """Length of the scanner's way while scanning [m]."""
        return sum(s.tcp_path_m for s in self.segments if s.kind == SCAN)
