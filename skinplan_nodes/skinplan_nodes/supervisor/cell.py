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
from skinplan_nodes.supervisor.control import StepError
from skinplan_nodes.supervisor.identification import Identified
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


class Planners(Protocol):
    """What a job asks of the planners; waits and errors as of `Cell`."""

    def plan_path(self, job: Job, seen: Path | None) -> tuple[PlannedPath, dict[str, float]]:
        """Plans the scan path, or only what a cloud leaves out.

        Returns:
            The path, and the wall time of its stages [s].
        """

    def plan_stations(self, job: Job, path: ScanPath, T_map_workpiece: Array) -> StationPlan:
        """Chooses the stations."""

    def plan_trajectory(
        self, job: Job, path: ScanPath, station: int, T_arm_base_workpiece: Array, points: list[int]
    ) -> StationTrajectory | None:
        """Makes the arm's motion at one station, from where the arm stands.

        Returns:
            None = not one point can be scanned from it.
        """

    def encoded_path(self) -> bytes:
        """Returns the path planned last, to be kept on disk."""

    def encoded_stations(self) -> bytes:
        """Returns the stations planned last, to be kept on disk."""

    def encoded_trajectory(self, trajectory: StationTrajectory) -> bytes:
        """Returns a trajectory, to be kept on disk."""

    def restore_path(self, content: bytes) -> PlannedPath:
        """Takes a path from disk as the one planned last."""

    def restore_stations(self, content: bytes, T_map_workpiece: Array) -> StationPlan:
        """Takes stations from disk as those planned last."""

    def restored_trajectory(self, content: bytes) -> StationTrajectory:
        """Returns a trajectory from disk."""


class Recognizer(Protocol):
    """What a job asks of the recognizer; waits and errors as of `Cell`."""

    def identify(self, job: Job, others: tuple[Path, ...], located: Located) -> Identified:
        """Says which part stands where the job's was located.

        Args:
            job: The job.
            others: Part files of what else may stand there.
            located: Where.
        """


class Cell(Protocol):
    """What a job asks of the cell.

    Every method waits, bounded, and raises `StepError`; those that stop or close something do not
    let themselves be interrupted.

    Attributes:
        planners: The planners.
        recognizer: The recognizer.
    """

    planners: Planners
    recognizer: Recognizer

    def wait_ready(self) -> None:
        """Waits until all nodes that a job needs are alive and the cell's time runs."""

    def now_s(self) -> float:
        """Returns the cell's time [s]."""

    def start_recording(self, folder: Path, metadata: Mapping[str, str]) -> None:
        """Opens a part of the bag."""

    def is_recorded(self, folder: Path, metadata: Mapping[str, str]) -> bool:
        """Whether the recorder writes this part; one that writes none begins it, if it can."""

    def stop_recording(self) -> dict[str, Any]:
        """Closes the bag's part; returns path, messages, bytes."""

    def recorder_pid(self) -> int:
        """Returns the process of the recorder, 0 = it is not there."""

    def recorder_failure(self) -> str:
        """Returns why the recorder can't write; empty = it can, or is not there."""

    def start_inspection(self, job: Job, folder: Path, resume: bool = False) -> int:
        """Begins to collect scan frames, or goes on; returns how many there are already."""

    def finish_inspection(
        self, job: Job, cloud: Path, timeout_s: float | None = None, go_on: bool = False
    ) -> dict[str, Any]:
        """Merges and measures; returns the figures of ``measured`` in ``summary.json``."""

    def drive(self, T_map_base_link: Array) -> None:
        """Drives the base to a pose."""

    def localize(self, job: Job, may_move: bool, new_place: bool, quality: float = 0.0) -> Located:
        """Locates the part.

        Args:
            job: The job.
            may_move: The base may come nearer.
            new_place: The part may stand elsewhere than when it was located last.
            quality: T_E of eq (3); 0 = the cell's.
        """

    def base_moved_m(self) -> float:
        """Returns how far the base is from where it located the part; NaN = not known [m]."""

    def arm_joints(self) -> Array | None:
        """Returns where the arm stands, shape (6,) [rad]; None = not known."""

    def execute(self, segment: Segment) -> None:
        """Moves the arm along a segment."""

    def enable_scanner(self, enabled: bool) -> None:
        """Switches the scanner."""

    def meet(self) -> None:
        """Waits, bounded, until the devices of a cell that runs already are found and heard."""

    def halt(self, stop_devices: bool) -> None:
        """Stops arm and base, switches the scanner off, and sees to it that nothing moves.

        Args:
            stop_devices: Also by the devices' own stop, after which they refuse orders until they
                are reset. Without, it is used when something still moves.
        """

    def not_recovered(self) -> StepError | None:
        """Returns what is still missing after a failure that recovers by itself."""

    def reset_devices(self, all_devices: bool) -> None:
        """Resets the devices that we stopped, or all that stand still because of a fault."""
