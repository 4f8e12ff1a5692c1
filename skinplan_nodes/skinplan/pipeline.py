"""The planning stages and their composition: mesh, scan path, coverage, stations, trajectories.

Each stage is one pure method of one room; the pipeline measures it and re-raises its error with the
stage's name and index.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from skinplan.errors import CancelledError, InputError, SkinplanError, StageError
from skinplan.inspection.gaps import missing_samples
from skinplan.mesh.model import SurfaceMesh
from skinplan.mesh.prepare import PreparedMesh, prepare_mesh
from skinplan.part.inspection_points import InspectionPoints
from skinplan.part.model import Fixture, Part, ScanSettings
from skinplan.plan_record import planning_summary, write_json, write_plan_files
from skinplan.robot.arm import JOINT_NAMES
from skinplan.robot.cell import CellConfig
from skinplan.robot.tracker import TrackerSight
from skinplan.scan_path.model import ScanPath
from skinplan.scan_path.plan import STRATEGIES as SCAN_PATH_STRATEGIES
from skinplan.scan_path.plan import plan_scan_path
from skinplan.scan_path.rescan import rescan_path
from skinplan.scanner.coverage_ply import write_coverage_ply
from skinplan.scanner.document import coverage_document
from skinplan.scanner.predict import Prediction, part_certifier, predict_coverage
from skinplan.stations.marker_view import MarkerView
from skinplan.stations.model import StationPlan
from skinplan.stations.plan import STRATEGIES as STATION_STRATEGIES
from skinplan.stations.plan import plan_stations
from skinplan.strategies import chosen
from skinplan.trajectory.assemble import TIMINGS
from skinplan.trajectory.certify import TimedCoverage, certify_trajectories
from skinplan.trajectory.cycle import CycleTime, cycle_time
from skinplan.trajectory.model import StationTrajectory
from skinplan.trajectory.passes import optimise_passes
from skinplan.trajectory.plan import STRATEGIES as ORDER_STRATEGIES
from skinplan.trajectory.plan import plan_trajectories
from skinplan.transforms import Array

Progress = Callable[[float, str], None]
Result = TypeVar("Result")

STAGES = ("mesh", "scan_path", "coverage", "stations", "trajectory")
# Share of the whole planning time that each stage takes on the sample parts, for the progress bar.
_SHARES = {
    "mesh": 0.05,
    "scan_path": 0.2,
    "coverage": 0.1,
    "stations": 0.3,
    "trajectory": 0.35,
}


def stage_shares(stages: Sequence[str]) -> dict[str, float]:
    """Returns about which share of the planning time each of some stages takes."""
    total = sum(_SHARES[name] for name in stages)
    return {name: _SHARES[name] / total for name in stages}


@dataclass(frozen=True, eq=False)
class Plan:
    """A whole plan at the part's nominal place.

    Attributes:
        part: The part.
        prepared: Mesh, findings and regions.
        path: Scan path, workpiece frame.
        planning_s: Wall time of each stage [s].
        prediction: What the scan path sees, predicted; None = not asked for.
        station_plan: Stations, map frame; None = not asked for.
        trajectories: Of all stations, in the order of visit; empty = not asked for.
        cycle: Cycle time figures; None = not asked for.
        timed: What the trajectories see at the scanner's frames; None = not asked for.
    """

    part: Part
    prepared: PreparedMesh
    path: ScanPath
    planning_s: dict[str, float]
    prediction: Prediction | None = None
    station_plan: StationPlan | None = None
    trajectories: tuple[StationTrajectory, ...] = ()
    cycle: CycleTime | None = None
    timed: TimedCoverage | None = None

    def summary(self) -> dict[str, Any]:
        """Returns the document that ``skinplan plan --json`` prints."""
        return planning_summary(
            triangles=len(self.prepared.mesh.faces),
            area_m2=self.prepared.mesh.area,
            mesh_sha256=self.part.mesh_sha256,
            path=self.path,
            coverage=None if self.prediction is None else self.prediction.figures,
            station_plan=self.station_plan,
            trajectories=self.trajectories,
            cycle=self.cycle,
            planning_s=self.planning_s,
            timed=self.timed,
        )

    def write(self, folder: Path) -> None:
        """Writes the plan's JSON files to a folder, and the coverage as coloured mesh."""
        write_plan_files(
            folder,
            self.path,
            self.station_plan,
            self.trajectories if self.cycle is not None else None,
            JOINT_NAMES,
            self.part.T_map_workpiece,
        )
        if self.prediction is not None:
            certificate = self.prediction.path
            motion = coverage_document(self.prediction.motion, with_facets=False)
            document = {**coverage_document(certificate), "along_motion": motion}
            write_json(folder / "coverage.json", document)
            write_coverage_ply(folder / "coverage.ply", self.prepared.mesh, certificate)


@dataclass
class StageRunner:
    """Runs stages one after another: measures, reports, names the stage in errors.

    Attributes:
        progress: Told the share done and what is being done.
        is_cancelled: Asked before each stage.
        planning_s: Wall time of the stages run so far [s].
        shares: Share of each stage of the whole, for the progress; the sum is 1.
    """

    progress: Progress | None = None
    is_cancelled: Callable[[], bool] | None = None
    planning_s: dict[str, float] = field(default_factory=dict)
    shares: dict[str, float] = field(default_factory=lambda: stage_shares(STAGES))

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
            before = sum(self.shares.get(name, 0.0) for name in STAGES[: STAGES.index(stage)])
            self.progress(min(before + self.shares.get(stage, 0.0) * fraction, 1.0), text)

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
    chosen("timing", scan.timing, TIMINGS)


