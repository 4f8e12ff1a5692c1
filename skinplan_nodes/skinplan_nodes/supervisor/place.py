"""Where in its plan a job is: what its thread knows, and a new supervisor reads from the journal.

Needs no ROS.
"""

import math
import time
from dataclasses import dataclass, field, replace

from skinplan.stations.model import SkippedPoint, Station, StationPlan
from skinplan.trajectory.model import SCAN, Segment, StationTrajectory
from skinplan.transforms import Array
from skinplan_nodes.supervisor import reentry
from skinplan_nodes.supervisor.cell import Located
from skinplan_nodes.supervisor.machine import State
from skinplan_nodes.supervisor.run_data import PlannedPath

#: The arm stands on its way within this, largest difference of a joint [rad].
ON_WAY_RAD = 0.02


@dataclass
class Place:
    """Where in its plan a job is.

    Attributes:
        rescan: Number of the re-scan; 0 = first scan.
        station: Number of the station, from 1; 0 = the work position.
        state: State that the job was in, or is to go on in.
        planned: Path that is scanned; None = not planned yet.
        plan: Its stations; None = not planned yet.
        T_map_workpiece: Where the part was found from the work position, shape (4, 4) [m].
        located: Newest localisation; None = none that holds.
        trajectory: What the arm does at the present station; None = not planned.
        segment: Index of the segment that comes next, or is being executed.
        executed: What the arm has done at this station before `trajectory` was planned.
        left_home: Index of the first segment of `executed` since the arm was at home.
        passed_s: Points of the path that were scanned, with the monotonic time [s].
        rest: What is left of the present segment after an interruption; None = all of it.
        resuming: The next motion begins slowly.
    """

    rescan: int = 0
    station: int = 0
    state: State = State.STARTING
    planned: PlannedPath | None = None
    plan: StationPlan | None = None
    T_map_workpiece: Array | None = None
    located: Located | None = None
    trajectory: StationTrajectory | None = None
    segment: int = 0
    executed: list[Segment] = field(default_factory=list)
    left_home: int = 0
    passed_s: dict[int, float] = field(default_factory=dict)
    rest: Segment | None = None
    resuming: bool = False

    @property
    def here(self) -> Station:
        """The present station."""
        assert self.plan is not None
        return self.plan.stations[self.station - 1]

    @property
    def current(self) -> Segment | None:
        """The segment that comes next, or is being executed; None = all are done."""
        if self.trajectory is None or self.segment >= len(self.trajectory.segments):
            return None
        return self.trajectory.segments[self.segment]

    @property
    def is_last(self) -> bool:
        """Whether no station follows."""
        return self.plan is None or self.station >= len(self.plan.stations)

    def replan(self) -> None:
        """Begins a new scan path: the re-scan of what was missing."""
        self.rescan += 1
        self.station, self.planned, self.plan = 0, None, None
        self.passed_s = {}
        self.leave()

    def leave(self) -> None:
        """Forgets what belongs to a station."""
        self.trajectory, self.segment, self.executed, self.rest = None, 0, [], None
        self.left_home = 0

    def way_home(self, joints: Array) -> Segment | None:
        """Returns the way home over what the arm has done here; None = not known.

        Args:
            joints: Where the arm stands, shape (6,) [rad].
        """
        parts = self.executed[self.left_home :]
        if self.trajectory is not None:
            parts += self.trajectory.segments[: self.segment]
        if self.current is not None:
            on_way = reentry.nearest(self.current, joints, ON_WAY_RAD)
            piece = reentry.until(self.current, on_way.time_s)
            if on_way.distance_rad <= ON_WAY_RAD and piece is not None:
                parts.append(piece)
        return reentry.way_back(parts, joints, ON_WAY_RAD)

    def finish_segment(self, began_s: float) -> Segment:
        """Notes that the present segment was executed to its end; returns it.

        Args:
            began_s: When its execution began, monotonic time [s].
        """
        segment = self.current
        assert segment is not None
        self.note_points(segment, segment.duration_s, began_s)
        self.segment, self.rest = self.segment + 1, None
        return segment

    def note_points(self, segment: Segment, time_s: float, began_s: float) -> None:
        """Notes the points that a segment has passed, and about when.

        Args:
            segment: The segment as planned.
            time_s: Where on its way it is, from its start [s].
            began_s: When its execution began, monotonic time [s].
        """
        if segment.kind != SCAN or time_s <= 0.0:
            return
        if not math.isfinite(began_s):
            began_s = time.monotonic()
        spent = time.monotonic() - began_s
        known = len(segment.point_s) == len(segment.points)
        for index, point in enumerate(segment.points):
            at_s = float(segment.point_s[index]) if known else segment.duration_s
            if at_s <= time_s:
                self.passed_s.setdefault(int(point), began_s + spent * at_s / time_s)

    def forget_since(self, since_s: float) -> int:
        """Forgets the points that were passed after a monotonic time [s]; returns how many."""
        late = [point for point, at_s in self.passed_s.items() if at_s >= since_s]
        for point in late:
            del self.passed_s[point]
        return len(late)

    def adopt(self, made: StationTrajectory) -> StationTrajectory:
        """Takes a trajectory as what the arm does next; returns all that it does at this station.

        Args:
            made: Planned from where the arm stands.
        """
        if self.trajectory is not None:
            self.executed += self.trajectory.segments[: self.segment]
        self.trajectory, self.segment, self.rest = made, 0, None
        return replace(made, segments=(*self.executed, *made.segments))


def nothing_reached(station: int, points: list[int]) -> StationTrajectory:
    """Returns the trajectory of a station from which no point can be scanned."""
    reason = "not reachable from this station"
    skipped = tuple(SkippedPoint(point, reason) for point in points)
    return StationTrajectory(station, (), skipped, order_cost=math.nan)
