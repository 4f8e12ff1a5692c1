"""Mock of the arm: the interfaces of ``ur_robot_driver``, on simulated time."""

import array
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from control_msgs.action import FollowJointTrajectory
from geometry_msgs.msg import PoseStamped
from rclpy.action import ActionServer
from rclpy.action.server import ServerGoalHandle
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from tf2_msgs.msg import TFMessage
from trajectory_msgs.msg import JointTrajectoryPoint

from skinplan.errors import JointsInvalidError, SkinplanError, StartStateError
from skinplan.mock.arm import Ending, MockArm, Tolerances
from skinplan.mock.faults import Fault, FaultKind
from skinplan.mock.kept import KeptState
from skinplan.robot.arm import ArmModel
from skinplan.robot.cell import CellConfig
from skinplan.transforms import Array
from skinplan_nodes.conversions import (
    duration_from_msg,
    header_to_msg,
    joint_state_to_msg,
    joint_tolerances_from_msg,
    joint_trajectory_from_msg,
    pose_stamped_from_msg,
    stamp_to_msg,
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
from skinplan_nodes.mock_parts import SEED, STATE_FILE
from skinplan_nodes.node import CellNode
from skinplan_nodes.parameters import CELL_FILE, Parameter
from skinplan_nodes.planning import configured_cell
from skinplan_nodes.qos import STATE, STATIC_TF
from skinplan_nodes.run import run_node

CONTROLLER = "scaled_joint_trajectory_controller"
# After a jump of the clock no more joint states than this are made up [s].
_LONGEST_GAP_S = 2.0
_Result = FollowJointTrajectory.Result
_CODES = (
    (JointsInvalidError, _Result.INVALID_JOINTS),
    (StartStateError, _Result.PATH_TOLERANCE_VIOLATED),
)
_ENDINGS = {
    Ending.PATH_VIOLATED: _Result.PATH_TOLERANCE_VIOLATED,
    Ending.GOAL_VIOLATED: _Result.GOAL_TOLERANCE_VIOLATED,
}
PROTECTIVE_STOP, EMERGENCY_STOP = "protective_stop", "emergency_stop"
STOPS_FOLLOWING, SLOW = "stops_following", "slow"
_KINDS = (
    FaultKind(PROTECTIVE_STOP),
    FaultKind(EMERGENCY_STOP),
    FaultKind(STOPS_FOLLOWING),
    FaultKind(SLOW, {"speed_percent": (50.0, 0.0, 100.0)}),
)


class MockUr5(CellNode):
    """Follows joint trajectories in time; publishes joint states and tf."""

    NAME = "mock_ur5"
    THREADS = 1
    PARAMETERS = (
        CELL_FILE,
        SEED,
        Parameter("rate_hz", 125.0, "Joint states per second of simulated time [Hz].", 10.0, 500.0),
        Parameter(
            "tf_rate_hz", 10.0, "Most transforms per second of simulated time [Hz].", 1.0, 100.0
        ),
        Parameter(
            "feedback_rate_hz",
            2.0,
            "Feedback of a goal per second of simulated time [Hz].",
            0.1,
            50.0,
        ),
        Parameter("speed_percent", 100.0, "Speed scaling at the start [%].", 1.0, 100.0),
        Parameter(
            "path_tolerance_rad", 0.2, "While moving, where a goal does not say [rad].", 1e-4, 3.2
        ),
        Parameter(
            "goal_tolerance_rad", 0.1, "At the end, where a goal does not say [rad].", 1e-4, 3.2
        ),
        Parameter(
            "goal_time_s",
            0.6,
            "How late it may get there, if a goal does not say [s].",
            0.0,
            60.0,
        ),
        Parameter(
            "repeatability_m",
            3e-5,
            "The scanner stands at most so far beside where it was sent [m].",
            0.0,
            0.01,
        ),
        Parameter("stop_deceleration_rad_s2", 5.0, "Of a stop, any joint [rad/s^2].", 0.5, 50.0),
        STATE_FILE,
        FAULTS,
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        values, cell = self.values, configured_cell(self.values.cell_file)
        self._model = ArmModel.load(cell)
        self._cell = cell
        self._arm = self._make_arm(cell)
        self._kept = KeptState(values.state_file, len(self._model.joint_names))
        self._restored = False
        self._arm.set_speed(values.speed_percent / 100.0, 0.0)
        self._goals = GoalSlot(self)
        self._step_s = 1.0 / values.rate_hz
        self._tick_number = 0
        self._tf_s = self._told_s = self._scaling_s = 0.0
        self._T_map_base_link: Array | None = None
        self._states = self.create_publisher(JointState, "joint_states", STATE)
        self._scaling = self.create_publisher(
            Float64, "speed_scaling_state_broadcaster/speed_scaling", STATE
        )
        self._tf = self.create_publisher(TFMessage, "tf", STATE)
        static_tf = self.create_publisher(TFMessage, "tf_static", STATIC_TF)
        edge = transform_stamped_to_msg("tool0", "scanner", cell.T_tool0_scanner)
        static_tf.publish(TFMessage(transforms=[edge]))
        # Filled anew for every state: making a message costs more than publishing it.
        none = np.zeros(len(self._model.joint_names))
        self._message = joint_state_to_msg(none, none)
        self._face = DeviceFace(self, "arm", self._on_stop)
        self._faults = FaultFace(self, _KINDS, self._on_fault, self._on_fault_end)
        # Only where it stands: faults may begin at a place.
        self.create_subscription(PoseStamped, "truth/base_pose", self._on_base_pose, STATE)
        self.create_timer(self._step_s, self._on_tick)
        self._server = ActionServer(
            self,
            FollowJointTrajectory,
            f"{CONTROLLER}/follow_joint_trajectory",
            self._on_trajectory,
            goal_callback=accept_goal,
            cancel_callback=accept_cancel,
        )

    def _make_arm(self, cell: CellConfig) -> MockArm:
        model = self._model
        # Even if all joints err in the worst direction, the scanner stays within the figure.
        levers = np.maximum(model.lever_arms(), 0.05)
        return MockArm(
            model.joint_names,
            model.lower,
            model.upper,
            model.velocity,
            cell.home_rad,
            repeatability_rad=self.values.repeatability_m / len(levers) / levers,
            deceleration_rad_s2=self.values.stop_deceleration_rad_s2,
            seed=self.values.seed,
        )

    def close(self) -> None:
        """Ends the trajectory that is followed."""
        self._goals.finish(GoalEnd.CANCELLED)
        self._kept.close()

    async def _on_trajectory(self, handle: ServerGoalHandle) -> FollowJointTrajectory.Result:
        refusal = self._face.device.refusal
        try:
            if refusal:
                raise SkinplanError(refusal)
            self._accept(handle.request)
        except SkinplanError as error:
            self.get_logger().warning(f"trajectory refused: {error}")
            handle.abort()
            code = next(
                (code for kind, code in _CODES if isinstance(error, kind)), _Result.INVALID_GOAL
            )
            return _Result(error_code=code, error_string=str(error))
        end = await self._goals.begin(handle)
        conclude(handle, end)
        if end is GoalEnd.REACHED:
            return _Result(error_code=_Result.SUCCESSFUL)
        if isinstance(end, GoalFailure):
            return _Result(error_code=end.code, error_string=end.text)
        return _Result(
            error_code=_Result.INVALID_GOAL, error_string=f"the trajectory was {end.value}"
        )

    def _accept(self, goal: FollowJointTrajectory.Goal) -> None:
        names, values = self._model.joint_names, self.values
        points = goal.trajectory.points
        times, positions, velocities = joint_trajectory_from_msg(goal.trajectory)
        smooth = bool(points) and all(len(point.velocities) for point in points)
        count = len(names)
        default = np.full(count, values.path_tolerance_rad)
        path, path_velocity = joint_tolerances_from_msg(goal.path_tolerance, default)
        default = np.full(count, values.goal_tolerance_rad)
        end, end_velocity = joint_tolerances_from_msg(goal.goal_tolerance, default)
        late_s = duration_from_msg(goal.goal_time_tolerance) or values.goal_time_s
        tolerances = Tolerances(path, path_velocity, end, end_velocity, late_s)
        self._arm.accept(
            names, times, positions, self.now_s(), velocities if smooth else None, tolerances
        )

    def _on_stop(self, reason: str) -> None:
        self._arm.stop(self.now_s())
        self._goals.finish(GoalFailure(_Result.INVALID_GOAL, reason))

    def _on_fault(self, fault: Fault) -> None:
        if fault.name == PROTECTIVE_STOP:
            self._face.fail(fault.name, "the arm has stopped for its protection")
        elif fault.name == EMERGENCY_STOP:
            self._face.fail(fault.name, "the emergency stop is pressed", emergency=True)
        elif fault.name == STOPS_FOLLOWING:
            self._arm.stick(self.now_s())
        elif fault.name == SLOW:
            self._arm.set_speed(fault.values["speed_percent"] / 100.0, self.now_s())

    def _on_fault_end(self, name: str) -> None:
        if name == STOPS_FOLLOWING:
            self._arm.release()
        elif name == SLOW:
            self._arm.set_speed(self.values.speed_percent / 100.0, self.now_s())
        self._face.device.cause_gone(name)

    def _on_base_pose(self, message: PoseStamped) -> None:
        self._T_map_base_link = pose_stamped_from_msg(message, "map", "true pose of the base")

    def _on_tick(self) -> None:
        now_s = self.now_s()
        self._keep(now_s)
        self._faults.step(now_s, self._place(now_s))
        active = self._goals.active
        if active is not None and active.is_cancel_requested:
            self._arm.stop(now_s)
            self._goals.finish(GoalEnd.CANCELLED)
        self._publish(now_s)
        # After the last joint state, so that whoever waits for the end has all states before it.
        if active is not None and self._goals.active is active:
            self._follow(active, now_s)
        device = self._face.device
        device.busy, device.moving = self._goals.active is not None, self._arm.moving(now_s)
        self._face.refresh()

    def _keep(self, now_s: float) -> None:
        if not self._restored:
            self._restored = True
            stood = self._kept.read(now_s)
            if stood is not None:
                self._arm.place(stood, now_s)
        self._kept.write(now_s, self._arm.state(now_s)[0])

    def _follow(self, active: ServerGoalHandle, now_s: float) -> None:
        end = self._arm.ending(now_s)
        if end is None:
            if now_s - self._told_s >= 1.0 / self.values.feedback_rate_hz:
                self._told_s = now_s
                active.publish_feedback(self._feedback(now_s))
        elif end[0] is Ending.REACHED:
            self._goals.finish(GoalEnd.REACHED)
        else:
            self._lose(*end)

    def _lose(self, end: Ending, text: str) -> None:
        """The controller gives the trajectory up; why, only the fault knows."""
        reason = f"{end.value}: {text}"
        if self._faults.book.values(STOPS_FOLLOWING) is not None:
            self._face.device.fail(STOPS_FOLLOWING, reason)
            reason = f"{STOPS_FOLLOWING}: {reason}"
        self.get_logger().warning(reason)
        self._arm.stop(self.now_s())
        self._goals.finish(GoalFailure(_ENDINGS[end], reason))

    def _place(self, now_s: float) -> Array | None:
        """Returns where the scanner is in the shop, shape (3,) [m], when a fault waits for it."""
        if self._T_map_base_link is None or not self._faults.book.pending:
            return None
        q = self._arm.state(now_s)[0][None, :]
        T_arm_base_scanner = self._model.forward_scanner(q)[0]
        T_map_arm_base = self._T_map_base_link @ self._cell.T_base_link_arm_base
        return np.asarray((T_map_arm_base @ T_arm_base_scanner)[:3, 3])

    def _publish(self, now_s: float) -> None:
        newest = int(now_s / self._step_s)
        oldest = max(self._tick_number + 1, newest - int(_LONGEST_GAP_S / self._step_s))
        stamps = np.arange(oldest, newest + 1) * self._step_s
        if len(stamps):
            self._publish_states(stamps)
        self._tick_number = newest
        if now_s - self._scaling_s >= 1.0:
            self._scaling_s = now_s
            self._scaling.publish(Float64(data=100.0 * self._arm.speed))
        if now_s - self._tf_s >= 1.0 / self.values.tf_rate_hz:
            self._tf_s = now_s
            stamp_s = newest * self._step_s
            T_arm_base_tool0 = self._model.forward(self._arm.state(stamp_s)[0][None, :])[0]
            edge = transform_stamped_to_msg("arm_base", "tool0", T_arm_base_tool0, stamp_s)
            self._tf.publish(TFMessage(transforms=[edge]))

    def _publish_states(self, stamps: Array) -> None:
        message = self._message
        rows = zip(stamps.tolist(), *self._arm.states(stamps), strict=True)
        for stamp_s, positions, velocities in rows:
            message.header.stamp = stamp_to_msg(stamp_s)
            message.position = array.array("d", positions.tobytes())
            message.velocity = array.array("d", velocities.tobytes())
            self._states.publish(message)

    def _feedback(self, now_s: float) -> FollowJointTrajectory.Feedback:
        desired, actual = self._arm.desired(now_s), self._arm.state(now_s)
        error = desired[0] - actual[0], desired[1] - actual[1]
        points = (
            JointTrajectoryPoint(positions=where.tolist(), velocities=speed.tolist())
            for where, speed in (desired, actual, error)
        )
        feedback = FollowJointTrajectory.Feedback(
            header=header_to_msg("", now_s), joint_names=list(self._model.joint_names)
        )
        feedback.desired, feedback.actual, feedback.error = points
        return feedback


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    return run_node(MockUr5, arguments)


if __name__ == "__main__":
    sys.exit(main())
