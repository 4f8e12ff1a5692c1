"""Mock of the arm: the interfaces of ``ur_robot_driver``, on simulated time."""

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

from skinplan.errors import JointsInvalidError, SkinplanError, StartStateError
from skinplan.mock.arm import Ending
from skinplan.mock.faults import Fault, FaultKind
from skinplan.mock.kept import KeptState
from skinplan.robot.arm import ArmModel
from skinplan.transforms import Array
from skinplan_nodes.conversions import (
    pose_stamped_from_msg,
    transform_stamped_to_msg,
)
from skinplan_nodes.draining import subscribe_draining
from skinplan_nodes.goal_slot import (
    GoalEnd,
    GoalFailure,
    GoalSlot,
    accept_cancel,
    accept_goal,
    conclude,
)
from skinplan_nodes.mock_arm_parts import (
    PARAMETERS,
    StateTeller,
    feedback_of,
    make_arm,
    take_goal,
)
from skinplan_nodes.mock_device import DeviceFace, FaultFace
from skinplan_nodes.node import CellNode
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
    PARAMETERS = PARAMETERS

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        values, cell = self.values, configured_cell(self.values.cell_file)
        self._model = ArmModel.load(cell)
        self._cell = cell
        self._arm = make_arm(self._model, cell, values)
        self._kept = KeptState(values.state_file, len(self._model.joint_names))
        self._restored = False
        self._arm.set_speed(values.speed_percent / 100.0, 0.0)
        self._goals = GoalSlot(self)
        self._step_s = 1.0 / values.rate_hz
        self._tick_number = 0
        self._tf_s = self._told_s = self._scaling_s = 0.0
        self._T_map_base_link: Array | None = None
        self._states = StateTeller(self.create_publisher(JointState, "joint_states", STATE))
        self._scaling = self.create_publisher(
            Float64, "speed_scaling_state_broadcaster/speed_scaling", STATE
        )
        self._tf = self.create_publisher(TFMessage, "tf", STATE)
        static_tf = self.create_publisher(TFMessage, "tf_static", STATIC_TF)
        edge = transform_stamped_to_msg("tool0", "scanner", cell.T_tool0_scanner)
        static_tf.publish(TFMessage(transforms=[edge]))
        self._face = DeviceFace(self, "arm", self._on_stop)
        self._faults = FaultFace(self, _KINDS, self._on_fault, self._on_fault_end)
        # Only where it stands: faults may begin at a place.
        subscribe_draining(self, PoseStamped, "truth/base_pose", self._on_base_pose, STATE)
        self.create_timer(self._step_s, self._on_tick)
        self._server = ActionServer(
            self,
            FollowJointTrajectory,
            f"{CONTROLLER}/follow_joint_trajectory",
            self._on_trajectory,
            goal_callback=accept_goal,
            cancel_callback=accept_cancel,
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
            take_goal(self._arm, handle.request, self.values, self.now_s())
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
                active.publish_feedback(feedback_of(self._arm, now_s))
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
            self._states.tell(self._arm, stamps)
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


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    return run_node(MockUr5, arguments)


if __name__ == "__main__":
    sys.exit(main())
