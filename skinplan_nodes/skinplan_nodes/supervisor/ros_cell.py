"""The cell on ROS: the services and actions of the other nodes, as a job's thread uses them."""

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from control_msgs.action import FollowJointTrajectory
from nav2_msgs.action import NavigateToPose
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from skinplan_msgs.action import LocalizePart
from skinplan_msgs.msg import InspectionResult, Status
from skinplan_msgs.srv import (
    InspectionFinish,
    InspectionStart,
    RecorderStart,
    RecorderStop,
)
from std_srvs.srv import SetBool

from skinplan.jobs.model import Job
from skinplan.trajectory.model import Segment
from skinplan.transforms import Array
from skinplan_nodes.action_client import ThreadedActionClient
from skinplan_nodes.conversions import (
    joint_trajectory_to_msg,
    key_values_to_msg,
    part_pose_from_msg,
    pose_stamped_from_msg,
    pose_stamped_to_msg,
)
from skinplan_nodes.supervisor.calls import Calls, part_reference
from skinplan_nodes.supervisor.cell import Located
from skinplan_nodes.supervisor.control import Request, StepError
from skinplan_nodes.supervisor.devices import Devices
from skinplan_nodes.supervisor.identification import RECOGNIZER
from skinplan_nodes.supervisor.motion import Motion, distance_m
from skinplan_nodes.supervisor.ros_planners import RosPlanners
from skinplan_nodes.supervisor.ros_recognizer import RosRecognizer
from skinplan_nodes.supervisor.waiting import Waiter
from skinplan_nodes.supervisor.watch import NodeWatch

_SERVICE_S = 10.0
_INSPECT_S = 120.0
_CLOSE_S = 60.0
# A localiser works on until a base has answered that does not any more: its last goal, cancelled.
_LOCALIZER_BUSY_S = 15.0
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

    Attributes:
        waiter: Waits for what the job's thread waits for.
        planners: The planners.
        recognizer: The recognizer.
        inspected: Figures of the last inspection.
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
        self.waiter = Waiter(
            self.now_s,
            lambda name: watch.is_lost(name, time.monotonic()),
            lambda name: watch.pid(name, time.monotonic()),
        )
        self._calls = Calls(node, self.waiter)
        self._devices = Devices(node, self.waiter, on_fault)
        self._motion = Motion(node, self.waiter)
        self.recorder_error = ""
        self._T_odom_located: Array | None = None
        self.inspected = InspectionResult()
        group = ReentrantCallbackGroup()
        self._services = {
            kind: node.create_client(kind, name, callback_group=group)
            for kind, name in _SERVICES.items()
        }
        self.planners = RosPlanners(node, self._calls, values, self._motion.joint_state, group)
        self.recognizer = RosRecognizer(node, self._calls, values, group)
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

    def is_recorded(self, folder: Path, metadata: Mapping[str, str]) -> bool:
        """Whether the recorder writes this part; nothing breaks into the question."""
        with self.waiter.undisturbed():
            try:
                self.start_recording(folder, metadata)
            except StepError:
                return False
        return True

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
            job_id=job.job_id, part=part_reference(job), folder=str(folder), resume=resume
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

    def localize(self, job: Job, may_move: bool, new_place: bool, quality: float = 0.0) -> Located:
        """Locates the part, by its markers or, where it has none, by its shape."""
        client, node = self._actions[LocalizePart], "aruco_localizer"
        if self.recognizer.is_asked_where(job):
            client, node = self.recognizer.by_shape, RECOGNIZER
        goal = LocalizePart.Goal(
            part=part_reference(job),
            may_move=may_move,
            new_place=new_place,
            quality_threshold=quality,
        )
        timeout_s = self._values.localize_timeout_s
        result, reached = self._calls.action(client, goal, timeout_s, node, _LOCALIZER_BUSY_S)
        if not reached or result.status.code != Status.OK:
            code = result.status.code if result.status.code > Status.OK else Status.INTERNAL
            raise StepError(
                code,
                result.status.message or "the localisation ended without a reason",
                node,
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

        def met() -> bool:
            served = all(client.server_is_ready() for client in self._actions.values())
            known = self._motion.joints() is not None and self._motion.base() is not None
            return served and known

        self.waiter.until(met, _MEET_S)

    def halt(self, stop_devices: bool) -> None:
        """Stops arm and base, sees to it that nothing moves, and switches the scanner off.

        Also goals that somebody else sent are cancelled: an approach of a localiser that is gone,
        or what another supervisor process has left. The scanner is on until the arm stands: what it
        passes while it brakes counts as scanned.
        """
        self._calls.cancel_all()
        answers = [
            client.cancel_everything_async()
            for client in (*self._actions.values(), self.recognizer.by_shape)
            if client.server_is_ready()
        ]
        if stop_devices:
            self._devices.stop()
        self._wait_shortly(answers)
        try:
            self._see_to_standing(stop_devices)
        finally:
            if self._services[SetBool].service_is_ready():
                off = self._services[SetBool].call_async(SetBool.Request(data=False))
                self._wait_shortly([off])

    def _wait_shortly(self, answers: list[Any]) -> None:
        self.waiter.until(lambda: all(answer.done() for answer in answers), _HALT_S)

    def _see_to_standing(self, stop_devices: bool) -> None:
        moving = self._motion.moving(self._values.stop_timeout_s)
        if moving and not stop_devices:
            self._devices.stop()
            moving = self._motion.moving(self._values.stop_timeout_s)
        if moving:
            text = f"{moving} {self._values.stop_timeout_s:g} s after it was stopped"
            raise StepError(Status.DEVICE_FAILED, text, _ARM if "arm" in moving else _BASE)

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
    SetBool: "scanner/enable",
}
_ACTIONS: dict[Any, str] = {
    NavigateToPose: "navigate_to_pose",
    LocalizePart: "localize_part",
    FollowJointTrajectory: "scaled_joint_trajectory_controller/follow_joint_trajectory",
}
