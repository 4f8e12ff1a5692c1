"""A small cell for tests of the supervisor: independent servers behind the real interfaces.

Points of the scan path are positions of the first joint; the scanner sees a point when the arm
passes it while the scanner is on. Everything runs on wall time.
"""

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from control_msgs.action import FollowJointTrajectory
from geometry_msgs.msg import PoseStamped
from nav2_msgs.action import NavigateToPose
from nav_msgs.msg import Odometry
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from sensor_msgs.msg import JointState
from skinplan_msgs import msg as messages
from skinplan_msgs.action import LocalizePart
from skinplan_msgs.msg import DeviceState, Status
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

from skinplan.robot.cell import CellConfig
from skinplan.scan_path.model import ScanPath
from skinplan.scanner.model import CoverageFigures
from skinplan.stations.model import Station, StationPlan
from skinplan.trajectory.model import SCAN, TRANSIT, Segment, StationTrajectory
from skinplan.transforms import planar, transform
from skinplan_nodes.conversions import (
    PathFacts,
    joint_state_to_msg,
    pose_stamped_to_msg,
    pose_to_msg,
    scan_path_to_msg,
    stamp_to_msg,
    station_plan_to_msg,
    station_trajectory_to_msg,
)
from skinplan_nodes.qos import LATCHED, STATE

HOME = np.array(CellConfig().home_rad)
STEP_RAD = 0.1
SPEED_RAD_S = 0.6
_OK = Status(code=Status.OK)
_TICK_S = 0.02


class Arm:
    """Follows trajectories on wall time; stops within a tick."""

    def __init__(self) -> None:
        self.q = HOME.copy()
        self.lock = threading.Lock()
        self.goals: list[Any] = []
        self.moved_s = 0.0
        self.stopped = ""
        self.never_ends = False
        # So long it goes on along its way after it was told to stop [s].
        self.brakes_s = 0.0

    def move(self, q: np.ndarray) -> None:
        if np.abs(q - self.q).max() > 1e-9:
            self.moved_s = time.monotonic()
        self.q = q


