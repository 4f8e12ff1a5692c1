"""Writes down what a job does as it does it: journal, log, plan files. Needs no ROS."""

import os
from typing import Any

from skinplan.jobs.model import Job
from skinplan.part.model import Part
from skinplan.plan_record import scan_path_hash, station_hash, trajectory_hash
from skinplan.stations.model import StationPlan
from skinplan.trajectory.model import StationTrajectory
from skinplan_nodes.supervisor.cell import Cell, Located
from skinplan_nodes.supervisor.identification import Identified
from skinplan_nodes.supervisor.journal import Journal
from skinplan_nodes.supervisor.machine import Event, State
from skinplan_nodes.supervisor.place import Place
from skinplan_nodes.supervisor.run_data import Localization, PlannedPath, RunData
from skinplan_nodes.supervisor.run_folder import RunFolder


class RunRecord:
    """Takes in what a job has found and done; it is on disk when the methods return.

    Args:
        folder: The run's folder.
        data: Gets what the summary needs.
        cell: Knows how plans are kept on disk.
    """

    def __init__(self, folder: RunFolder, data: RunData, cell: Cell) -> None:
        self.folder = folder
        self.data = data
        self._cell = cell
        self._journal = Journal(folder.journal)
        self._files = 0

    def began(self, job: Job, part: Part, part_sha256: str) -> None:
        """Notes what the job is about, and which process works on it."""
        self._journal.add(
            "job",
            job_id=job.job_id,
            part_uri=job.part_uri,
            part_sha256=part_sha256,
            mesh_sha256=part.mesh_sha256,
            pid=os.getpid(),
        )

    def taken_over(self) -> None:
        """Notes that another process goes on."""
        self._journal.add("restart", pid=os.getpid())
        self.folder.note("another supervisor goes on with the job")

    def entered(self, state: State, event: Event, place: Place) -> None:
        """Notes a change of the state."""
        self._journal.add(
            "state",
            state=state.value,
            event=event.value,
            station=place.station,
            segment=place.segment,
            rescan=place.rescan,
        )

    def path(self, planned: PlannedPath, stages: dict[str, float], rescan: int) -> None:
        """Takes a scan path in."""
        self.data.round.planned = planned
        if rescan == 0:
            self.data.planning_s.update(stages)
        self.folder.write_plan(path=planned.path, coverage=planned.coverage, rescan=rescan)
        stored = self._store(f"path-{rescan}", self._cell.planners.encoded_path())
        self._journal.add("path", plan_hash=scan_path_hash(planned.path), rescan=rescan, **stored)
        self.folder.note(f"scan path of {len(planned.path)} points")

    def stations(self, plan: StationPlan, T_map_workpiece: Any, spent_s: float, n: int) -> None:
        """Takes the stations of re-scan `n` in; 0 = of the first scan."""
        self.data.round.station_plan = plan
        if n == 0:
            self.data.planning_s["stations"] = spent_s
        self.folder.write_plan(station_plan=plan, T_map_workpiece=T_map_workpiece, rescan=n)
        stored = self._store(f"stations-{n}", self._cell.planners.encoded_stations())
        self._journal.add(
            "stations",
            plan_hash=station_hash(plan),
            rescan=n,
            T_map_workpiece=T_map_workpiece,
            **stored,
        )
        self.folder.note(f"{len(plan.stations)} stations")

    def located(self, station: int, found: Located) -> None:
        """Takes a localisation in."""
        self.data.localizations.append(
            Localization(
                station, found.quality, found.attempts, found.stamp_s, found.T_arm_base_workpiece
            )
        )
        self._journal.add(
            "located",
            station=station,
            quality=found.quality,
            attempts=found.attempts,
            stamp_s=found.stamp_s,
            T_arm_base_workpiece=found.T_arm_base_workpiece,
            T_map_workpiece=found.T_map_workpiece,
        )
        self.folder.note(
            f"station {station}: part located, E = {found.quality:.3f}, attempt {found.attempts}"
        )

    def identified(self, found: Identified) -> None:
        """Takes in which part stands on the fixture."""
        self.data.identification = found.document()
        self._journal.add("identified", **found.document())
        self.folder.note(f"on the fixture: {found.text}")

    def trajectory(
        self, whole: StationTrajectory, done: int, points: int, spent_s: float, n: int
    ) -> None:
        """Takes what the arm does at a station in.

        Args:
            whole: All of it, from the first segment on.
            done: So many of its segments were executed already.
            points: Points that it was planned for.
            spent_s: Wall time of planning [s].
            n: Number of the re-scan.
        """
        self.data.round.put(whole)
        if n == 0:
            before_s = self.data.planning_s.get("trajectory", 0.0)
            self.data.planning_s["trajectory"] = before_s + spent_s
        self.folder.write_plan(trajectories=self.data.round.trajectories, rescan=n)
        stored = self._store(
            f"trajectory-{n}-{whole.station_id}", self._cell.planners.encoded_trajectory(whole)
        )
        self._journal.add(
            "trajectory",
            plan_hash=trajectory_hash([whole]),
            rescan=n,
            station=whole.station_id + 1,
            done=done,
            **stored,
        )
        self.folder.note(
            f"station {whole.station_id + 1}: {points} points, {len(whole.skipped)} left out, "
            f"scan {whole.scan_s:.1f} s, transit {whole.transit_s:.1f} s"
        )

    def points(self, place: Place, segment: int) -> None:
        """Notes which points of the present path were scanned, and that a segment is done."""
        self._journal.add(
            "points", rescan=place.rescan, segment=segment, points=sorted(place.passed_s)
        )

    def bag(self, part: int, recorder_pid: int, opened: bool) -> None:
        """Notes that a part of the bag was opened or closed."""
        self._journal.add("bag", part=part, recorder_pid=recorder_pid, opened=opened)

    def interrupted(self, state: State, code: int, reason: str) -> None:
        """Notes that the job stands still."""
        self._journal.add("interrupted", state=state.value, code=code, reason=reason)
        self.folder.note(f"interrupted in {state.value}: {reason}")

    def resumed(self, after_s: float) -> None:
        """Notes that the job goes on."""
        self._journal.add("resumed", after_s=after_s)
        self.folder.note(f"resumed after {after_s:.1f} s")

    def over(self, state: State, code: int) -> None:
        """Notes the end: nothing is to be resumed."""
        self._journal.add("over", state=state.value, code=code)

    def _store(self, name: str, content: bytes) -> dict[str, str]:
        self._files += 1
        return self._journal.store(f"{name}-{os.getpid()}-{self._files}.cdr", content)
