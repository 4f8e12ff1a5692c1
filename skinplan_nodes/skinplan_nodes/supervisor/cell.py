"""What a job asks of the cell, in the library's own types; ``ros_cell.py`` is the cell on ROS."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from skinplan.jobs.model import Job
from skinplan.scan_path.model import ScanPath
from skinplan.stations.model import StationPlan
from skinplan.trajectory.model import Segment, StationTrajectory
from skinplan.transforms import Array
from skinplan_nodes.supervisor.run_data import PlannedPath


@dataclass(frozen=True, eq=False)
class Located:
    """Answer of the localiser.

    Attributes:
        T_arm_base_workpiece: shape (4, 4) [m].
        T_map_workpiece: By the base's own idea of where it stands, shape (4, 4) [m].
        quality: E of eq (3).
        attempts: Estimates made.
        stamp_s: Time of the image on the cell's clock [s].
    """

    T_arm_base_workpiece: Array
    T_map_workpiece: Array
    quality: float
    attempts: int
    stamp_s: float


class Cell(Protocol):
    """What a job asks of the cell. Every method waits, bounded, and raises `StepError`."""

    def wait_ready(self) -> None:
        """Waits until all nodes that a job needs are alive."""

    def now_s(self) -> float:
        """Returns the cell's time [s]."""

    def start_recording(self, folder: Path, metadata: Mapping[str, str]) -> None:
        """Opens the bag."""

    def stop_recording(self) -> dict[str, Any]:
        """Closes the bag; returns path, messages, bytes."""

    def start_inspection(self, job: Job) -> None:
        """Begins to collect scan frames."""

    def finish_inspection(
        self, job: Job, cloud: Path, timeout_s: float | None = None
    ) -> dict[str, Any]:
        """Merges and measures; returns the figures of ``measured`` in ``summary.json``."""

    def drive(self, T_map_base_link: Array) -> None:
        """Drives the base to a pose."""

    def localize(self, job: Job, may_move: bool) -> Located:
        """Locates the part."""

    def plan_path(self, job: Job) -> tuple[PlannedPath, dict[str, float]]:
        """Plans the scan path; returns it and the wall time of its stages."""

    def plan_stations(self, job: Job, path: ScanPath, T_map_workpiece: Array) -> StationPlan:
        """Chooses the stations."""

    def plan_trajectory(
        self, job: Job, path: ScanPath, station: int, T_arm_base_workpiece: Array, points: list[int]
    ) -> StationTrajectory | None:
        """Makes the arm's motion at one station; None = not one point can be scanned from it."""

    def execute(self, segment: Segment) -> None:
        """Moves the arm along a segment."""

    def enable_scanner(self, enabled: bool) -> None:
        """Switches the scanner."""

    def halt(self) -> None:
        """Stops arm and base at once and switches the scanner off, as far as they answer."""
