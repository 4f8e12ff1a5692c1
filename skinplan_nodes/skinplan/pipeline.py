"""The planning stages and their composition: mesh, scan path, coverage, stations, trajectories.

Each stage is one pure method of one room; the pipeline measures it and re-raises its error with the
stage's name and index.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from skinplan.errors import CancelledError, SkinplanError, StageError
from skinplan.mesh.prepare import PreparedMesh, prepare_mesh
from skinplan.part.model import Part, ScanSettings
from skinplan.plan_record import planning_summary, write_plan_files
from skinplan.robot.arm import JOINT_NAMES
from skinplan.robot.cell import CellConfig
from skinplan.scan_path.model import ScanPath
from skinplan.scan_path.plan import STRATEGIES as SCAN_PATH_STRATEGIES
from skinplan.scan_path.plan import plan_scan_path
from skinplan.scanner.model import CoverageFigures
from skinplan.scanner.predict import predict_coverage
from skinplan.stations.model import StationPlan
from skinplan.stations.plan import STRATEGIES as STATION_STRATEGIES
from skinplan.stations.plan import plan_stations
from skinplan.strategies import chosen
from skinplan.trajectory.cycle import CycleTime, cycle_time
from skinplan.trajectory.model import StationTrajectory
from skinplan.trajectory.plan import STRATEGIES as ORDER_STRATEGIES
from skinplan.trajectory.plan import plan_trajectories

Progress = Callable[[float, str], None]
Result = TypeVar("Result")

STAGES = ("mesh", "scan_path", "coverage", "stations", "trajectory")
# Share of the whole planning time that each stage takes on the sample parts, for the progress bar.
_SHARES = {"mesh": 0.08, "scan_path": 0.07, "coverage": 0.15, "stations": 0.2, "trajectory": 0.5}


@dataclass(frozen=True, eq=False)
class Plan:
    """A whole plan at the part's nominal place.

    Attributes:
        part: The part.
        prepared: Mesh, findings and regions.
        path: Scan path, workpiece frame.
        coverage: What the scan path sees, predicted.
        station_plan: Stations, map frame.
        trajectories: Of all stations, in the order of visit.
        cycle: Cycle time figures.
        planning_s: Wall time of each stage [s].
    """

    part: Part
    prepared: PreparedMesh
    path: ScanPath
    coverage: CoverageFigures
    station_plan: StationPlan
    trajectories: tuple[StationTrajectory, ...]
    cycle: CycleTime
    planning_s: dict[str, float]

    def summary(self) -> dict[str, Any]:
        """Returns the document that ``skinplan plan --json`` prints."""
        return planning_summary(
            triangles=len(self.prepared.mesh.faces),
            area_m2=self.prepared.mesh.area,
            mesh_sha256=self.part.mesh_sha256,
            path=self.path,
            coverage=self.coverage,
            station_plan=self.station_plan,
            trajectories=self.trajectories,
            cycle=self.cycle,
            planning_s=self.planning_s,
        )

    def write(self, folder: Path) -> None:
        """Writes the plan's JSON files to a folder."""
        write_plan_files(
            folder,
            self.path,
            self.station_plan,
            self.trajectories,
            JOINT_NAMES,
            self.part.T_map_workpiece,
        )


@dataclass
class StageRunner:
    """Runs stages one after another: measures, reports, names the stage in errors.

    Attributes:
        progress: Told the share done and what is being done.
        is_cancelled: Asked before each stage.
        planning_s: Wall time of the stages run so far [s].
    """

    progress: Progress | None = None
    is_cancelled: Callable[[], bool] | None = None
    planning_s: dict[str, float] = field(default_factory=dict)

    def run(self, stage: str, work: Callable[[], Result]) -> Result:
        """Runs one stage.

        Args:
            stage: One of `STAGES`.
            work: The stage's work.

        Returns:
            What the work returns.

        Raises:
            StageError: The work raised a `SkinplanError`.
            CancelledError: The caller asked to stop.
        """
        if self.is_cancelled is not None and self.is_cancelled():
            raise CancelledError(f"planning was cancelled before stage {stage}")
        self.report(stage, 0.0, stage.replace("_", " "))
        begin = time.perf_counter()
        try:
            return work()
        except CancelledError:
            raise
        except SkinplanError as error:
            raise StageError(stage, STAGES.index(stage), error) from error
        finally:
            self.planning_s[stage] = time.perf_counter() - begin

    def report(self, stage: str, fraction: float, text: str) -> None:
        """Tells the progress of a stage as a share of the whole."""
        if self.progress is not None:
            before = sum(_SHARES[name] for name in STAGES[: STAGES.index(stage)])
            self.progress(before + _SHARES[stage] * fraction, text)

    def within(self, stage: str) -> Progress:
        """Returns the progress callback that a stage gets."""
        return lambda fraction, text: self.report(stage, fraction, text)


def check_strategies(scan: ScanSettings) -> None:
    """Makes sure that all strategies asked for exist, before anything is done.

    Raises:
        StrategyUnknownError: One does not; the message lists those that do.
    """
    chosen("scan path", scan.strategy, SCAN_PATH_STRATEGIES)
    chosen("station", scan.station_strategy, STATION_STRATEGIES)
    chosen("order", scan.order_strategy, ORDER_STRATEGIES)


def plan_part(
    part: Part,
    cell: CellConfig,
    progress: Progress | None = None,
    is_cancelled: Callable[[], bool] | None = None,
) -> Plan:
    """Plans a part at its nominal place, from the mesh to the timed trajectories.

    Args:
        part: What to measure, with the strategies' names.
        cell: Where and with what.
        progress: Told the share done and what is being done.
        is_cancelled: Asked between and inside the stages.

    Returns:
        The plan.

    Raises:
        StageError: A stage failed; its ``cause`` says why.
        CancelledError: The caller asked to stop.
    """
    stages = StageRunner(progress, is_cancelled)
    scan = part.scan
    prepared = stages.run("mesh", lambda: prepare_mesh(part))
    mesh, segmentation = prepared.mesh, prepared.segmentation
    path = stages.run("scan_path", lambda: plan_scan_path(mesh, segmentation, scan))
    coverage = stages.run("coverage", lambda: predict_coverage(mesh, segmentation, path, scan))
    station_plan = stages.run(
        "stations",
        lambda: plan_stations(
            path, part.T_map_workpiece, mesh, scan, cell, stages.within("stations"), is_cancelled
        ),
    )
    trajectories = stages.run(
        "trajectory",
        lambda: plan_trajectories(
            path,
            station_plan,
            part.T_map_workpiece,
            mesh,
            scan,
            cell,
            progress=stages.within("trajectory"),
            is_cancelled=is_cancelled,
        ),
    )
    cycle = cycle_time(station_plan, trajectories, cell, scan, path)
    return Plan(
        part, prepared, path, coverage, station_plan, trajectories, cycle, dict(stages.planning_s)
    )
