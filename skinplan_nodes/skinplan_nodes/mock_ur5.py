"""Mock of the arm: the interfaces of ``ur_robot_driver``, on simulated time."""

import sys
from collections.abc import Sequence
from typing import Any

from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionServer
from rclpy.action.server import ServerGoalHandle
from sensor_msgs.msg import JointState
from tf2_msgs.msg import TFMessage

from skinplan.errors import JointsInvalidError, SkinplanError, StartStateError
from skinplan.mock.arm import MockArm
from skinplan.robot.arm import ArmModel
from skinplan_nodes.conversions import (
    joint_state_to_msg,
    joint_trajectory_from_msg,
    transform_stamped_to_msg,
)
from skinplan_nodes.goal_slot import GoalEnd, GoalSlot, accept_cancel, accept_goal, conclude
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


class MockUr5(CellNode):
    """Follows joint trajectories in time; publishes joint states and tf."""

    NAME = "mock_ur5"
    THREADS = 1
    PARAMETERS = (
        CELL_FILE,
        Parameter("rate_hz", 50.0, "Joint states per second of simulated time [Hz].", 10.0, 500.0),
        Parameter(
            "tf_rate_hz", 10.0, "Most transforms per second of simulated time [Hz].", 1.0, 100.0
        ),
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        cell = configured_cell(self.values.cell_file)
        self._model = ArmModel.load(cell)
        self._arm = MockArm(
            self._model.joint_names,
            self._model.lower,
            self._model.upper,
            cell.velocity_max_rad_s,
            cell.home_rad,
        )
        self._goals = GoalSlot(self)
        self._step_s = 1.0 / self.values.rate_hz
        self._tick_number = 0
        self._tf_s = 0.0
        self._states = self.create_publisher(JointState, "joint_states", STATE)
        self._tf = self.create_publisher(TFMessage, "tf", STATE)
        static_tf = self.create_publisher(TFMessage, "tf_static", STATIC_TF)
        static_tf.publish(
            TFMessage(
                transforms=[transform_stamped_to_msg("tool0", "scanner", cell.T_tool0_scanner)]
            )
        )
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

    async def _on_trajectory(self, handle: ServerGoalHandle) -> FollowJointTrajectory.Result:
        try:
            times, positions, _ = joint_trajectory_from_msg(handle.request.trajectory)
            self._arm.accept(self._model.joint_names, times, positions, self.now_s())
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
        return _Result(
            error_code=_Result.INVALID_GOAL, error_string=f"the trajectory was {end.value}"
        )

    def _on_tick(self) -> None:
        now_s = self.now_s()
        active = self._goals.active
        if active is not None and active.is_cancel_requested:
            self._arm.stop(now_s)
            self._goals.finish(GoalEnd.CANCELLED)
        self._publish(now_s)
        # After the last joint state, so that whoever waits for the end has all states before it.
        if active is not None and self._goals.active is active and self._arm.done(now_s):
            self._goals.finish(GoalEnd.REACHED)

    def _publish(self, now_s: float) -> None:
        newest = int(now_s / self._step_s)
        oldest = max(self._tick_number + 1, newest - int(_LONGEST_GAP_S / self._step_s))
        for number in range(oldest, newest + 1):
            stamp_s = number * self._step_s
            self._states.publish(joint_state_to_msg(*self._arm.state(stamp_s), stamp_s))
        self._tick_number = newest
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
