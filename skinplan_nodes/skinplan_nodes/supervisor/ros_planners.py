"""The planners on ROS: their services, and their plans as they are kept on disk."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from skinplan_msgs.msg import ScanPath as ScanPathMsg
from skinplan_msgs.msg import StationPlan as StationPlanMsg
from skinplan_msgs.msg import StationTrajectory as StationTrajectoryMsg
from skinplan_msgs.msg import Status
from skinplan_msgs.srv import PlanScanPath, PlanStations, PlanTrajectories
from std_srvs.srv import Trigger

from skinplan.jobs.model import Job
from skinplan.scan_path.model import ScanPath
from skinplan.stations.model import StationPlan
from skinplan.trajectory.model import StationTrajectory
from skinplan.transforms import Array
from skinplan_nodes.conversions import (
    coverage_figures_from_msg,
    pose_stamped_to_msg,
    scan_path_from_msg,
    station_plan_from_msg,
    station_trajectory_from_msg,
    station_trajectory_to_msg,
)
from skinplan_nodes.supervisor.calls import Calls, part_reference
from skinplan_nodes.supervisor.control import InterruptError, StepError
from skinplan_nodes.supervisor.run_data import PlannedPath


class RosPlanners:
    """Implements `skinplan_nodes.supervisor.cell.Planners`.

    Args:
        node: The supervisor.
        calls: Calls the services.
        values: The supervisor's parameters, of them ``planning_timeout_s``.
        joint_state: Returns the newest joint state of the arm.
        group: Callback group of the clients.
    """

    def __init__(
        self,
        node: Node,
        calls: Calls,
        values: SimpleNamespace,
        joint_state: Callable[[], JointState],
        group: CallbackGroup,
    ) -> None:
        self._calls = calls
        self._values = values
        self._joint_state = joint_state
        self._path_msg: Any = None
        # Of the stations planned last; without a frame: not known.
        self._tracker, self._map_pose = PoseStamped(), PoseStamped()
        self._stations_msg = StationPlanMsg()
        self._clients = {
            kind: node.create_client(kind, name, callback_group=group)
            for kind, name in _SERVICES.items()
        }

    def plan_path(self, job: Job, seen: Path | None = None) -> tuple[PlannedPath, dict[str, float]]:
        """Plans the scan path, or only what a cloud leaves out."""
        request = PlanScanPath.Request(
            part=part_reference(job), seen_cloud="" if seen is None else str(seen)
        )
        response = self._call(PlanScanPath, request, "scan_path_planner")
        planned = self._take_path(response.path)
        mesh_s, coverage_s = response.mesh_time, response.coverage_time
        rest_s = max(0.0, response.planning_time - mesh_s - coverage_s)
        return planned, {"mesh": mesh_s, "scan_path": rest_s, "coverage": coverage_s}

    def plan_stations(self, job: Job, path: ScanPath, T_map_workpiece: Array) -> StationPlan:
        """Chooses the stations for the scan path planned last."""
        request = PlanStations.Request(
            part=part_reference(job),
            path=self._path_msg,
            pose=pose_stamped_to_msg(T_map_workpiece, "map"),
        )
        response = self._call(PlanStations, request, "station_planner")
        return self._take_stations(response.plan, request.pose)

    def plan_trajectory(
        self, job: Job, path: ScanPath, station: int, T_arm_base_workpiece: Array, points: list[int]
    ) -> StationTrajectory | None:
        """Makes the arm's motion at one station, from where the arm stands.

        Tracker and part are in the shop where the stations planned last suppose them.
        """
        request = PlanTrajectories.Request(
            part=part_reference(job),
            path=self._path_msg,
            station_id=station,
            pose=pose_stamped_to_msg(T_arm_base_workpiece, "arm_base"),
            points=points,
            start=self._joint_state(),
            tracker=self._tracker,
            map_pose=self._map_pose,
        )
        try:
            response = self._call(PlanTrajectories, request, "trajectory_planner")
        except StepError as error:
            if isinstance(error, InterruptError) or error.code == Status.DEVICE_TIMEOUT:
                # Nobody waits for it any more, but the next job's would have to.
                self._cancel_planning()
            elif error.code == Status.NO_TRAJECTORY:
                return None
            raise
        return station_trajectory_from_msg(response.trajectory)

    def encoded_path(self) -> bytes:
        """Returns the path planned last, to be kept on disk."""
        return bytes(serialize_message(self._path_msg))

    def encoded_stations(self) -> bytes:
        """Returns the stations planned last, to be kept on disk."""
        return bytes(serialize_message(self._stations_msg))

    def encoded_trajectory(self, trajectory: StationTrajectory) -> bytes:
        """Returns a trajectory, to be kept on disk."""
        return bytes(serialize_message(station_trajectory_to_msg(trajectory)))

    def restore_path(self, content: bytes) -> PlannedPath:
        """Takes a path from disk as the one planned last."""
        return self._take_path(deserialize_message(content, ScanPathMsg))

    def restore_stations(self, content: bytes, T_map_workpiece: Array) -> StationPlan:
        """Takes stations from disk as those planned last."""
        found = deserialize_message(content, StationPlanMsg)
        return self._take_stations(found, pose_stamped_to_msg(T_map_workpiece, "map"))

    def restored_trajectory(self, content: bytes) -> StationTrajectory:
        """Returns a trajectory from disk."""
        return station_trajectory_from_msg(deserialize_message(content, StationTrajectoryMsg))

    def _take_path(self, found: ScanPathMsg) -> PlannedPath:
        self._path_msg = found
        return PlannedPath(
            scan_path_from_msg(found),
            coverage_figures_from_msg(found.coverage),
            found.triangles,
            found.area,
            found.mesh_sha256,
        )

    def _take_stations(self, found: StationPlanMsg, map_pose: PoseStamped) -> StationPlan:
        plan = station_plan_from_msg(found)
        place = plan.T_map_tracker
        self._tracker = PoseStamped() if place is None else pose_stamped_to_msg(place, "map")
        self._stations_msg, self._map_pose = found, map_pose
        return plan

    def _cancel_planning(self) -> None:
        if self._clients[Trigger].service_is_ready():
            self._clients[Trigger].call_async(Trigger.Request())

    def _call(self, kind: Any, request: Any, node: str) -> Any:
        timeout_s = self._values.planning_timeout_s
        return self._calls.service(self._clients[kind], request, timeout_s, node)


_SERVICES: dict[Any, str] = {
    PlanScanPath: "plan_scan_path",
    PlanStations: "plan_stations",
    PlanTrajectories: "plan_trajectories",
    Trigger: "plan_trajectories/cancel",
}
