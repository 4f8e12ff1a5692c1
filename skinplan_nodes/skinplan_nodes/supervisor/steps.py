"""What a job does in each of its working states, in the order of the paper's Fig. 19.

drive to the work position -> identify the part where its file asks for it -> localise (approach
until E >= T_E) -> scan path, stations -> for every station: drive, localise, trajectory, scan ->
merge and inspect -> what is missing is planned and scanned again -> close the bag. Every step
returns the event that `machine` goes on by. Needs no ROS: `Cell` is the wall.
"""

import math
import time
from dataclasses import dataclass, field

import numpy as np

from skinplan.jobs.model import Job
from skinplan.part.recognition_plan import RecognitionPlan
from skinplan.robot.cell import CellConfig
from skinplan.trajectory.model import SCAN, Segment, StationTrajectory
from skinplan_nodes.supervisor import reentry
from skinplan_nodes.supervisor.bag_parts import BagParts
from skinplan_nodes.supervisor.cell import Cell, Located
from skinplan_nodes.supervisor.control import StepError
from skinplan_nodes.supervisor.identification import Identified
from skinplan_nodes.supervisor.machine import Event
from skinplan_nodes.supervisor.place import Place, nothing_reached
from skinplan_nodes.supervisor.progress import Progress
from skinplan_nodes.supervisor.record import RunRecord
from skinplan_nodes.supervisor.rough_place import rough_place
from skinplan_nodes.supervisor.run_data import Round

_NOTHING_MISSING, _NO_CANDIDATES, _NOTHING_REACHED, _NO_TRACKER = 122, 400, 401, 403
_START_STATE = 500
_NO_TRAJECTORY, _NO_CLOUD, _ALIGNMENT_FAILED, _NOT_INSPECTING = 501, 901, 902, 903
_NOTHING_TO_RESCAN = (_NOTHING_MISSING, _NO_CANDIDATES, _NOTHING_REACHED, _NO_TRACKER)
_NOTHING_MEASURED = (_NO_CLOUD, _ALIGNMENT_FAILED)
# The arm stands in its home position within this, largest difference of a joint [rad].
_AT_HOME_RAD = 0.02
# E of eq (3) that says well enough where the part lies to be compared with what the camera sees.
_ROUGH = 0.05


@dataclass(frozen=True)
class RescanSettings:
    """When what is missing is scanned again.

    Attributes:
        most: At most so many times.
        least_missing_ratio: When the measured share of the area is lower than the certified one by
            more than this [1].
    """

    most: int = 2
    least_missing_ratio: float = 0.002


