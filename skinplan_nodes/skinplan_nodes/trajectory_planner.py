"""Node ``trajectory_planner``: makes the motion of the arm, station by station."""

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from skinplan_msgs import msg as messages
from skinplan_msgs.msg import Status
from skinplan_msgs.srv import PlanTrajectories
from std_srvs.srv import Trigger

from skinplan.errors import CancelledError
from skinplan.mesh.model import SurfaceMesh
from skinplan.part.model import Part, ScanSettings
from skinplan.plan_record import scan_path_hash
from skinplan.scan_path.model import ScanPath
from skinplan.trajectory.cycle import cycle_time, row_length
from skinplan.trajectory.model import StationTrajectory
from skinplan.trajectory.plan import plan_station_trajectory, plan_trajectories
from skinplan.transforms import inverse
from skinplan_nodes.conversions import PlanTimes, trajectory_plan_to_msg
from skinplan_nodes.current_work import CurrentWork, Work
from skinplan_nodes.node import CellNode
from skinplan_nodes.parameters import CELL_FILE, MESHES_KEPT
from skinplan_nodes.part_cache import PartCache
from skinplan_nodes.planning import configured_cell, requested_path
from skinplan_nodes.qos import LATCHED
from skinplan_nodes.replies import replies, replies_in_thread
from skinplan_nodes.run import run_node
from skinplan_nodes.trajectory_request import (
    StationRequest,
    StationsRequest,
    described,
    requested_stations,
)


class PlannedStations:
    """The trajectories of one scan path that have been planned so far, by station."""

    def __init__(self) -> None:
        self._path_hash = ""
        self._trajectories: dict[int, StationTrajectory] = {}

    def add(self, path: ScanPath, trajectory: StationTrajectory) -> tuple[StationTrajectory, ...]:
        """Takes a station in and returns all, in the order of visit.

        Stations behind a station that is planned again are left out, as are those of another path:
        they belong to an earlier run.
        """
        found = scan_path_hash(path)
        number = trajectory.station_id
        again = number in self._trajectories
        if found != self._path_hash:
            self._trajectories = {}
        elif again:
            self._trajectories = {i: t for i, t in self._trajectories.items() if i < number}
        self._path_hash = found
        self._trajectories[number] = trajectory
        return self._in_order()

    def set(self, path: ScanPath, trajectories: Sequence[StationTrajectory]) -> None:
        """Takes in all stations, planned at once; what there was is left out."""
        self._path_hash = scan_path_hash(path)
        self._trajectories = {t.station_id: t for t in trajectories}

    def _in_order(self) -> tuple[StationTrajectory, ...]:
        return tuple(self._trajectories[i] for i in sorted(self._trajectories))


class TrajectoryPlanner(CellNode):
    """Serves ``plan_trajectories``; publishes what is planned so far on ``trajectory_plan``."""

    NAME = "trajectory_planner"
    PARAMETERS = (
        CELL_FILE,
        MESHES_KEPT,
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._cell = configured_cell(self.values.cell_file)
        self._parts = PartCache(self.values.meshes_kept)
        self._planned = PlannedStations()
        self._work = CurrentWork(self.ended, self.note_progress)
        self._publisher = self.create_publisher(messages.TrajectoryPlan, "trajectory_plan", LATCHED)
        self.create_service(
            PlanTrajectories,
            "plan_trajectories",
            self._on_plan_trajectories,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )
        # In another group: it is answered while a plan is made.
        self.create_service(Trigger, "plan_trajectories/cancel", self._on_cancel)

    @replies_in_thread(invalid=Status.REQUEST_INVALID)
    def _on_plan_trajectories(
        self, request: PlanTrajectories.Request, response: PlanTrajectories.Response
    ) -> None:
        begin = time.perf_counter()
        try:
            with self._work.doing(described(request)) as work:
                made = self._made(request, work)
        except CancelledError as error:
            self.set_health("ok", str(error))
            raise
        if isinstance(made.asked, StationRequest):
            (response.trajectory,) = made.answer.stations
        response.plan = made.answer
        response.planning_time = time.perf_counter() - begin
        self._publish(made)
        self.set_health("ok", f"{described(request)} of {made.part.id} is done")

    @replies
    def _on_cancel(self, _: Trigger.Request, response: Trigger.Response) -> Status | None:
        what = self._work.cancel()
        if not what:
            return Status(code=Status.REQUEST_INVALID, message="nothing is being planned")
        response.message = f"{what} is being cancelled"
        return None

    def _made(self, request: PlanTrajectories.Request, work: Work) -> "_Made":
        asked = requested_stations(request)
        part, prepared = self._parts.prepared(request.part)
        path = requested_path(request.path, part)
        settings = replace(part.scan, order_strategy=request.strategy or part.scan.order_strategy)
        work.check()
        if isinstance(asked, StationRequest):
            trajectories = (self._plan_one(asked, path, part, prepared.mesh, settings, work),)
            times = _one_station_times(path, trajectories, settings)
        else:
            trajectories = plan_trajectories(
                path,
                asked.plan,
                asked.T_map_workpiece,
                prepared.mesh,
                settings,
                self._cell,
                work.progress,
                work.is_cancelled,
            )
            cycle = cycle_time(asked.plan, trajectories, self._cell, settings, path)
            times = PlanTimes(cycle.base_s, cycle.lower_bound_s)
        answer = trajectory_plan_to_msg(trajectories, times, self.now_s())
        return _Made(asked, part, path, settings, trajectories, answer)

    def _plan_one(
        self,
        asked: StationRequest,
        path: ScanPath,
        part: Part,
        mesh: SurfaceMesh,
        settings: ScanSettings,
        work: Work,
    ) -> StationTrajectory:
        T_map_workpiece = asked.T_map_workpiece
        if T_map_workpiece is None:
            # The part stands near its nominal place, and so do the cell's obstacles about it.
            T_map_workpiece = part.T_map_workpiece
        return plan_station_trajectory(
            path,
            asked.points,
            asked.T_arm_base_workpiece,
            mesh,
            settings,
            self._cell,
            asked.station_id,
            asked.start,
            progress=work.progress,
            is_cancelled=work.is_cancelled,
            T_arm_base_map=asked.T_arm_base_workpiece @ inverse(T_map_workpiece),
            T_map_tracker=asked.T_map_tracker,
        )

    def _publish(self, made: "_Made") -> None:
        if isinstance(made.asked, StationsRequest):
            self._planned.set(made.path, made.trajectories)
            self._publisher.publish(made.answer)
            return
        planned = self._planned.add(made.path, made.trajectories[0])
        times = _one_station_times(made.path, planned, made.settings)
        self._publisher.publish(trajectory_plan_to_msg(planned, times, self.now_s()))


@dataclass(frozen=True, eq=False)
class _Made:
    """What came out of a request."""

    asked: StationRequest | StationsRequest
    part: Part
    path: ScanPath
    settings: ScanSettings
    trajectories: tuple[StationTrajectory, ...]
    answer: messages.TrajectoryPlan


def _one_station_times(
    path: ScanPath, trajectories: Sequence[StationTrajectory], settings: ScanSettings
) -> PlanTimes:
    """Where the other stations are is not known, and so neither what the base drives."""
    return PlanTimes(lower_bound_s=row_length(path, trajectories) / settings.tcp_speed_m_s)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    return run_node(TrajectoryPlanner, arguments)


if __name__ == "__main__":
    sys.exit(main())