class SupervisedCell(Node):
    """Serves all that a job asks of a cell."""

    def __init__(
        self, points: int = 6, stations: int = 1, with_devices: bool = True, **kwargs: Any
    ) -> None:
        super().__init__("supervised_cell", **kwargs)
        self.point_count, self.station_count = points, stations
        self.arm, self.base = Arm(), planar(0.0, 0.0, 0.0)
        self.scanner_on, self.scanner_switched_s = False, 0.0
        # What is recorded, and how long the recorder takes to begin [s].
        self.recording: Path | None = None
        self.recorder_s = 0.0
        # So often the part is not located well enough from a station.
        self.stands_badly = 0
        # So many goals the localiser does not take: it still works on another one.
        self.localizer_refuses = 0
        self.base_answers = True
        self.seen: list[float] = []
        self.blind: set[int] = set()
        self.calls: list[str] = []
        self.asked: list[list[int]] = []
        self.inspections: list[tuple[str, bool]] = []
        self.bags: list[str] = []
        self.ended = False
        self._group = ReentrantCallbackGroup()
        self._joints = self.create_publisher(JointState, "joint_states", STATE)
        self._odometry = self.create_publisher(Odometry, "odom", STATE)
        self.create_timer(_TICK_S, self._tick, callback_group=self._group)
        self._serve()
        if with_devices:
            self._serve_arm()

    # --- devices ---

    def _tick(self) -> None:
        now = stamp_to_msg(time.time())
        message = joint_state_to_msg(self.arm.q)
        message.header.stamp = now
        self._joints.publish(message)
        odometry = Odometry()
        odometry.header.stamp, odometry.header.frame_id = now, "odom"
        odometry.pose.pose = pose_to_msg(self.base)
        self._odometry.publish(odometry)

    def set_arm(self, state: int, fault: str = "") -> None:
        """Publishes the arm's state; a fault ends what it does."""
        self.arm.stopped = fault
        self.state.publish(DeviceState(device="arm", state=state, fault=fault, message=fault))

    def _serve_arm(self) -> None:
        self.state = self.create_publisher(DeviceState, "arm/state", LATCHED)
        self.set_arm(DeviceState.READY)
        self._service(Trigger, "arm/stop", self._on_stop)
        self._service(Trigger, "arm/reset", self._on_reset)

    def _on_stop(self, _: Any, response: Trigger.Response) -> Trigger.Response:
        self.calls.append("arm/stop")
        if not self.arm.stopped:
            self.set_arm(DeviceState.STOPPED, "stopped")
        response.success = True
        return response

    def _on_reset(self, _: Any, response: Trigger.Response) -> Trigger.Response:
        self.calls.append("arm/reset")
        self.set_arm(DeviceState.READY)
        response.success = True
        return response

    def _follow(self, handle: Any) -> FollowJointTrajectory.Result:
        points = handle.request.trajectory.points
        times = np.array([p.time_from_start.sec + p.time_from_start.nanosec * 1e-9 for p in points])
        ways = np.array([p.positions for p in points])
        self.calls.append("follow")
        if self.arm.stopped or np.abs(ways[0] - self.arm.q).max() > 0.05:
            handle.abort()
            return FollowJointTrajectory.Result(error_code=-4, error_string="not from here")
        self.arm.goals.append(ways)
        begin, asked_s = time.monotonic(), 0.0
        while not self.ended:
            spent = time.monotonic() - begin
            if not handle.is_cancel_requested:
                asked_s = spent
            elif spent - asked_s >= self.arm.brakes_s:
                handle.canceled()
                return FollowJointTrajectory.Result(error_code=-5, error_string="cancelled")
            if self.arm.stopped:
                handle.abort()
                return FollowJointTrajectory.Result(error_code=-6, error_string="stopped")
            before = self.arm.q[0]
            self.arm.move(np.array([np.interp(spent, times, column) for column in ways.T]))
            if self.scanner_on:
                self._see(before, self.arm.q[0])
            if spent > times[-1] and not self.arm.never_ends:
                handle.succeed()
                return FollowJointTrajectory.Result(error_code=0)
            time.sleep(_TICK_S)
        return FollowJointTrajectory.Result()

    def _see(self, before: float, after: float) -> None:
        low, high = sorted((before, after))
        for point in range(self.point_count):
            place = joints_of(point)[0]
            if low - 1e-9 <= place <= high + 1e-9 and point not in self.blind:
                self.seen.append(point)

    def _navigate(self, handle: Any) -> NavigateToPose.Result:
        self.calls.append("drive")
        while not self.ended and not self.base_answers:
            if handle.is_cancel_requested:
                handle.canceled()
                return NavigateToPose.Result(error_msg="cancelled")
            time.sleep(_TICK_S)
        position = handle.request.pose.pose.position
        self.base = planar(position.x, position.y, 0.0)
        handle.succeed()
        return NavigateToPose.Result()

    def _localize(self, handle: Any) -> LocalizePart.Result:
        self.calls.append("localize")
        handle.succeed()
        if self.stands_badly and "plan_stations" in self.calls:
            self.stands_badly -= 1
            low = Status(code=Status.QUALITY_NOT_REACHED, message="E 0.84, 0.85 is asked for")
            return LocalizePart.Result(quality=0.84, attempts=1, status=low)
        part = messages.PartPose()
        part.pose.pose = pose_to_msg(transform((0.0, 1.0, 0.0)))
        part.header.frame_id = "arm_base"
        part.header.stamp = stamp_to_msg(time.time())
        place: PoseStamped = pose_stamped_to_msg(transform((0.0, 1.0, 1.0)), "map")
        found = LocalizePart.Result(part_pose=part, map_pose=place, quality=0.9, attempts=1)
        found.status = _OK
        return found

    def _locate_by_shape(self, handle: Any) -> LocalizePart.Result:
        result = self._localize(handle)
        self.calls[-1] = "locate by shape"
        return result

    # --- planners ---

    def _on_path(self, request: Any, response: PlanScanPath.Response) -> PlanScanPath.Response:
        self.calls.append("plan_scan_path")
        wanted = list(range(self.point_count))
        if request.seen_cloud:
            wanted = sorted(set(wanted) - {int(point) for point in self.seen})
            if not wanted:
                response.status = Status(code=Status.NOTHING_MISSING, message="nothing")
                return response
        self.numbers = wanted
        positions = np.array([[STEP_RAD * n, 0.0, 0.3] for n in wanted])
        down = np.tile([0.0, 0.0, -1.0], (len(wanted), 1))
        count = len(wanted)
        path = ScanPath(
            positions, down, positions + 0.3 * down,
            np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64), "fake", 0,
        )  # fmt: skip
        figures = CoverageFigures(1.0, float("nan"), 1.0, float("nan"))
        response.path = scan_path_to_msg(path, PathFacts("p", "", 1, 1.0, figures), 0.0)
        response.status = _OK
        return response

    def _on_stations(self, request: Any, response: PlanStations.Response) -> PlanStations.Response:
        self.calls.append("plan_stations")
        shares = np.array_split(np.arange(len(request.path.points)), self.station_count)
        stations = tuple(
            Station(i, planar(float(i), 0.0, 0.0), share) for i, share in enumerate(shares)
        )
        plan = StationPlan("fake", stations, len(stations), 1, True, 1.0, ())
        response.plan, response.status = station_plan_to_msg(plan), _OK
        return response

    def _on_trajectories(
        self, request: Any, response: PlanTrajectories.Response
    ) -> PlanTrajectories.Response:
        self.calls.append("plan_trajectories")
        points = [int(point) for point in request.points]
        self.asked.append([self.numbers[point] for point in points])
        start = np.array(request.start.position) if request.start.position else HOME
        ways = [joints_of(self.numbers[point]) for point in points]
        segments = [straight(TRANSIT, [start, before(ways[0])], [])]
        segments.append(straight(SCAN, [before(ways[0]), *ways, after(ways[-1])], points))
        segments.append(straight(TRANSIT, [after(ways[-1]), HOME], []))
        made = StationTrajectory(request.station_id, tuple(segments), (), "fake")
        response.trajectory = station_trajectory_to_msg(made)
        response.status = _OK
        return response

    # --- recorder and inspector ---

    def _on_record(self, request: Any, response: RecorderStart.Response) -> RecorderStart.Response:
        folder = Path(request.folder)
        self.bags.append(folder.name)
        if self.recording not in (None, folder):
            response.status = Status(code=Status.RECORDER_BUSY, message="another one is recorded")
            return response
        if self.recording is None and folder.exists():
            response.status = Status(code=Status.BAG_NOT_WRITABLE, message="there is one already")
            return response
        self.recording = folder
        folder.mkdir(parents=True, exist_ok=True)
        time.sleep(self.recorder_s)
        response.status = _OK
        return response

    def _on_recorded(self, _: Any, response: RecorderStop.Response) -> RecorderStop.Response:
        self.calls.append("recorder/stop")
        self.recording = None
        response.status = _OK
        return response

    def _on_inspect(self, request: Any, response: Any) -> Any:
        self.inspections.append((Path(request.folder).name, request.resume))
        response.status = _OK
        return response

    def _on_measure(self, request: Any, response: Any) -> Any:
        self.calls.append("inspection/finish" if not request.go_on else "inspection/so far")
        result = messages.InspectionResult(job_id=request.job_id)
        result.area_ratio = len({int(p) for p in self.seen}) / self.point_count
        Path(request.cloud_uri).write_text("a cloud")
        response.result, response.status = result, _OK
        return response

    def _on_scanner(self, request: Any, response: SetBool.Response) -> SetBool.Response:
        self.scanner_on, response.success = request.data, True
        self.scanner_switched_s = time.monotonic()
        return response

    def _serve(self) -> None:
        self._service(SetBool, "scanner/enable", self._on_scanner)
        self._service(PlanScanPath, "plan_scan_path", self._on_path)
        self._service(PlanStations, "plan_stations", self._on_stations)
        self._service(PlanTrajectories, "plan_trajectories", self._on_trajectories)
        self._service(RecorderStart, "recorder/start", self._on_record)
        self._service(RecorderStop, "recorder/stop", self._on_recorded)
        self._service(InspectionStart, "inspection/start", self._on_inspect)
        self._service(InspectionFinish, "inspection/finish", self._on_measure)
        controller = "scaled_joint_trajectory_controller/follow_joint_trajectory"
        self._servers = [
            self._action(FollowJointTrajectory, controller, self._follow),
            self._action(NavigateToPose, "navigate_to_pose", self._navigate),
            self._action(LocalizePart, "localize_part", self._localize, self._on_localize),
            self._action(LocalizePart, "locate_part_by_shape", self._locate_by_shape),
        ]

    def _service(self, kind: Any, name: str, handler: Callable[[Any, Any], Any]) -> None:
        self.create_service(kind, name, handler, callback_group=self._group)

    def _on_localize(self, _: Any) -> GoalResponse:
        self.localizer_refuses -= 1
        return GoalResponse.REJECT if self.localizer_refuses >= 0 else GoalResponse.ACCEPT

    def _action(
        self,
        kind: Any,
        name: str,
        execute: Callable[[Any], Any],
        on_goal: Callable[[Any], GoalResponse] = lambda _: GoalResponse.ACCEPT,
    ) -> ActionServer:
        return ActionServer(
            self,
            kind,
            name,
            execute,
            goal_callback=on_goal,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=self._group,
        )

    def close(self) -> None:
        """Ends the loops of the devices."""
        self.ended = True


