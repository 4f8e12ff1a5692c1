"""What a run has gathered so far, and its ``summary.json``. Needs no ROS."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from skinplan.part.model import ScanSettings
from skinplan.plan_record import plain, planning_summary
from skinplan.robot.cell import CellConfig
from skinplan.scan_path.model import ScanPath
from skinplan.scanner.model import CoverageFigures
from skinplan.stations.model import SkippedPoint, StationPlan
from skinplan.trajectory.certify import TimedCoverage
from skinplan.trajectory.cycle import CycleTime, cycle_time
from skinplan.trajectory.model import SCAN, StationTrajectory
from skinplan.transforms import Array, quaternion
from skinplan_nodes.supervisor.faults import Interruption


@dataclass(frozen=True)
class PlannedPath:
    """A scan path with what the planner knows about its mesh.

    Attributes:
        path: The scan path, workpiece frame.
        coverage: Predicted coverage.
        triangles: Triangles of the mesh.
        area_m2: Area of the mesh [m^2].
        mesh_sha256: Hash of the mesh file.
    """

    path: ScanPath
    coverage: CoverageFigures
    triangles: int
    area_m2: float
    mesh_sha256: str


@dataclass(frozen=True, eq=False)
class Localization:
    """One successful localisation.

    Attributes:
        station: Number of the station, from 1; 0 = the work position.
        quality: E of eq (3).
        attempts: Estimates made.
        stamp_s: Time of the image on the cell's clock [s].
        T_arm_base_workpiece: Where the part is, shape (4, 4) [m].
    """

    station: int
    quality: float
    attempts: int
    stamp_s: float
    T_arm_base_workpiece: Array

    def document(self) -> dict[str, Any]:
        """Returns the entry of ``summary.json``; only a simulation knows the errors."""
        return {
            "station": self.station,
            "E": self.quality,
            "attempts": self.attempts,
            "position_error_m": None,
            "angle_error_rad": None,
            "stamp_s": self.stamp_s,
            "part_in_arm_base": {
                "position_m": self.T_arm_base_workpiece[:3, 3],
                "quaternion_xyzw": quaternion(self.T_arm_base_workpiece),
            },
        }


@dataclass
class Round:
    """One scan: the first one, or the re-scan of what was missing.

    Attributes:
        planned: Scan path; None = not reached.
        station_plan: Stations; None = not reached.
        trajectories: Of the stations scanned so far, what the arm did and does there.
        measured: What was measured after it.
    """

    planned: PlannedPath | None = None
    station_plan: StationPlan | None = None
    trajectories: list[StationTrajectory] = field(default_factory=list)
    measured: dict[str, Any] = field(default_factory=dict)

    def put(self, made: StationTrajectory) -> None:
        """Takes a station's trajectory in, in the place of an earlier one of the same station."""
        self.trajectories[:] = [t for t in self.trajectories if t.station_id != made.station_id]
        self.trajectories.append(made)

    def scanned(self) -> set[int]:
        """Returns the indices of the scan path points that were scanned."""
        segments = (segment for made in self.trajectories for segment in made.segments)
        return {
            int(point) for segment in segments if segment.kind == SCAN for point in segment.points
        }

    def left_over(self) -> dict[int, str]:
        """Returns the points left out by a station and scanned by none since, with the reason."""
        done = self.scanned()
        skipped = {
            int(skip.point): skip.reason for made in self.trajectories for skip in made.skipped
        }
        return {point: reason for point, reason in sorted(skipped.items()) if point not in done}

    def final_trajectories(self) -> list[StationTrajectory]:
        """Returns the trajectories with only those points as skipped that no station scanned."""
        if not self.trajectories:
            return []
        skipped = tuple(SkippedPoint(point, reason) for point, reason in self.left_over().items())
        cleared = [replace(made, skipped=()) for made in self.trajectories]
        return [*cleared[:-1], replace(cleared[-1], skipped=skipped)]

    def document(self) -> dict[str, Any]:
        """Returns the entry of ``summary.json`` for a re-scan."""
        return {
            "points": 0 if self.planned is None else len(self.planned.path),
            "stations": 0 if self.station_plan is None else len(self.station_plan.stations),
            "scan_s": sum(made.scan_s for made in self.trajectories),
            "transit_s": sum(made.transit_s for made in self.trajectories),
            "skipped": len(self.left_over()),
            "area_ratio_after": self.measured.get("area_ratio"),
        }