def plan_part(
    part: Part,
    cell: CellConfig,
    progress: Progress | None = None,
    is_cancelled: Callable[[], bool] | None = None,
    until: str = STAGES[-1],
    seen: Array | None = None,
    markers: bool = True,
) -> Plan:
    """Plans a part at its nominal place, from the mesh to the timed trajectories.

    Args:
        part: What to measure, with the strategies' names.
        cell: Where and with what.
        progress: Told the share done and what is being done.
        is_cancelled: Asked between and inside the stages.
        until: Last stage wanted, ``scan_path`` or a later one of `STAGES`.
        seen: Points that a run has measured, workpiece frame, shape (n, 3) [m]: only what they
            leave out is planned; None = the whole part.
        markers: Whether the camera has to see the part's markers, if it has any, from each
            station.

    Returns:
        The plan, up to the stage asked for.

    Raises:
        InputError: No such stage.
        StageError: A stage failed; its ``cause`` says why.
        CancelledError: The caller asked to stop.
    """
    if until not in STAGES[1:]:
        raise InputError(
            f"a plan until {until!r} was asked for; accepted are {', '.join(STAGES[1:])}"
        )
    wanted = STAGES[: STAGES.index(until) + 1]
    stages = StageRunner(progress, is_cancelled, shares=stage_shares(wanted))
    scan = part.scan
    prepared = stages.run("mesh", lambda: prepare_mesh(part))
    mesh, segmentation = prepared.mesh, prepared.segmentation
    path = stages.run(
        "scan_path", lambda: plan_path(prepared, scan, seen, part.points, part.fixture)
    )
    planned = Plan(part, prepared, path, stages.planning_s)
    if "coverage" not in wanted:
        return planned
    prediction = stages.run(
        "coverage", lambda: predict_coverage(mesh, segmentation, path, scan, part.fixture)
    )
    planned = replace(planned, prediction=prediction)
    if "stations" not in wanted:
        return planned
    station_plan = stages.run(
        "stations",
        lambda: plan_stations(
            path,
            part.T_map_workpiece,
            mesh,
            scan,
            cell,
            stages.within("stations"),
            is_cancelled,
            MarkerView(part.fixture) if markers and part.fixture.markers else None,
        ),  # fmt: skip
    )
    planned = replace(planned, station_plan=station_plan)
    if "trajectory" not in wanted:
        return planned
    trajectories, timed = stages.run(
        "trajectory",
        lambda: _motion(part, mesh, path, station_plan, prediction, cell, stages, is_cancelled),
    )
    cycle = cycle_time(station_plan, trajectories, cell, scan, path)
    return replace(planned, trajectories=trajectories, cycle=cycle, timed=timed)


def _motion(
    part: Part,
    mesh: SurfaceMesh,
    path: ScanPath,
    station_plan: StationPlan,
    prediction: Prediction,
    cell: CellConfig,
    stages: StageRunner,
    is_cancelled: Callable[[], bool] | None,
) -> tuple[tuple[StationTrajectory, ...], TimedCoverage]:
    """The trajectories of all stations, and what they will see."""
    scan, place = part.scan, part.T_map_workpiece
    trajectories = plan_trajectories(
        path,
        station_plan,
        place,
        mesh,
        scan,
        cell,
        progress=stages.within("trajectory"),
        is_cancelled=is_cancelled,
    )
    sight = TrackerSight(cell, mesh, place, station_plan.T_map_tracker)
    return trajectories, certify_trajectories(
        prediction.certifier,
        trajectories,
        station_plan.stations,
        place,
        cell,
        scan.frame_rate_hz,
        sight,
    )


def plan_path(
    prepared: PreparedMesh,
    scan: ScanSettings,
    seen: Array | None = None,
    points: InspectionPoints | None = None,
    fixture: Fixture | None = None,
) -> ScanPath:
    """Plans the scan path of a part, or of what a run has left out.

    With ``optimise_passes`` depth and angles of its passes are optimised (T S3). A re-scan is not:
    its poses were chosen for gaps that the certificate of the whole part does not know.

    Args:
        prepared: The part's mesh.
        scan: Scan settings.
        seen: Points that a run has measured, workpiece frame, shape (n, 3) [m]; None = the whole
            part is planned.
        points: The part's measuring points, for strategy ``points``; None = it has none.
        fixture: What may hide the part, for the certificate; None = the part alone.

    Raises:
        NothingMissingError: The run left nothing out.
        SkinplanError: As `plan_scan_path`.
    """
    chosen("scan path", scan.strategy, SCAN_PATH_STRATEGIES)
    mesh, segmentation = prepared.mesh, prepared.segmentation
    if seen is None:
        path = plan_scan_path(mesh, segmentation, scan, points)
        if not scan.optimise_passes:
            return path
        certifier = part_certifier(mesh, segmentation, scan, fixture, with_seeable=False)
        return optimise_passes(path, mesh, segmentation, scan, certifier)[0]
    return rescan_path(mesh, segmentation, scan, missing_samples(mesh, seen))
