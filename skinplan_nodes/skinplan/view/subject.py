"""What the pictures are made of: as much of a plan as there is."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from skinplan.mesh.model import Finding, Segmentation, SurfaceMesh
from skinplan.pipeline import Plan
from skinplan.robot.cell import CellConfig
from skinplan.scan_path.model import ScanPath
from skinplan.scanner.model import Coverage, ScannerModel
from skinplan.stations.model import SkippedPoint, StationPlan
from skinplan.trajectory.cycle import CycleTime
from skinplan.trajectory.model import StationTrajectory
from skinplan.transforms import Array


@dataclass(frozen=True, eq=False)
class Subject:
    """A part and what is planned for it; None = not planned, then it is not shown.

    Attributes:
        part_id: Name of the part.
        mesh: The checked mesh, workpiece frame.
        segmentation: Its complex regions.
        findings: What the mesh doctor found.
        path: Scan path, workpiece frame.
        scanner: Field of view, range and incidence limit.
        coverage: What the scan path sees.
        rows_only: What conventional row cutting over the whole part sees (Fig. 21 of M).
        station_plan: Stations, map frame.
        skipped: Points that are not scanned, of the stations and of the trajectories.
        T_map_workpiece: Nominal place of the part in the shop, shape (4, 4) [m].
        cell: The cell.
        trajectories: What the arm does at the stations.
        cycle: What the whole plan costs.
        tcp_speed_m_s: Speed limit of the scanner while it scans [m/s].
        order_strategy: Name of the strategy that chose the order of visit.
    """

    part_id: str
    mesh: SurfaceMesh
    segmentation: Segmentation
    findings: tuple[Finding, ...] = ()
    path: ScanPath | None = None
    scanner: ScannerModel | None = None
    coverage: Coverage | None = None
    rows_only: Coverage | None = None
    station_plan: StationPlan | None = None
    skipped: tuple[SkippedPoint, ...] = ()
    T_map_workpiece: Array = field(default_factory=lambda: np.eye(4))
    cell: CellConfig = field(default_factory=CellConfig)
    trajectories: tuple[StationTrajectory, ...] = ()
    cycle: CycleTime | None = None
    tcp_speed_m_s: float | None = None
    order_strategy: str = ""

    @property
    def T_map_tracker(self) -> Array:
        """The tracker that the stations were planned for, or else the cell's, shape (4, 4) [m]."""
        planned = None if self.station_plan is None else self.station_plan.T_map_tracker
        return self.cell.T_map_tracker if planned is None else planned

    def station_of_points(self) -> NDArray[np.int64]:
        """Returns the place of each point's station in the order of visit, shape (n,).

        -1 for points that no station has and for skipped points.
        """
        owner = np.full(0 if self.path is None else len(self.path), -1, dtype=np.int64)
        for number, station in enumerate(self.station_plan.stations if self.station_plan else ()):
            owner[station.points] = number
        owner[[entry.point for entry in self.skipped]] = -1
        return owner


def subject_of_plan(plan: Plan, cell: CellConfig) -> Subject:
    """Collects what the pictures of a plan show.

    Args:
        plan: The plan.
        cell: The cell that it was made for.

    Returns:
        The subject.
    """
    mesh, segmentation = plan.prepared.mesh, plan.prepared.segmentation
    prediction = plan.prediction
    skipped = [] if plan.station_plan is None else [*plan.station_plan.skipped]
    for trajectory in plan.trajectories:
        skipped += trajectory.skipped
    return Subject(
        part_id=plan.part.id,
        mesh=mesh,
        segmentation=segmentation,
        findings=plan.prepared.findings,
        path=plan.path,
        scanner=ScannerModel.from_settings(plan.part.scan),
        coverage=None if prediction is None else prediction.path,
        rows_only=None if prediction is None else prediction.row_cutting,
        station_plan=plan.station_plan,
        skipped=tuple(skipped),
        T_map_workpiece=plan.part.T_map_workpiece,
        cell=cell,
        trajectories=plan.trajectories,
        cycle=plan.cycle,
        tcp_speed_m_s=plan.part.scan.tcp_speed_m_s,
        order_strategy=plan.part.scan.order_strategy,
    )