@dataclass
class RunData:
    """What a run has gathered so far; None or empty = not reached.

    Attributes:
        rounds: The first scan and its re-scans.
        localizations: In the order of time.
        identification: Which part stands on the fixture; empty = it was not checked.
        planning_s: Wall time of the planning stages of the first scan [s].
        timed: What the trajectories of the first scan see, by the certificate.
        measured: Figures of the inspection.
        bag: Figures of the bag.
        interruptions: When the job stood still, and why.
        timing_s: Wall and cell time of the whole job [s].
    """

    rounds: list[Round] = field(default_factory=lambda: [Round()])
    localizations: list[Localization] = field(default_factory=list)
    identification: dict[str, Any] = field(default_factory=dict)
    planning_s: dict[str, float] = field(default_factory=dict)
    timed: TimedCoverage | None = None
    measured: dict[str, Any] = field(default_factory=dict)
    bag: dict[str, Any] = field(default_factory=dict)
    interruptions: list[Interruption] = field(default_factory=list)
    timing_s: dict[str, float] = field(default_factory=dict)

    @property
    def first(self) -> Round:
        """The first scan."""
        return self.rounds[0]

    @property
    def round(self) -> Round:
        """The present scan."""
        return self.rounds[-1]

    def certified_area_ratio(self) -> float:
        """Returns the share of the area that the plan is certified to see; NaN = not planned."""
        return math.nan if self.first.planned is None else self.first.planned.coverage.area_ratio

    def summary(
        self,
        job: Mapping[str, Any],
        error: Mapping[str, Any] | None,
        cell: CellConfig,
        scan: ScanSettings | None,
    ) -> dict[str, Any]:
        """Returns the document ``summary.json``; stages that the job did not reach are left out.

        Args:
            job: What is known about the job; at least ``id`` and ``state``.
            error: Where and why it failed; None = it did not.
            cell: The cell.
            scan: Scan settings of the part; None = the part could not be read.
        """
        document: dict[str, Any] = {"job": dict(job)}
        if error is not None:
            document["error"] = dict(error)
        document.update(self._planning(cell, scan))
        document["localization"] = [entry.document() for entry in self.localizations]
        document["rescans"] = [entry.document() for entry in self.rounds[1:]]
        document["interruptions"] = [asdict(entry) for entry in self.interruptions]
        for key, figures in (
            ("identification", self.identification),
            ("measured", self._measured()),
            ("bag", self.bag),
            ("timing_s", self.timing_s),
        ):
            if figures:
                document[key] = figures
        return plain(document)

    def _measured(self) -> dict[str, Any]:
        if not self.measured:
            return {}
        certified = self.certified_area_ratio()
        return {
            **self.measured,
            "certified_area_ratio": certified,
            "area_ratio_over_certified": self.measured["area_ratio"] - certified,
        }

    def _planning(self, cell: CellConfig, scan: ScanSettings | None) -> dict[str, Any]:
        planned, stations = self.first.planned, self.first.station_plan or _NO_STATIONS
        if planned is None or scan is None:
            return {}
        trajectories = self.first.final_trajectories()
        complete = self.first.station_plan is not None and len(trajectories) == len(
            stations.stations
        )
        cycle = (
            cycle_time(stations, trajectories, cell, scan, planned.path)
            if complete
            else _UNKNOWN_CYCLE
        )
        document = planning_summary(
            triangles=planned.triangles,
            area_m2=planned.area_m2,
            mesh_sha256=planned.mesh_sha256,
            path=planned.path,
            coverage=planned.coverage,
            station_plan=stations,
            trajectories=trajectories,
            cycle=cycle,
            planning_s=self.planning_s,
            timed=self.timed,
        )
        reached = {
            "stations": self.first.station_plan is not None,
            "trajectory": complete,
            "plan_hash": complete,
        }
        return {key: value for key, value in document.items() if reached.get(key, True)}


_NO_STATIONS = StationPlan("", (), 0, 0, False, math.nan, ())
_UNKNOWN_CYCLE = CycleTime(math.nan, math.nan, math.nan, math.nan, math.nan, 0, math.nan)
