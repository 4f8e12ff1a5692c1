"""The steps of a job, in the order of the paper's Fig. 19. Needs no ROS: `Cell` is the wall.

drive to the work position -> localise (approach until E >= T_E) -> scan path, stations -> for every
station: drive, localise, trajectory, scan -> merge and inspect -> close the bag.
"""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from skinplan.errors import SkinplanError
from skinplan.jobs.model import Job
from skinplan.part.model import Part
from skinplan.robot.cell import CellConfig
from skinplan.scan_path.model import ScanPath
from skinplan.stations.model import SkippedPoint, Station, StationPlan
from skinplan.trajectory.model import SCAN, StationTrajectory
from skinplan.transforms import Array
from skinplan_nodes.supervisor.cell import Cell, Located
from skinplan_nodes.supervisor.control import JobControl, StepError
from skinplan_nodes.supervisor.progress import Progress
from skinplan_nodes.supervisor.run_data import Localization, PlannedPath, RunData
from skinplan_nodes.supervisor.run_folder import RunFolder

# Status code of errors that are nobody's in particular (``skinplan_msgs/Status``).
_INTERNAL = 1000
_log = logging.getLogger(__name__)


@dataclass
class Mission:
    """One job on its way through the cell.

    Attributes:
        job: The order.
        part: What is measured.
        config: The cell's figures.
        cell: The cell.
        folder: Where the run is kept.
        control: Switches of the job.
        on_progress: Told after every change.
        data: What was gathered so far.
    """

    job: Job
    part: Part
    config: CellConfig
    cell: Cell
    folder: RunFolder
    control: JobControl
    on_progress: Callable[[Progress], None]
    data: RunData
    _progress: Progress = Progress()
    _recording: bool = False

    def run(self) -> None:
        """Runs all steps.

        Raises:
            StepError: A step failed; `StepError.step` names it.
        """
        with self._step("starting", 0.0):
            self.cell.wait_ready()
            self.cell.start_recording(self.folder.bag, self._metadata())
            self._recording = True
            self.cell.start_inspection(self.job)
        with self._step("driving", 0.01):
            self.cell.drive(self.config.T_map_work)
        with self._step("localizing", 0.03):
            found = self._localize(0, may_move=True)
        with self._step("planning", 0.06):
            planned = self._plan_path()
            plan = self._plan_stations(planned.path, found.T_map_workpiece)
        for station in plan.stations:
            if self.control.stopping:
                break
            self._measure_station(planned.path, station, len(plan.stations))
        with self._step("inspecting", 0.94):
            self.data.measured = self.cell.finish_inspection(self.job, self.folder.cloud)

    def close(self) -> None:
        """Closes the bag, also after a failure; what fails here is noted, not raised."""
        if not self._recording:
            return
        self._recording = False
        self._report("closing", 0.97)
        try:
            self.data.bag = self.cell.stop_recording()
        except SkinplanError as error:
            self.folder.note(f"closing: {error}")
            _log.error("job %s: closing the bag: %s", self.job.job_id, error)

    def _measure_station(self, path: ScanPath, station: Station, count: int) -> None:
        number = self._progress.station + 1
        begin, share = 0.12 + 0.82 * (number - 1) / count, 0.82 / count
        points = sorted({*map(int, station.points), *self.data.left_over()})
        with self._step("driving", begin, station=number):
            self.cell.drive(station.T_map_base_link)
        with self._step("localizing", begin + 0.06 * share):
            found = self._localize(number, may_move=False)
        with self._step("planning", begin + 0.12 * share):
            trajectory = self._plan_trajectory(path, station, found.T_arm_base_workpiece, points)
        self._scan(trajectory, begin + 0.2 * share, 0.8 * share)

    def _localize(self, station: int, may_move: bool) -> Located:
        found = self.cell.localize(self.job, may_move)
        self.data.localizations.append(
            Localization(
                station, found.quality, found.attempts, found.stamp_s, found.T_arm_base_workpiece
            )
        )
        self.folder.note(
            f"station {station}: part located, E = {found.quality:.3f}, attempt {found.attempts}"
        )
        return found

    def _plan_path(self) -> PlannedPath:
        planned, stages = self.cell.plan_path(self.job)
        self.data.planned = planned
        self.data.planning_s.update(stages)
        self.folder.write_plan(path=planned.path, coverage=planned.coverage)
        self.folder.note(f"scan path of {len(planned.path)} points")
        return planned

    def _plan_stations(self, path: ScanPath, T_map_workpiece: Array) -> StationPlan:
        begin = time.perf_counter()
        plan = self.cell.plan_stations(self.job, path, T_map_workpiece)
        self.data.planning_s["stations"] = time.perf_counter() - begin
        self.data.station_plan = plan
        self.folder.write_plan(station_plan=plan, T_map_workpiece=T_map_workpiece)
        self.folder.note(f"{len(plan.stations)} stations")
        self._progress = self._progress.planned(plan, self.config.settle_s)
        return plan

    def _plan_trajectory(
        self, path: ScanPath, station: Station, T_arm_base_workpiece: Array, points: list[int]
    ) -> StationTrajectory:
        begin = time.perf_counter()
        made = self.cell.plan_trajectory(self.job, path, station.id, T_arm_base_workpiece, points)
        spent = time.perf_counter() - begin
        self.data.planning_s["trajectory"] = self.data.planning_s.get("trajectory", 0.0) + spent
        if made is None:
            reason = "not reachable from this station"
            made = StationTrajectory(station.id, (), tuple(SkippedPoint(p, reason) for p in points))
        self.data.trajectories.append(made)
        self.folder.write_plan(trajectories=self.data.trajectories)
        self.folder.note(
            f"station {station.id + 1}: {len(points)} points, {len(made.skipped)} left out, "
            f"scan {made.scan_s:.1f} s, transit {made.transit_s:.1f} s"
        )
        return made

    def _scan(self, trajectory: StationTrajectory, begin: float, share: float) -> None:
        """Executes the segments; the scanner is on during SCAN segments only."""
        total = max(trajectory.scan_s + trajectory.transit_s, 1e-9)
        done = 0.0
        for segment in trajectory.segments:
            self.control.hold()
            scanning = segment.kind == SCAN
            self._progress = self._progress.left(total - done)
            with self._step("scanning" if scanning else "moving", begin + share * done / total):
                self._switch(scanning)
                self.cell.execute(segment)
            done += segment.duration_s
        with self._step("moving", begin + share):
            self._switch(False)

    def _switch(self, scanning: bool) -> None:
        if scanning != self._progress.scanner_on:
            self.cell.enable_scanner(scanning)
            self._progress = self._progress.switched(scanning)

    @contextmanager
    def _step(self, name: str, share: float, station: int | None = None) -> Iterator[None]:
        """Reports a step; an error inside is raised with the step's name."""
        self.control.check()
        self._report(name, share, station)
        try:
            yield
        except StepError as error:
            error.step = self._progress.title
            raise
        except SkinplanError as error:
            raise _named(error, self._progress.title) from error

    def _report(self, name: str, share: float, station: int | None = None) -> None:
        before = (self._progress.sub_state, self._progress.station)
        self._progress = self._progress.at(name, share, station)
        if (name, self._progress.station) != before:
            self.folder.note(self._progress.title)
        self.on_progress(self._progress)

    def _metadata(self) -> dict[str, str]:
        job = self.job
        named = {"job_id": job.job_id, "order_id": job.order_id, "serial_number": job.serial_number}
        part = {
            "part": self.part.id,
            "part_uri": job.part_uri,
            "mesh_sha256": self.part.mesh_sha256,
        }
        return {**named, **part, **dict(job.attributes)}


def _named(error: SkinplanError, step: str) -> StepError:
    found = StepError(_INTERNAL, str(error))
    found.step = step
    return found
