"""Mock of the mobile base: the interfaces of a Nav2 base, on simulated time."""

import math
import sys
from collections.abc import Sequence
from typing import Any

from geometry_msgs.msg import PoseStamped
from nav2_msgs.action import NavigateToPose
from nav_msgs.msg import Odometry
from rclpy.action import ActionServer
from rclpy.action.server import ServerGoalHandle
from tf2_msgs.msg import TFMessage

from skinplan.errors import SkinplanError
from skinplan.mock.base import BaseConfig, MockBase
from skinplan.mock.faults import Fault, FaultKind
from skinplan.mock.kept import KeptState
from skinplan.mock.truth import Truth
from skinplan.robot.cell import CellConfig
from skinplan.transforms import Array, inverse
from skinplan_nodes.conversions import (
    duration_to_msg,
    header_to_msg,
    pose_stamped_from_msg,
    pose_stamped_to_msg,
    pose_to_msg,
    transform_stamped_to_msg,
)
from skinplan_nodes.goal_slot import (
    GoalEnd,
    GoalFailure,
    GoalSlot,
    accept_cancel,
    accept_goal,
    conclude,
)
from skinplan_nodes.mock_device import FAULTS, DeviceFace, FaultFace
from skinplan_nodes.mock_parts import SHOP, STATE_FILE, part_of
from skinplan_nodes.node import CellNode
from skinplan_nodes.parameters import Parameter, load
from skinplan_nodes.planning import configured_cell
from skinplan_nodes.qos import LATCHED, STATE, STATIC_TF
from skinplan_nodes.run import run_node

_Result = NavigateToPose.Result
# Codes of nav2's planner and controller, which its navigator hands on; our stand-in has not their
# types.
GOAL_OUTSIDE_MAP, FAILED_TO_MAKE_PROGRESS = 204, 105
BLOCKED, LOST, NEVER_ANSWERS, JUMP = "blocked", "lost", "never_answers", "jump"
_KINDS = (
    FaultKind(BLOCKED),
    FaultKind(LOST),
    FaultKind(NEVER_ANSWERS),
    FaultKind(JUMP, {"jump": (0.1, 0.0, 0.1)}, at_once=True),
)
# Of the pose in odom, x and y [m^2] and heading [rad^2]; a localisation that is lost says so.
_VARIANCE, _VARIANCE_LOST = (1e-4, 1e-4), (1e6, 10.0)


