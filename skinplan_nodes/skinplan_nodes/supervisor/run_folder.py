"""The folder of a run: complete when ``summary.json`` stands in it. Needs no ROS."""

import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skinplan.errors import JobInvalidError
from skinplan.plan_record import write_json, write_plan_files
from skinplan.robot.arm import JOINT_NAMES
from skinplan.scan_path.model import ScanPath
from skinplan.scanner.model import CoverageFigures
from skinplan.stations.model import StationPlan
from skinplan.trajectory.model import StationTrajectory
from skinplan.transforms import Array

SUMMARY = "summary.json"

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class RunFolder:
    """Paths and writers of one run.

    Attributes:
        path: Absolute path of the folder.
    """

    path: Path

    @classmethod
    def create(cls, runs_folder: Path, job_id: str) -> "RunFolder":
        """Makes the folder of a job; one that holds nothing but log files is accepted.

        Raises:
            JobInvalidError: The folder holds another run, or can't be made.
        """
        folder = cls(runs_folder / job_id)
        taken = [
            name
            for name in (SUMMARY, "bag", "plan", "state", "cloud.ply")
            if (folder.path / name).exists()
        ]
        if taken:
            raise JobInvalidError(
                f"run folder {folder.path} holds {', '.join(taken)} of an earlier run; "
                "a job id that was not used yet is accepted"
            )
        try:
            folder.log.mkdir(parents=True, exist_ok=True)
            folder.state.mkdir(exist_ok=True)
            folder.frames.mkdir(exist_ok=True)
        except OSError as error:
            raise JobInvalidError(f"run folder {folder.path} can't be made: {error}") from error
        return folder

    def bag(self, part: int = 1) -> Path:
        """Returns the folder of a part of the bag; made by the recorder.

        Args:
            part: From 1; a new one begins when the recorder was started anew.
        """
        return self.path / ("bag" if part == 1 else f"bag-{part}")

    @property
    def state(self) -> Path:
        """What a new supervisor needs to go on after this one was killed."""
        return self.path / "state"

    @property
    def journal(self) -> Path:
        """The journal."""
        return self.state / "journal.jsonl"

    @property
    def frames(self) -> Path:
        """What the inspector keeps to go on after it was ended."""
        return self.path / "frames"

    def seen(self, rescan: int) -> Path:
        """Returns the cloud that re-scan `rescan`, from 1, is planned by."""
        return self.path / f"cloud-before-rescan-{rescan}.ply"

    @property
    def cloud(self) -> Path:
        """Merged cloud."""
        return self.path / "cloud.ply"

    @property
    def log(self) -> Path:
        """Log files."""
        return self.path / "log"

    @property
    def summary(self) -> Path:
        """The file that makes the run complete."""
        return self.path / SUMMARY

    def note(self, text: str) -> None:
        """Adds a line to the job's own log, with the time of day (UTC); a full disk costs it."""
        stamp = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        try:
            with (self.log / "job.log").open("a", encoding="utf-8") as stream:
                stream.write(f"{stamp} {text}\n")
        except OSError as error:
            _log.error("%s: %s can't be noted: %s", self.log, text, error)

    def write_plan(
        self,
        path: ScanPath | None = None,
        station_plan: StationPlan | None = None,
        trajectories: Sequence[StationTrajectory] | None = None,
        T_map_workpiece: Array | None = None,
        coverage: CoverageFigures | None = None,
        rescan: int = 0,
    ) -> None:
        """Writes what of the plan is given to ``plan/``; the part's place with the stations.

        Of a re-scan to ``plan/rescan-1/`` and so on.
        """
        write_plan_files(
            self.path / "plan" / f"rescan-{rescan}" if rescan else self.path / "plan",
            path,
            station_plan,
            trajectories,
            JOINT_NAMES,
            T_map_workpiece,
            coverage,
        )

    def finish(self, summary: Mapping[str, Any]) -> None:
        """Writes ``summary.json`` in one step; after it nothing is written but the report."""
        write_json(self.summary, summary)
