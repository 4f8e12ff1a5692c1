"""The cell on ROS: the services and actions of the other nodes, as a job's thread uses them."""

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from control_msgs.action import FollowJointTrajectory
from geometry_msgs.msg import PoseStamped
from nav2_msgs.action import NavigateToPose
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from skinplan_msgs.action import LocalizePart
from skinplan_msgs.msg import InspectionResult, PartReference, Status
from skinplan_msgs.srv import (
    InspectionFinish,
    InspectionStart,
    PlanScanPath,
    PlanStations,
    PlanTrajectories,
    RecorderStart,
    RecorderStop,
)
from std_srvs.srv import SetBool, Trigger

from skinplan.jobs.model import Job
from skinplan.scan_path.model import ScanPath
from skinplan.stations.model import StationPlan
from skinplan.trajectory.model import Segment, StationTrajectory
from skinplan.transforms import Array
from skinplan_nodes.action_client import ThreadedActionClient
from skinplan_nodes.conversions import (
    coverage_figures_from_msg,
    joint_trajectory_to_msg,
    key_values_to_msg,
    part_pose_from_msg,
    pose_stamped_from_msg,
    pose_stamped_to_msg,
    scan_path_from_msg,
    station_plan_from_msg,
    station_trajectory_from_msg,
)
from skinplan_nodes.qos import STATE
from skinplan_nodes.supervisor.calls import Calls
from skinplan_nodes.supervisor.cell import Located
from skinplan_nodes.supervisor.control import AbortError, JobControl, StepError
from skinplan_nodes.supervisor.run_data import PlannedPath
from skinplan_nodes.supervisor.waiting import Waiter

_SERVICE_S = 10.0
_INSPECT_S = 120.0
_CLOSE_S = 60.0
_HALT_S = 1.0
# What a trajectory may take longer than planned: scaled speed, a protective slow-down.
_TRAJECTORY_FACTOR, _TRAJECTORY_EXTRA_S = 3.0, 20.0


