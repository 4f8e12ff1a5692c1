"""Mock of the mobile base: the interfaces of a Nav2 base, on simulated time."""

import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav2_msgs.action import NavigateToPose
from nav_msgs.msg import Odometry
from rclpy.action import ActionServer
from rclpy.action.server import ServerGoalHandle
from tf2_msgs.msg import TFMessage

from skinplan.errors import SkinplanError
from skinplan.mock.base import BaseConfig, MockBase
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
from skinplan_nodes.goal_slot import GoalEnd, GoalSlot, accept_cancel, accept_goal, conclude
from skinplan_nodes.mock_parts import SHOP, part_of
from skinplan_nodes.node import CellNode
from skinplan_nodes.parameters import Parameter
from skinplan_nodes.planning import configured_cell
from skinplan_nodes.qos import LATCHED, STATE, STATIC_TF
from skinplan_nodes.run import run_node

_IDENTITY = np.eye(4)


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
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        cell, part = configured_cell(self.values.cell_file), part_of(self.values)
        truth = Truth(part, cell, self.values.seed)
        self._base = MockBase(BaseConfig(), cell, self.values.seed, truth.T_map_base_start)
        self._goals = GoalSlot(self)
        self._started_s = self._told_s = 0.0
        self._odometry = self.create_publisher(Odometry, "odom", STATE)
        self._tf = self.create_publisher(TFMessage, "tf", STATE)
        self._static_tf = self.create_publisher(TFMessage, "tf_static", STATIC_TF)
        self._true_base = self.create_publisher(PoseStamped, "truth/base_pose", STATE)
        self._true_part = self.create_publisher(PoseStamped, "truth/workpiece_pose", LATCHED)
        self._static_tf.publish(TFMessage(transforms=static_transforms(cell)))
        self._true_part.publish(pose_stamped_to_msg(truth.T_map_workpiece, "map"))
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

    async def _on_navigate(self, handle: ServerGoalHandle) -> NavigateToPose.Result:
        now_s = self.now_s()
        try:
            target = pose_stamped_from_msg(handle.request.pose, "map", "goal of the base")
            self._base.goal(target, now_s)
        except SkinplanError as error:
            self.get_logger().warning(f"goal refused: {error}")
            handle.abort()
            return NavigateToPose.Result(
                error_code=NavigateToPose.Result.UNKNOWN, error_msg=str(error)
            )
        self._started_s = self._told_s = now_s
        end = await self._goals.begin(handle)
        conclude(handle, end)
        if end is GoalEnd.REACHED:
            return NavigateToPose.Result(error_code=NavigateToPose.Result.NONE)
        return NavigateToPose.Result(
            error_code=NavigateToPose.Result.UNKNOWN, error_msg=f"the goal was {end.value}"
        )

    def _on_tick(self) -> None:
        now_s = self.now_s()
        self._base.step(now_s)
        active = self._goals.active
        if active is not None and active.is_cancel_requested:
            self._base.cancel(now_s)
            self._goals.finish(GoalEnd.CANCELLED)
        elif active is not None and not self._base.moving:
            self._goals.finish(GoalEnd.REACHED)
        elif active is not None and now_s - self._told_s >= 1.0 / self.values.feedback_rate_hz:
            self._told_s = now_s
            active.publish_feedback(self._feedback(now_s))
        self._publish(now_s)

    def _publish(self, now_s: float) -> None:
        T_odom_base_link = self._base.believed
        message = Odometry(header=header_to_msg("odom", now_s), child_frame_id="base_link")
        message.pose.pose = pose_to_msg(T_odom_base_link)
        message.twist.twist.linear.x = float(self._base.speed)
        message.twist.twist.angular.z = float(self._base.turn_rate)
        self._odometry.publish(message)
        edges = [("map", "odom", _IDENTITY), ("odom", "base_link", T_odom_base_link)]
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