@dataclass
class Steps:
    """The steps of one job.

    Attributes:
        job: The order.
        config: The cell's figures.
        cell: The cell.
        record: Keeps what was found and done.
        bag: Parts of the bag.
        rescans: When what is missing is scanned again.
        recognition: Whether the part is identified before it is measured.
        place: Where in its plan the job is.
        progress: How far it is.
        stopped: The job was told to stop: what was measured is its result.
        left: Where the job before this one has left the arm; None = at home.
    """

    job: Job
    config: CellConfig
    cell: Cell
    record: RunRecord
    bag: BagParts
    rescans: RescanSettings
    recognition: RecognitionPlan = RecognitionPlan()
    place: Place = field(default_factory=Place)
    progress: Progress = field(default_factory=Progress)
    stopped: bool = False
    left: Place | None = None
    segment_began_s: float = math.inf

    def starting(self) -> Event:
        """Waits for the nodes, opens the bag, begins to collect scan frames."""
        self.cell.reset_devices(all_devices=False)
        self.cell.wait_ready()
        self.bag.open()
        self.cell.start_inspection(self.job, self.record.folder.frames)
        return Event.DONE

    def driving(self) -> Event:
        """Drives to the work position, or to the next station, with the arm at home."""
        place = self.place
        self._bring_home()
        place.trajectory, place.segment, place.rest, place.located = None, 0, None, None
        goal = self.config.T_map_work if place.plan is None else place.here.T_map_base_link
        self.cell.drive(goal)
        to_check = self.recognition.check and not self.record.data.identification
        return Event.TO_BE_CHECKED if place.plan is None and to_check else Event.DONE

    def localizing(self) -> Event:
        """Locates the part."""
        place = self.place
        at_work = place.plan is None
        # A job's first look is the one that may move; between its stations the part stands still.
        found = self.cell.localize(self.job, may_move=at_work, new_place=at_work)
        place.located = found
        self.record.located(place.station, found)
        if not at_work:
            return Event.AT_STATION
        place.T_map_workpiece = found.T_map_workpiece
        return Event.DONE

    def identifying(self) -> Event:
        """Makes sure that the part on the fixture is the job's, before the base comes nearer.

        From the work position the camera sees most of the part, and its markers, or its shape,
        well enough to know how it lies.
        """
        others = self.recognition.others
        found = rough_place(self._roughly, self.job, others)
        if not isinstance(found, Identified):
            found = self.cell.recognizer.identify(self.job, others, found)
        self.record.identified(found)
        found.require()
        return Event.DONE

    def _roughly(self, job: Job) -> Located:
        return self.cell.localize(job, may_move=False, new_place=True, quality=_ROUGH)

    def planning_path(self) -> Event:
        """Plans the scan path, of a re-scan what is missing."""
        place = self.place
        seen = self.record.folder.seen(place.rescan) if place.rescan else None
        if place.rescan and len(self.record.data.rounds) <= place.rescan:
            self.record.data.rounds.append(Round())
        try:
            planned, stages = self.cell.planners.plan_path(self.job, seen)
        except StepError as error:
            if place.rescan and error.code in _NOTHING_TO_RESCAN:
                self.record.folder.note(f"no re-scan: {error}")
                self.record.data.rounds.pop()
                return Event.COMPLETE
            raise
        place.planned = planned
        self.record.path(planned, stages, place.rescan)
        return Event.DONE

    def planning_stations(self) -> Event:
        """Chooses the stations."""
        place = self.place
        assert place.planned is not None and place.T_map_workpiece is not None
        begin = time.perf_counter()
        try:
            plan = self.cell.planners.plan_stations(
                self.job, place.planned.path, place.T_map_workpiece
            )
        except StepError as error:
            if place.rescan and error.code in _NOTHING_TO_RESCAN:
                self.record.folder.note(f"what is missing can't be reached: {error}")
                return Event.COMPLETE
            raise
        spent_s = time.perf_counter() - begin
        place.plan, place.station = plan, 1
        self.record.stations(plan, place.T_map_workpiece, spent_s, place.rescan)
        self.progress = self.progress.planned(plan, self.config, place.rescan)
        return Event.DONE

    def planning_trajectory(self) -> Event:
        """Plans what the arm does here: the points that were not scanned yet, and the way home."""
        place = self.place
        assert place.planned is not None and place.located is not None
        points = self._points_to_scan()
        begin = time.perf_counter()
        made = None
        if points:
            made = self.cell.planners.plan_trajectory(
                self.job,
                place.planned.path,
                place.here.id,
                place.located.T_arm_base_workpiece,
                points,
            )
        if self.at_home():
            place.left_home = len(place.executed)
        if made is None and not self.at_home():
            self._require_way_home(points)
            made = self._way_home()
        if made is None:
            made = nothing_reached(place.here.id, points)
        whole = place.adopt(made)
        spent_s = time.perf_counter() - begin
        self.record.trajectory(whole, len(place.executed), len(points), spent_s, place.rescan)
        return self._next_segment()

    def moving(self) -> Event:
        """Executes a segment with the scanner off."""
        return self._execute(scanning=False)

    def scanning(self) -> Event:
        """Executes a segment with the scanner on."""
        return self._execute(scanning=True)

    def inspecting(self) -> Event:
        """Merges and measures what there is, and decides whether to scan what is missing."""
        place, data = self.place, self.record.data
        if place.rescan >= self.rescans.most or data.first.planned is None:
            return Event.COMPLETE
        cloud = self.record.folder.seen(place.rescan + 1)
        measured = self.cell.finish_inspection(self.job, cloud, go_on=True)
        data.round.measured = data.measured = measured
        missing = data.certified_area_ratio() - measured["area_ratio"]
        self.record.folder.note(
            f"measured {measured['area_ratio']:.4f} of the area, certified "
            f"{data.certified_area_ratio():.4f}"
        )
        if not missing > self.rescans.least_missing_ratio:
            return Event.COMPLETE
        place.replan()
        return Event.MISSING

    def finishing(self) -> Event:
        """Merges and measures for good."""
        data = self.record.data
        try:
            data.measured = self.cell.finish_inspection(self.job, self.record.folder.cloud)
            data.round.measured = data.measured
        except StepError as error:
            if error.code == _NOT_INSPECTING and data.measured:
                # The inspector has ended the session with its last figures.
                self._keep_last_cloud()
                return Event.DONE
            if not (self.stopped and error.code in (*_NOTHING_MEASURED, _NOT_INSPECTING)):
                raise
            self.record.folder.note(f"stopped before anything could be measured: {error}")
        self._drop_unused_cloud()
        return Event.DONE

    def closing(self) -> Event:
        """Closes the bag."""
        self.record.data.bag = self.bag.close()
        return Event.DONE

    def _keep_last_cloud(self) -> None:
        folder = self.record.folder
        last = folder.seen(self.place.rescan + 1)
        if last.is_file() and not folder.cloud.exists():
            last.rename(folder.cloud)

    def _drop_unused_cloud(self) -> None:
        """A cloud that no re-scan was planned by is the same as the final one."""
        folder = self.record.folder
        if folder.cloud.exists():
            folder.seen(self.place.rescan + 1).unlink(missing_ok=True)

    def at_home(self) -> bool:
        """Whether the arm stands in its home position; where it is not known, it is taken to."""
        joints = self.cell.arm_joints()
        return joints is None or bool(
            np.abs(joints - np.asarray(self.config.home_rad)).max() < _AT_HOME_RAD
        )

    def _bring_home(self) -> None:
        """Brings the arm home the way that it has come, where something has left it elsewhere."""
        joints = self.cell.arm_joints()
        if joints is None or self.at_home():
            self.left = None
            return
        ways = [place.way_home(joints) for place in (self.place, self.left) if place is not None]
        way = next((way for way in ways if way is not None), None)
        if way is None:
            raise StepError(
                _START_STATE,
                "the arm stands away from home, and how it came there is not known; it is driven "
                "only with the arm at home: move it there by hand",
                "arm",
            )
        self.record.folder.note(f"the arm goes home the way it has come, {way.duration_s:.1f} s")
        self.cell.execute(way)
        self.place.left_home, self.left = len(self.place.executed), None

    def _points_to_scan(self) -> list[int]:
        place = self.place
        wanted = {*map(int, place.here.points), *self.record.data.round.left_over()}
        return sorted(wanted - set(place.passed_s))

    def _require_way_home(self, points: list[int]) -> None:
        if points:
            raise StepError(
                _NO_TRAJECTORY,
                f"the arm stands away from home, and from there none of {len(points)} points can "
                "be scanned",
                "trajectory_planner",
            )

    def _way_home(self) -> StationTrajectory | None:
        """All points are scanned: one of them again is the way home that the planner knows."""
        place = self.place
        assert place.planned is not None and place.located is not None
        for point in sorted(place.passed_s, key=lambda p: -place.passed_s[p]):
            if point in place.here.points:
                made = self.cell.planners.plan_trajectory(
                    self.job,
                    place.planned.path,
                    place.here.id,
                    place.located.T_arm_base_workpiece,
                    [point],
                )
                if made is not None:
                    return made
        raise StepError(_NO_TRAJECTORY, "no way home from where the arm stands was found")

    def next_segment(self) -> Event:
        """Returns what comes next at this station, or after it."""
        return self._next_segment()

    def _next_segment(self) -> Event:
        place = self.place
        segment = place.current
        if segment is not None:
            return Event.SCAN if segment.kind == SCAN else Event.MOVE
        self._switch(False)
        place.resuming = False
        if place.is_last:
            return Event.ALL_SCANNED
        place.station += 1
        place.leave()
        return Event.NEXT_STATION

    def _execute(self, scanning: bool) -> Event:
        place = self.place
        segment = place.current
        assert segment is not None
        self._switch(scanning)
        self.segment_began_s = time.monotonic()
        self.cell.execute(self._begun_slowly(place.rest or segment))
        place.finish_segment(self.segment_began_s)
        self.segment_began_s = math.inf
        if scanning:
            self.record.points(place, place.segment)
        return self._next_segment()

    def _begun_slowly(self, segment: Segment) -> Segment:
        """Returns a segment, the first one after an interruption begun slowly."""
        if not self.place.resuming:
            return segment
        self.place.resuming = False
        return segment if self.place.rest is not None else reentry.slowed_start(segment)

    def _switch(self, scanning: bool) -> None:
        if scanning != self.progress.scanner_on:
            self.cell.enable_scanner(scanning)
            self.progress = self.progress.switched(scanning)
