"""Node ``trajectory_planner``: makes the motion of the arm, station by station."""

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from skinplan_msgs import msg as messages
from skinplan_msgs.msg import Status
from skinplan_msgs.srv import PlanTrajectories

from skinplan.errors import ScanPathInvalidError
from skinplan.plan_record import scan_path_hash
from skinplan.scan_path.model import ScanPath
from skinplan.trajectory.cycle import row_length
from skinplan.trajectory.model import StationTrajectory
from skinplan.trajectory.plan import plan_station_trajectory
from skinplan.transforms import inverse
from skinplan_nodes.conversions import (
    PlanTimes,
    pose_stamped_from_msg,
    start_from_msg,
    station_trajectory_to_msg,
    trajectory_plan_to_msg,
)
from skinplan_nodes.node import CellNode
from skinplan_nodes.parameters import CELL_FILE, MESHES_KEPT
from skinplan_nodes.part_cache import PartCache
from skinplan_nodes.planning import configured_cell, requested_path
from skinplan_nodes.qos import LATCHED
from skinplan_nodes.replies import replies_in_thread
from skinplan_nodes.run import run_node


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
        self._publisher = self.create_publisher(messages.TrajectoryPlan, "trajectory_plan", LATCHED)
        self.create_service(
            PlanTrajectories,
            "plan_trajectories",
            self._on_plan_trajectories,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )

    @replies_in_thread(invalid=Status.REQUEST_INVALID)
    def _on_plan_trajectories(
        self, request: PlanTrajectories.Request, response: PlanTrajectories.Response
    ) -> None:
        begin = time.perf_counter()
        T_arm_base_workpiece = pose_stamped_from_msg(
            request.pose, "arm_base", "pose of the workpiece"
        )
        start = start_from_msg(request.start)
        part, prepared = self._parts.prepared(request.part)
        path = requested_path(request.path, part)
        settings = replace(part.scan, order_strategy=request.strategy or part.scan.order_strategy)
        trajectory = plan_station_trajectory(
            path,
            _requested_points(request, path),
            T_arm_base_workpiece,
            prepared.mesh,
            settings,
            self._cell,
            request.station_id,
            start,
            progress=self.note_progress,
            is_cancelled=self.ended,
            # The part stands near its nominal place, and so do the cell's obstacles about it.
            T_arm_base_map=T_arm_base_workpiece @ inverse(part.T_map_workpiece),
        )
        response.trajectory = station_trajectory_to_msg(trajectory)
        response.planning_time = time.perf_counter() - begin
        self._publish(path, trajectory, settings.tcp_speed_m_s)
        self.set_health("ok", f"planned station {request.station_id} of {part.id}")

    def _publish(self, path: ScanPath, trajectory: StationTrajectory, tcp_speed_m_s: float) -> None:
        planned = self._planned.add(path, trajectory)
        times = PlanTimes(lower_bound_s=row_length(path, planned) / tcp_speed_m_s)
        self._publisher.publish(trajectory_plan_to_msg(planned, times, self.now_s()))


def _requested_points(request: PlanTrajectories.Request, path: ScanPath) -> Any:
    points = np.array(request.points, dtype=np.int64)
    if len(points) == 0:
        raise ScanPathInvalidError(
            f"station {request.station_id}: 0 points were asked for; at least 1 is accepted"
        )
    if points.max() >= len(path) or len(np.unique(points)) < len(points):
        raise ScanPathInvalidError(
            f"station {request.station_id}: indices of the path's {len(path)} points, each once, "
            f"are accepted, found {len(points)} up to {points.max()}"
        )
    return points


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    return run_node(TrajectoryPlanner, arguments)


if __name__ == "__main__":
    sys.exit(main())