class RosCell:
    """Implements `skinplan_nodes.supervisor.cell.Cell`.

    Args:
        node: The supervisor.
        values: Its parameters ``planning_timeout_s``, ``drive_timeout_s``, ``localize_timeout_s``,
            ``start_timeout_s``.
        missing: Returns the names of the required nodes that were not seen yet.
        is_lost: Whether a node was seen and is gone.
    """

    def __init__(
        self,
        node: Node,
        values: SimpleNamespace,
        missing: Callable[[], tuple[str, ...]],
        is_lost: Callable[[str], bool],
    ) -> None:
        self._node = node
        self._values = values
        self._missing = missing
        self.waiter = Waiter(self.now_s, is_lost)
        self._calls = Calls(node, self.waiter)
        self._joint_state: bytes | None = None
        self._path_msg: Any = None
        # Of the stations planned last; without a frame: not known.
        self._tracker, self._map_pose = PoseStamped(), PoseStamped()
        self.inspected = InspectionResult()
        group = ReentrantCallbackGroup()
        self._services = {
            kind: node.create_client(kind, name, callback_group=group)
            for kind, name in _SERVICES.items()
        }
        self._actions = {
            kind: ThreadedActionClient(node, kind, name, callback_group=group)
            for kind, name in _ACTIONS.items()
        }
        node.create_subscription(JointState, "joint_states", self._on_joint_state, STATE, raw=True)

    def wait_ready(self) -> None:
        """Waits until all nodes that a job needs are alive and the cell's time runs."""
        deadline = time.monotonic() + self._values.start_timeout_s
        while self._missing() or self.now_s() <= 0.0:
            self.waiter.control.check()
            if time.monotonic() > deadline:
                names = ", ".join(self._missing())
                what = f"the nodes {names} were not seen" if names else "the clock does not run"
                node = self._missing()[0] if names else "sim_clock"
                raise StepError(
                    Status.DEVICE_NOT_READY,
                    f"{what} within {self._values.start_timeout_s:g} s",
                    node,
                )
            time.sleep(0.05)

    def now_s(self) -> float:
        """Returns the cell's time [s]."""
        return float(self._node.get_clock().now().nanoseconds) * 1e-9

    def start_recording(self, folder: Path, metadata: Mapping[str, str]) -> None:
        """Opens the bag."""
        request = RecorderStart.Request(folder=str(folder), metadata=key_values_to_msg(metadata))
        self._call(RecorderStart, request, _SERVICE_S, "run_recorder")

    def stop_recording(self) -> dict[str, Any]:
        """Closes the bag; works also for a job that is being aborted."""
        self.waiter.control = JobControl()
        response = self._call(RecorderStop, RecorderStop.Request(), _CLOSE_S, "run_recorder")
        return {
            "path": response.folder,
            "messages": response.messages,
            "bytes": response.bytes,
            "topics": response.topics,
            "dropped": response.dropped,
        }

    def start_inspection(self, job: Job) -> None:
        """Begins to collect scan frames."""
        request = InspectionStart.Request(job_id=job.job_id, part=_reference(job))
        self._call(InspectionStart, request, self._values.planning_timeout_s, "scan_inspector")

    def finish_inspection(
        self, job: Job, cloud: Path, timeout_s: float | None = None
    ) -> dict[str, Any]:
        """Merges and measures."""
        request = InspectionFinish.Request(job_id=job.job_id, cloud_uri=str(cloud))
        response = self._call(InspectionFinish, request, timeout_s or _INSPECT_S, "scan_inspector")
        self.inspected = result = response.result
        return {
            "points": result.points,
            "area_ratio": result.area_ratio,
            "feature_area_ratio": result.feature_area_ratio,
            "deviation_rms_m": result.deviation_rms,
            "alignment_rms_m": result.alignment_rms,
        }

    def drive(self, T_map_base_link: Array) -> None:
        """Drives the base to a pose."""
        goal = NavigateToPose.Goal(pose=pose_stamped_to_msg(T_map_base_link, "map", self.now_s()))
        result, reached = self._act(
            NavigateToPose, goal, self._values.drive_timeout_s, "navigate_to_pose"
        )
        if not reached:
            code = Status.BASE_REFUSED if result.error_code else Status.BASE_BLOCKED
            raise StepError(code, f"the base did not arrive: {result.error_msg}", _BASE)

    def localize(self, job: Job, may_move: bool) -> Located:
        """Locates the part."""
        # A job's first look is the one that may move; between its stations the part stands still.
        goal = LocalizePart.Goal(part=_reference(job), may_move=may_move, new_place=may_move)
        result, reached = self._act(
            LocalizePart, goal, self._values.localize_timeout_s, "aruco_localizer"
        )
        if not reached or result.status.code != Status.OK:
            code = result.status.code if result.status.code > Status.OK else Status.INTERNAL
            raise StepError(
                code,
                result.status.message or "the localisation ended without a reason",
                "aruco_localizer",
            )
        found = part_pose_from_msg(result.part_pose)
        T_map_workpiece = pose_stamped_from_msg(result.map_pose, "map", "pose of the part")
        return Located(
            found.T_arm_base_workpiece,
            T_map_workpiece,
            result.quality,
            result.attempts,
            found.stamp_s,
        )

    def plan_path(self, job: Job) -> tuple[PlannedPath, dict[str, float]]:
        """Plans the scan path."""
        request = PlanScanPath.Request(part=_reference(job))
        response = self._call(
            PlanScanPath, request, self._values.planning_timeout_s, "scan_path_planner"
        )
        self._path_msg = found = response.path
        planned = PlannedPath(
            scan_path_from_msg(found),
            coverage_figures_from_msg(found.coverage),
            found.triangles,
            found.area,
            found.mesh_sha256,
        )
        mesh_s, coverage_s = response.mesh_time, response.coverage_time
        rest_s = max(0.0, response.planning_time - mesh_s - coverage_s)
        return planned, {"mesh": mesh_s, "scan_path": rest_s, "coverage": coverage_s}

    def plan_stations(self, job: Job, path: ScanPath, T_map_workpiece: Array) -> StationPlan:
        """Chooses the stations for the scan path planned last."""
        request = PlanStations.Request(
            part=_reference(job),
            path=self._path_msg,
            pose=pose_stamped_to_msg(T_map_workpiece, "map"),
        )
        response = self._call(
            PlanStations, request, self._values.planning_timeout_s, "station_planner"
        )
        plan = station_plan_from_msg(response.plan)
        place = plan.T_map_tracker
        self._tracker = PoseStamped() if place is None else pose_stamped_to_msg(place, "map")
        self._map_pose = request.pose
        return plan

    def plan_trajectory(
        self, job: Job, path: ScanPath, station: int, T_arm_base_workpiece: Array, points: list[int]
    ) -> StationTrajectory | None:
        """Makes the arm's motion at one station, from where the arm stands.

        Tracker and part are in the shop where the stations planned last suppose them.
        """
        request = PlanTrajectories.Request(
            part=_reference(job),
            path=self._path_msg,
            station_id=station,
            pose=pose_stamped_to_msg(T_arm_base_workpiece, "arm_base"),
            points=points,
            start=self._arm_state(),
            tracker=self._tracker,
            map_pose=self._map_pose,
        )
        try:
            response = self._call(
                PlanTrajectories, request, self._values.planning_timeout_s, "trajectory_planner"
            )
        except StepError as error:
            if isinstance(error, AbortError) or error.code == Status.DEVICE_TIMEOUT:
                # Nobody waits for it any more, but the next job's would have to.
                self._cancel_planning()
            elif error.code == Status.NO_TRAJECTORY:
                return None
            raise
        return station_trajectory_from_msg(response.trajectory)

    def execute(self, segment: Segment) -> None:
        """Moves the arm along a segment."""
        trajectory = joint_trajectory_to_msg(segment.times, segment.positions, segment.velocities)
        goal = FollowJointTrajectory.Goal(trajectory=trajectory)
        timeout_s = _TRAJECTORY_FACTOR * segment.duration_s + _TRAJECTORY_EXTRA_S
        result, reached = self._act(
            FollowJointTrajectory, goal, timeout_s, "follow_joint_trajectory"
        )
        if not reached:
            code = Status.DEVICE_REFUSED if result.error_code in _REFUSALS else Status.DEVICE_FAILED
            raise StepError(
                code, f"the arm answered {result.error_code}: {result.error_string}", _ARM
            )

    def enable_scanner(self, enabled: bool) -> None:
        """Switches the scanner."""
        response = self._call(SetBool, SetBool.Request(data=enabled), _SERVICE_S, _SCANNER)
        if not response.success:
            raise StepError(
                Status.DEVICE_FAILED, f"the scanner did not switch: {response.message}", _SCANNER
            )

    def halt(self) -> None:
        """Stops arm and base, switches the scanner off; does not wait long for the answers."""
        self._calls.cancel_all()
        # Whoever ended the job: from here on it is closed, and that may not be aborted again.
        self.waiter.control = JobControl()
        if self._services[SetBool].service_is_ready():
            off = self._services[SetBool].call_async(SetBool.Request(data=False))
            deadline = time.monotonic() + _HALT_S
            while not off.done() and time.monotonic() < deadline:
                time.sleep(0.01)

    def _cancel_planning(self) -> None:
        if self._services[Trigger].service_is_ready():
            self._services[Trigger].call_async(Trigger.Request())

    def _arm_state(self) -> JointState:
        raw = self._joint_state
        if raw is None:
            return JointState()
        state: JointState = deserialize_message(raw, JointState)
        return state

    def _on_joint_state(self, raw: bytes) -> None:
        # Taken apart only when it is needed: there are many of them.
        self._joint_state = raw

    def _call(self, kind: Any, request: Any, timeout_s: float, node: str) -> Any:
        return self._calls.service(self._services[kind], request, timeout_s, node)

    def _act(self, kind: Any, goal: Any, timeout_s: float, node: str) -> tuple[Any, bool]:
        return self._calls.action(self._actions[kind], goal, timeout_s, node)


# Devices are named by what they serve: which driver it is, the supervisor does not know.
_BASE, _ARM, _SCANNER = "navigate_to_pose", "follow_joint_trajectory", "scanner/enable"
_REFUSALS = (FollowJointTrajectory.Result.INVALID_GOAL, FollowJointTrajectory.Result.INVALID_JOINTS)
_SERVICES: dict[Any, str] = {
    RecorderStart: "recorder/start",
    RecorderStop: "recorder/stop",
    InspectionStart: "inspection/start",
    InspectionFinish: "inspection/finish",
    PlanScanPath: "plan_scan_path",
    PlanStations: "plan_stations",
    PlanTrajectories: "plan_trajectories",
    Trigger: "plan_trajectories/cancel",
    SetBool: "scanner/enable",
}
_ACTIONS: dict[Any, str] = {
    NavigateToPose: "navigate_to_pose",
    LocalizePart: "localize_part",
    FollowJointTrajectory: "scaled_joint_trajectory_controller/follow_joint_trajectory",
}


def _reference(job: Job) -> PartReference:
    return PartReference(uri=job.part_uri, mesh_sha256=job.mesh_sha256)
