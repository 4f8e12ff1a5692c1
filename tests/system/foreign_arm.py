"""An arm of somebody else: rclpy and standard interfaces, nothing of this repository."""

import sys
import time

import numpy as np
import rclpy
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionServer, CancelResponse
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState

ACTION = "scaled_joint_trajectory_controller/follow_joint_trajectory"


class ForeignArm(Node):
    def __init__(self, names, home, **kwargs):
        sim = Parameter("use_sim_time", value=True)
        super().__init__("foreign_arm", parameter_overrides=[sim], **kwargs)
        self.names, self.q = names, home
        self.states = self.create_publisher(JointState, "joint_states", 50)
        self.create_timer(0.02, self.tell)
        accept = lambda _: CancelResponse.ACCEPT  # noqa: E731
        self.server = ActionServer(
            self, FollowJointTrajectory, ACTION, self.follow, cancel_callback=accept
        )

    def tell(self):
        state = JointState(name=self.names, position=list(self.q))
        state.header.stamp = self.get_clock().now().to_msg()
        self.states.publish(state)

    def follow(self, handle):
        names, points = handle.request.trajectory.joint_names, handle.request.trajectory.points
        order = [names.index(name) for name in self.names]
        due = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in points]
        path = np.array([p.positions for p in points])[:, order].T
        begin = self.get_clock().now()
        while (spent := (self.get_clock().now() - begin).nanoseconds * 1e-9) < due[-1]:
            if handle.is_cancel_requested:
                handle.canceled()
                return FollowJointTrajectory.Result()
            self.q = [float(np.interp(spent, due, way)) for way in path]
            time.sleep(0.005)
        self.q = [float(way[-1]) for way in path]
        handle.succeed()
        return FollowJointTrajectory.Result()


if __name__ == "__main__":
    rclpy.init()
    executor = MultiThreadedExecutor(3)
    executor.add_node(
        ForeignArm(sys.argv[1].split(","), [float(q) for q in sys.argv[2].split(",")])
    )
    executor.spin()