class MockMir100(CellNode):
    """Drives where ``navigate_to_pose`` says; publishes odometry, tf and, for mocks, the truth."""

    NAME = "mock_mir100"
    THREADS = 1
    PARAMETERS = (
        *SHOP,
        Parameter(
            "rate_hz", 20.0, "Odometry and tf per second of simulated time [Hz].", 1.0, 100.0
        ),
        Parameter(
            "feedback_rate_hz",
            2.0,
            "Feedback of a goal per second of simulated time [Hz].",
            0.1,
            20.0,
        ),
        Parameter(
            "speed_max_m_s", 1.5, "The speed of the cell counts up to this one [m/s].", 0.05, 2.0
        ),
        Parameter("acceleration_m_s2", 0.5, "Of driving [m/s^2].", 0.05, 3.0),
        Parameter("stop_deceleration_m_s2", 1.5, "Of a stop [m/s^2].", 0.1, 5.0),
        Parameter("turn_speed_rad_s", 1.0, "Of turning on the spot [rad/s].", 0.05, 3.0),
        Parameter("turn_acceleration_rad_s2", 1.0, "Of turning [rad/s^2].", 0.05, 5.0),
        Parameter("stop_turn_deceleration_rad_s2", 3.0, "Of a stop [rad/s^2].", 0.1, 10.0),
        Parameter("goal_distance_max_m", 50.0, "Goals farther away are refused [m].", 1.0, 1000.0),
        Parameter("slip_probability", 0.0, "Share of drives with slipping wheels [1].", 0.0, 1.0),
        Parameter(
            "jump_probability", 0.0, "Share of drives with a localisation that jumps [1].", 0.0, 1.0
        ),
        Parameter("jump_max_m", 0.1, "Longest jump of the localisation [m].", 0.0, 0.1),
        Parameter(
            "patience_s",
            10.0,
            "A goal is given up when its way is blocked so long [s].",
            0.0,
            600.0,
        ),
        STATE_FILE,
        FAULTS,
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        cell, part = configured_cell(self.values.cell_file), part_of(self.values)
        truth = Truth(part, cell, self.values.seed)
        config = load(self.values, BaseConfig)
        self._base = MockBase(config, cell, self.values.seed, truth.T_map_base_start)
        self._kept = KeptState(self.values.state_file, len(self._base.stand()))
        self._restored = False
        self._goals = GoalSlot(self)
        self._target: Array | None = None
        self._blocked_s = math.inf
        self._started_s = self._told_s = 0.0
        self._odometry = self.create_publisher(Odometry, "odom", STATE)
        self._tf = self.create_publisher(TFMessage, "tf", STATE)
        self._static_tf = self.create_publisher(TFMessage, "tf_static", STATIC_TF)
        self._true_base = self.create_publisher(PoseStamped, "truth/base_pose", STATE)
        self._true_part = self.create_publisher(PoseStamped, "truth/workpiece_pose", LATCHED)
        self._static_tf.publish(TFMessage(transforms=static_transforms(cell)))
        self._true_part.publish(pose_stamped_to_msg(truth.T_map_workpiece, "map"))
        self._face = DeviceFace(self, "base", self._on_stop)
        self._faults = FaultFace(self, _KINDS, self._on_fault, self._on_fault_end)
        self.create_timer(1.0 / self.values.rate_hz, self._on_tick)
        self._server = ActionServer(
            self,
            NavigateToPose,
            "navigate_to_pose",
            self._on_navigate,
            goal_callback=accept_goal,
            cancel_callback=accept_cancel,
        )

    def close(self) -> None:
        """Ends the goal that is being driven to."""
        self._goals.finish(GoalEnd.CANCELLED)
        self._kept.close()

    async def _on_navigate(self, handle: ServerGoalHandle) -> NavigateToPose.Result:
        now_s = self.now_s()
        refusal = self._face.device.refusal
        code = _Result.UNKNOWN
        try:
            if refusal:
                raise SkinplanError(refusal)
            target = pose_stamped_from_msg(handle.request.pose, "map", "goal of the base")
            code = GOAL_OUTSIDE_MAP
            self._base.goal(target, now_s)
        except SkinplanError as error:
            self.get_logger().warning(f"goal refused: {error}")
            handle.abort()
            return _Result(error_code=code, error_msg=str(error))
        self._target, self._started_s, self._told_s = target, now_s, now_s
        if self._is_held():
            self._hold(now_s)
        end = await self._goals.begin(handle)
        conclude(handle, end)
        if end is GoalEnd.REACHED:
            return _Result(error_code=_Result.NONE)
        if isinstance(end, GoalFailure):
            return _Result(error_code=end.code, error_msg=end.text)
        return _Result(error_code=_Result.UNKNOWN, error_msg=f"the goal was {end.value}")

    def _is_held(self) -> bool:
        book = self._faults.book
        return book.values(BLOCKED) is not None or book.values(NEVER_ANSWERS) is not None

    def _hold(self, now_s: float) -> None:
        """Stands before what is in the way; the goal stays."""
        self._base.stop(now_s)
        self._blocked_s = now_s

    def _on_stop(self, reason: str) -> None:
        self._base.stop(self.now_s())
        self._blocked_s = math.inf
        if self._faults.book.values(NEVER_ANSWERS) is None:
            self._goals.finish(GoalFailure(_Result.UNKNOWN, reason))

    def _on_fault(self, fault: Fault) -> None:
        now_s = self.now_s()
        if fault.name == LOST:
            self._face.fail(LOST, "the localisation does not know where the base is")
        elif fault.name == JUMP:
            self._base.step(now_s)
            self._base.jump(fault.values["jump"])
        elif self._goals.active is not None:
            self._hold(now_s)

    def _on_fault_end(self, name: str) -> None:
        self._face.device.cause_gone(name)
        self._blocked_s = math.inf
        if name == NEVER_ANSWERS:
            self._base.stop(self.now_s())
            reason = f"{NEVER_ANSWERS}: the navigator gave the goal up when it answered again"
            self._goals.finish(GoalFailure(_Result.UNKNOWN, reason))
        elif name == BLOCKED and self._goals.active is not None and self._target is not None:
            self._base.goal(self._target, self.now_s())

    def _on_tick(self) -> None:
        now_s = self.now_s()
        self._base.step(now_s)
        self._keep(now_s)
        self._faults.step(now_s, self._base.true[:3, 3])
        active = self._goals.active
        if active is not None and self._faults.book.values(NEVER_ANSWERS) is None:
            self._drive(active, now_s)
        device = self._face.device
        device.busy, device.moving = self._goals.active is not None, self._base.moving
        self._face.refresh()
        self._publish(now_s)

    def _keep(self, now_s: float) -> None:
        if not self._restored:
            self._restored = True
            stood = self._kept.read(now_s)
            if stood is not None:
                self._base.place(stood)
        self._kept.write(now_s, self._base.stand())

    def _drive(self, active: ServerGoalHandle, now_s: float) -> None:
        if active.is_cancel_requested:
            self._base.cancel(now_s)
            self._blocked_s = math.inf
            self._goals.finish(GoalEnd.CANCELLED)
        elif math.isfinite(self._blocked_s):
            if now_s - self._blocked_s >= self.values.patience_s:
                self._blocked_s = math.inf
                reason = f"the way was not free for {self.values.patience_s:g} s"
                self._face.device.fail(BLOCKED, reason)
                self._goals.finish(GoalFailure(FAILED_TO_MAKE_PROGRESS, f"{BLOCKED}: {reason}"))
        elif not self._base.moving:
            self._goals.finish(GoalEnd.REACHED)
        elif now_s - self._told_s >= 1.0 / self.values.feedback_rate_hz:
            self._told_s = now_s
            active.publish_feedback(self._feedback(now_s))

    def _publish(self, now_s: float) -> None:
        T_odom_base_link = self._base.odometry
        message = Odometry(header=header_to_msg("odom", now_s), child_frame_id="base_link")
        message.pose.pose = pose_to_msg(T_odom_base_link)
        lost = self._faults.book.values(LOST) is not None
        place, turn = _VARIANCE_LOST if lost else _VARIANCE
        covariance = message.pose.covariance
        covariance[0], covariance[7], covariance[35] = place, place, turn
        message.twist.twist.linear.x = float(self._base.speed)
        message.twist.twist.angular.z = float(self._base.turn_rate)
        self._odometry.publish(message)
        edges = [("map", "odom", self._base.T_map_odom), ("odom", "base_link", T_odom_base_link)]
        self._tf.publish(
            TFMessage(transforms=[transform_stamped_to_msg(*edge, now_s) for edge in edges])
        )
        self._true_base.publish(pose_stamped_to_msg(self._base.true, "map", now_s))

    def _feedback(self, now_s: float) -> NavigateToPose.Feedback:
        return NavigateToPose.Feedback(
            current_pose=pose_stamped_to_msg(self._base.believed, "map", now_s),
            navigation_time=duration_to_msg(now_s - self._started_s),
            estimated_time_remaining=duration_to_msg(self._base.remaining_s),
            distance_remaining=self._base.remaining_m,
        )


def static_transforms(cell: CellConfig) -> list[Any]:
    """Returns the fixed frames that the base owns: arm, camera and, in the shop, the tracker."""
    camera = cell.camera
    T_link_optical = inverse(camera.T_base_link_camera_link) @ camera.T_base_link_optical
    edges: list[tuple[str, str, Array]] = [
        ("base_link", "arm_base", cell.T_base_link_arm_base),
        ("base_link", "camera_link", camera.T_base_link_camera_link),
        ("camera_link", "camera_color_optical_frame", T_link_optical),
        ("map", "tracker", cell.T_map_tracker),
    ]
    return [transform_stamped_to_msg(*edge) for edge in edges]


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    return run_node(MockMir100, arguments)


if __name__ == "__main__":
    sys.exit(main())
