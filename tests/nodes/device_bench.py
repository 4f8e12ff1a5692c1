"""What the tests of the devices share: goals, faults, states, and whether something moved."""

from collections.abc import Callable
from typing import Any

import numpy as np
from control_msgs.action import FollowJointTrajectory
from diagnostic_msgs.msg import KeyValue
from nav2_msgs.action import NavigateToPose
from nav_msgs.msg import Odometry
from rclpy.action import ActionClient
from sensor_msgs.msg import JointState
from skinplan_msgs.msg import DeviceState, Status
from skinplan_msgs.srv import InjectFault
from std_srvs.srv import SetBool, Trigger

from nodes.bench import Bench
from skinplan.robot.cell import CellConfig
from skinplan.transforms import Array
from skinplan_nodes.conversions import (
    joint_state_from_msg,
    joint_trajectory_to_msg,
    pose_from_msg,
    pose_stamped_to_msg,
    stamp_from_msg,
)
from skinplan_nodes.qos import LATCHED, STATE

CONTROLLER = "scaled_joint_trajectory_controller/follow_joint_trajectory"
HOME = np.array(CellConfig().home_rad)


def send(bench: Bench, kind: Any, name: str, goal: Any, on_feedback: Any = None) -> tuple[Any, Any]:
    """Sends a goal and returns its handle and the future of its result."""
    client = ActionClient(bench.tester, kind, name)
    bench.wait(client.server_is_ready)
    handle = bench.result(client.send_goal_async(goal, feedback_callback=on_feedback))
    assert handle.accepted
    return handle, handle.get_result_async()


def navigate(bench: Bench, T_map_base_link: Array, frame: str = "map") -> tuple[Any, Any]:
    """Sends the base to a pose."""
    goal = NavigateToPose.Goal(pose=pose_stamped_to_msg(T_map_base_link, frame))
    return send(bench, NavigateToPose, "navigate_to_pose", goal)


def arm_goal(times: Any, positions: Any, velocities: Any = None) -> FollowJointTrajectory.Goal:
    """A goal of the arm."""
    trajectory = joint_trajectory_to_msg(
        np.asarray(times, float), np.asarray(positions, float), velocities
    )
    return FollowJointTrajectory.Goal(trajectory=trajectory)


def follow(bench: Bench, times: Any, positions: Any) -> tuple[Any, Any]:
    """Sends the arm along a trajectory."""
    return send(bench, FollowJointTrajectory, CONTROLLER, arm_goal(times, positions))


class Devices:
    """Listens to the devices of a bench, and makes them fail."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.states: dict[str, list[DeviceState]] = {
            name: bench.collect_before(DeviceState, f"{name}/state", LATCHED)
            for name in ("arm", "base", "camera", "tracker", "scanner")
        }
        self.joints: list[JointState] = bench.collect_before(JointState, "joint_states", STATE)
        self.odometry: list[Odometry] = bench.collect_before(Odometry, "odom", STATE)

    def inject(
        self, node: str, fault: str, turning: bool = True, **fields: Any
    ) -> InjectFault.Response:
        """Asks for a fault; fields that the request has not are values of the fault."""
        request = InjectFault.Request(fault=fault)
        for key, value in fields.items():
            if hasattr(request, key):
                setattr(request, key, value)
            else:
                request.values = [*request.values, KeyValue(key=key, value=str(value))]
        return self.bench.call(InjectFault, f"{node}/inject_fault", request, turning)

    def make(self, node: str, fault: str, **fields: Any) -> None:
        """Makes a fault happen."""
        answer = self.inject(node, fault, **fields)
        assert answer.status.code == Status.OK, answer.status.message

    def end(self, node: str) -> None:
        """Ends all faults of a node."""
        assert self.inject(node, "").active == []

    def trigger(self, name: str) -> Trigger.Response:
        """Calls a service without arguments while time goes on."""
        return self.bench.call(Trigger, name, Trigger.Request(), turning=True)

    def enable(self, device: str, on: bool) -> SetBool.Response:
        """Switches a device."""
        return self.bench.call(SetBool, f"{device}/enable", SetBool.Request(data=on), turning=True)

    def wait_for(self, device: str, state: int, fault: str = "") -> DeviceState:
        """Waits, bounded, for a state."""

        def found() -> DeviceState | None:
            last = self.states[device][-1] if self.states[device] else None
            same = last is not None and (last.state, last.fault) == (state, fault)
            return last if same else None

        return self.bench.wait(found, turning=True)  # type: ignore[no-any-return]

    def wait_until_moving(self, device: str) -> None:
        """Waits until the arm or the base is well under way."""
        if device == "arm":
            self.bench.wait(
                lambda: self.joints and np.abs(joint_state_from_msg(self.joints[-1])[1]).max() > 0,
                turning=True,
            )
            self.bench.turn_clock(self.bench.now_s + 0.5)
            return
        self.bench.wait(
            lambda: self.odometry and abs(self.odometry[-1].twist.twist.linear.x) > 0.5,
            turning=True,
            step_s=0.05,
        )

    def stands(self, device: str, from_s: float, for_s: float = 3.0) -> bool:
        """Tells whether a device moves not at all after a time, for a while that is waited for."""
        end_s = from_s + for_s
        stamps = self.joints if device == "arm" else self.odometry
        self.bench.wait(
            lambda: stamps and stamp_from_msg(stamps[-1].header.stamp) >= end_s, turning=True
        )
        places = self._places(device, from_s)
        assert len(places) >= 3
        return bool(np.abs(places - places[0]).max() < 1e-9)

    def _places(self, device: str, from_s: float) -> Array:
        read: Callable[[Any], Array]
        messages: list[Any]
        if device == "arm":
            messages, read = self.joints, lambda message: joint_state_from_msg(message)[0]
        else:
            messages = self.odometry
            read = lambda message: pose_from_msg(message.pose.pose)[:3].ravel()  # noqa: E731
        later = [m for m in messages if stamp_from_msg(m.header.stamp) >= from_s - 1e-9]
        return np.array([read(message) for message in later])