def joints_of(point: int) -> np.ndarray:
    """Where the arm sees a point."""
    return HOME + np.array([0.2 + STEP_RAD * point, 0.1, 0.0, 0.0, 0.0, 0.0])


def before(q: np.ndarray) -> np.ndarray:
    """Where a scan begins."""
    return q - np.array([0.5 * STEP_RAD, 0.0, 0.0, 0.0, 0.0, 0.0])


def after(q: np.ndarray) -> np.ndarray:
    """Where a scan ends."""
    return q + np.array([0.5 * STEP_RAD, 0.0, 0.0, 0.0, 0.0, 0.0])


def straight(kind: int, corners: list[np.ndarray], points: list[int]) -> Segment:
    """A segment through corners; point k is passed at corner k + 1."""
    ways = np.array(corners)
    lengths = np.maximum(np.abs(np.diff(ways, axis=0)).max(axis=1), 1e-3)
    ends = np.concatenate([[0.0], np.cumsum(lengths / SPEED_RAD_S)])
    times = np.linspace(0.0, ends[-1], 50)
    positions = np.stack([np.interp(times, ends, column) for column in ways.T], axis=1)
    velocities = np.gradient(positions, times, axis=0)
    velocities[[0, -1]] = 0.0
    return Segment(
        kind, times, positions, velocities, np.array(points, dtype=np.int64), 0.1,
        ends[1 : 1 + len(points)],
    )  # fmt: skip
