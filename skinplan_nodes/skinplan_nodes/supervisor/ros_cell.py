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
from rclpy.serialization import deserialize_message, serialize_message
from skinplan_msgs.action import LocalizePart
from skinplan_msgs.msg import InspectionResult, PartReference, Status
from skinplan_msgs.msg import ScanPath as ScanPathMsg
from skinplan_msgs.msg import StationPlan as StationPlanMsg
from skinplan_msgs.msg import StationTrajectory as StationTrajectoryMsg
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
    station_trajectory_to_msg,
)
from skinplan_nodes.supervisor.calls import Calls
from skinplan_nodes.supervisor.cell import Located
from skinplan_nodes.supervisor.control import InterruptError, Request, StepError
from skinplan_nodes.supervisor.devices import Devices
from skinplan_nodes.supervisor.motion import Motion, distance_m
from skinplan_nodes.supervisor.run_data import PlannedPath
from skinplan_nodes.supervisor.waiting import Waiter
from skinplan_nodes.supervisor.watch import NodeWatch

_SERVICE_S = 10.0
_INSPECT_S = 120.0
_CLOSE_S = 60.0
_HALT_S = 1.0
_MEET_S = 5.0
# What a trajectory may take longer than planned: scaled speed, a protective slow-down.
_TRAJECTORY_FACTOR, _TRAJECTORY_EXTRA_S = 3.0, 20.0


class RosCell:
    """Implements `skinplan_nodes.supervisor.cell.Cell`.

    Args:
        node: The supervisor.
        values: Its parameters ``planning_timeout_s``, ``drive_timeout_s``, ``localize_timeout_s``,
            ``start_timeout_s``, ``stop_timeout_s``.
        watch: Which nodes are alive.
        on_fault: Told when a device can't go on.
    """

    def __init__(
        self,
        node: Node,
        values: SimpleNamespace,
        watch: NodeWatch,
        on_fault: Callable[[Request], None] = lambda _: None,
    ) -> None:
        self._node = node
        self._values = values
        self._watch = watch
        self.waiter = Waiter(self.now_s, lambda name: watch.is_lost(name, time.monotonic()))
        self._calls = Calls(node, self.waiter)
        self._devices = Devices(node, self.waiter, on_fault)
        self._motion = Motion(node)
        self.recorder_error = ""
        self._T_odom_located: Array | None = None
        self._path_msg: Any = None
        # Of the stations planned last; without a frame: not known.
        self._tracker, self._map_pose = PoseStamped(), PoseStamped()
        self._stations_msg = StationPlanMsg()
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

    def wait_ready(self) -> None:
        """Waits until all nodes that a job needs are alive and the cell's time runs."""
        deadline = time.monotonic() + self._values.start_timeout_s
        while (names := self._watch.absent(time.monotonic())) or self.now_s() <= 0.0:
            self.waiter.control.check()
            if time.monotonic() > deadline:
                text = ", ".join(names)
                what = f"the nodes {text} were not seen" if names else "the clock does not run"
                raise StepError(
                    Status.DEVICE_NOT_READY,
                    f"{what} within {self._values.start_timeout_s:g} s",
                    names[0] if names else "sim_clock",
                )
            time.sleep(0.05)
        for error in self._devices.faults():
            raise error

    def not_recovered(self) -> StepError | None:
        """Returns what is still missing after a failure that recovers by itself."""
        for error in self._devices.faults():
            self._devices.reset_by_itself()
            return error
        absent = self._watch.absent(time.monotonic())
        if absent:
            return StepError(Status.NODE_LOST, f"node {absent[0]} is not back", absent[0])
        return None

    def faults(self) -> list[StepError]:
        """Returns why devices can't go on."""
        return self._devices.faults()

    def reset_devices(self, all_devices: bool) -> None:
        """Resets the devices that we stopped, or all that stand still because of a fault."""
        self._devices.reset(all_devices)

    def now_s(self) -> float:
        """Returns the cell's time [s]."""
        return float(self._node.get_clock().now().nanoseconds) * 1e-9

    def recorder_pid(self) -> int:
        """Returns the process of the recorder, 0 = it is not there."""
        return self._watch.pid("run_recorder", time.monotonic())

    def recorder_failure(self) -> str:
        """Returns why the recorder can't write; empty = it can, or is not there."""
        return self.recorder_error

    def start_recording(self, folder: Path, metadata: Mapping[str, str]) -> None:
        """Opens the bag."""
        request = RecorderStart.Request(folder=str(folder), metadata=key_values_to_msg(metadata))
        self._call(RecorderStart, request, _SERVICE_S, "run_recorder")

    def stop_recording(self) -> dict[str, Any]:
        """Closes the bag's part; nothing breaks into it."""
        with self.waiter.undisturbed():
            response = self._call(RecorderStop, RecorderStop.Request(), _CLOSE_S, "run_recorder")
        return {
            "path": response.folder,
            "messages": response.messages,
            "bytes": response.bytes,
            "topics": response.topics,
            "dropped": response.dropped,
        }

    def start_inspection(self, job: Job, folder: Path, resume: bool = False) -> int:
        """Begins to collect scan frames, or goes on."""
        request = InspectionStart.Request(
            job_id=job.job_id, part=_reference(job), folder=str(folder), resume=resume
        )
        timeout_s = self._values.planning_timeout_s
        return int(self._call(InspectionStart, request, timeout_s, "scan_inspector").frames)

    def finish_inspection(
        self, job: Job, cloud: Path, timeout_s: float | None = None, go_on: bool = False
    ) -> dict[str, Any]:
        """Merges and measures."""
        request = InspectionFinish.Request(job_id=job.job_id, cloud_uri=str(cloud), go_on=go_on)
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
        self._T_odom_located = self._motion.base_since(found.stamp_s)
        T_map_workpiece = pose_stamped_from_msg(result.map_pose, "map", "pose of the part")
        return Located(
            found.T_arm_base_workpiece,
            T_map_workpiece,
            result.quality,
            result.attempts,
            found.stamp_s,
        )

    def base_moved_m(self) -> float:
        """Returns how far the base is from where it located the part; NaN = not known [m]."""
        return distance_m(self._T_odom_located, self._motion.base_since(self.now_s()))

    def plan_path(self, job: Job, seen: Path | None = None) -> tuple[PlannedPath, dict[str, float]]:
        """Plans the scan path, or only what a cloud leaves out."""
        request = PlanScanPath.Request(
            part=_reference(job), seen_cloud="" if seen is None else str(seen)
        )
        response = self._call(
            PlanScanPath, request, self._values.planning_timeout_s, "scan_path_planner"
        )
        planned = self._take_path(response.path)
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
        return self._take_stations(response.plan, request.pose)

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
            start=self._motion.joint_state(),
            tracker=self._tracker,
            map_pose=self._map_pose,
        )
        try:
            response = self._call(
                PlanTrajectories, request, self._values.planning_timeout_s, "trajectory_planner"
            )
        except StepError as error:
            if isinstance(error, InterruptError) or error.code == Status.DEVICE_TIMEOUT:
                # Nobody waits for it any more, but the next job's would have to.
                self._cancel_planning()
            elif error.code == Status.NO_TRAJECTORY:
                return None
            raise
        return station_trajectory_from_msg(response.trajectory)

    def arm_joints(self) -> Array | None:
        """Returns where the arm stands, shape (6,) [rad]; None = not known."""
        return self._motion.joints_since(self.now_s())

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

    def meet(self) -> None:
        """Waits, bounded, until the devices of a cell that runs already are found and heard.

        A node that has just started does not see the others yet: it would stop nobody.
        """
        deadline = time.monotonic() + _MEET_S
        while time.monotonic() < deadline:
            served = all(client.server_is_ready() for client in self._actions.values())
            if served and self._motion.joints() is not None and self._motion.base() is not None:
                return
            time.sleep(0.02)

    def halt(self, stop_devices: bool) -> None:
        """Stops arm and base, sees to it that nothing moves, and switches the scanner off.

        Also goals that somebody else sent are cancelled: an approach of a localiser that is gone,
        or what another supervisor process has left. The scanner is on until the arm stands: what it
        passes while it brakes counts as scanned.
        """
        self._calls.cancel_all()
        answers = [
            client.cancel_everything_async()
            for client in self._actions.values()
            if client.server_is_ready()
        ]
        if stop_devices:
            self._devices.stop()
        _wait_shortly(answers)
        try:
            self._see_to_standing(stop_devices)
        finally:
            if self._services[SetBool].service_is_ready():
                off = self._services[SetBool].call_async(SetBool.Request(data=False))
                _wait_shortly([off])

    def _see_to_standing(self, stop_devices: bool) -> None:
        moving = self._motion.moving(self._values.stop_timeout_s)
        if moving and not stop_devices:
            self._devices.stop()
            moving = self._motion.moving(self._values.stop_timeout_s)
        if moving:
            text = f"{moving} {self._values.stop_timeout_s:g} s after it was stopped"
            raise StepError(Status.DEVICE_FAILED, text, _ARM if "arm" in moving else _BASE)

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
        if self._services[Trigger].service_is_ready():
            self._services[Trigger].call_async(Trigger.Request())

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


def _wait_shortly(answers: list[Any]) -> None:
    deadline = time.monotonic() + _HALT_S
    while time.monotonic() < deadline and not all(answer.done() for answer in answers):
        time.sleep(0.01)


def _reference(job: Job) -> PartReference:
    return PartReference(uri=job.part_uri, mesh_sha256=job.mesh_sha256)
