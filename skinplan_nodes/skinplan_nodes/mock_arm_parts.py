"""Of the mock arm: its parameters, goals taken apart, joint states and feedback."""

import array
from types import SimpleNamespace
from typing import Any

import numpy as np
from control_msgs.action import FollowJointTrajectory
from trajectory_msgs.msg import JointTrajectoryPoint

from skinplan.mock.arm import MockArm, Tolerances
from skinplan.robot.arm import ArmModel
from skinplan.robot.cell import CellConfig
from skinplan.transforms import Array
from skinplan_nodes.conversions import (
    duration_from_msg,
    header_to_msg,
    joint_state_to_msg,
    joint_tolerances_from_msg,
    joint_trajectory_from_msg,
    stamp_to_msg,
)
from skinplan_nodes.mock_device import FAULTS
from skinplan_nodes.mock_parts import SEED, STATE_FILE
from skinplan_nodes.parameters import CELL_FILE, Parameter

PARAMETERS = (
    CELL_FILE,
    SEED,
    Parameter("rate_hz", 125.0, "Joint states per second of simulated time [Hz].", 10.0, 500.0),
    Parameter("tf_rate_hz", 10.0, "Most transforms per second of simulated time [Hz].", 1.0, 100.0),
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
    Parameter("goal_tolerance_rad", 0.1, "At the end, where a goal does not say [rad].", 1e-4, 3.2),
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


def make_arm(model: ArmModel, cell: CellConfig, values: SimpleNamespace) -> MockArm:
    """Makes the arm at home."""
    # Even if all joints err in the worst direction, the scanner stays within the figure.
    levers = np.maximum(model.lever_arms(), 0.05)
    return MockArm(
        model.joint_names,
        model.lower,
        model.upper,
        model.velocity,
        cell.home_rad,
        repeatability_rad=values.repeatability_m / len(levers) / levers,
        deceleration_rad_s2=values.stop_deceleration_rad_s2,
        seed=values.seed,
    )


def take_goal(
    arm: MockArm, goal: FollowJointTrajectory.Goal, values: SimpleNamespace, now_s: float
) -> None:
    """Gives the arm a goal.

    Raises:
        InputError: It can't be carried out.
    """
    names, points = arm.joint_names, goal.trajectory.points
    times, positions, velocities = joint_trajectory_from_msg(goal.trajectory, names)
    smooth = bool(points) and all(len(point.velocities) for point in points)
    default = np.full(len(names), values.path_tolerance_rad)
    path, path_velocity = joint_tolerances_from_msg(goal.path_tolerance, default, names)
    default = np.full(len(names), values.goal_tolerance_rad)
    end, end_velocity = joint_tolerances_from_msg(goal.goal_tolerance, default, names)
    late_s = duration_from_msg(goal.goal_time_tolerance) or values.goal_time_s
    tolerances = Tolerances(path, path_velocity, end, end_velocity, late_s)
    arm.accept(names, times, positions, now_s, velocities if smooth else None, tolerances)


class StateTeller:
    """Publishes joint states, many at a turn of the clock.

    Args:
        publisher: Of the topic.
    """

    def __init__(self, publisher: Any) -> None:
        self._publisher = publisher
        # Filled anew for every state: making a message costs more than publishing it.
        self._message = joint_state_to_msg(np.zeros(6), np.zeros(6))

    def tell(self, arm: MockArm, stamps: Array) -> None:
        """Publishes the states at these times, shape (n,) [s]."""
        message = self._message
        for stamp_s, positions, velocities in zip(
            stamps.tolist(), *arm.states(stamps), strict=True
        ):
            message.header.stamp = stamp_to_msg(stamp_s)
            message.position = array.array("d", positions.tobytes())
            message.velocity = array.array("d", velocities.tobytes())
            self._publisher.publish(message)


def feedback_of(arm: MockArm, now_s: float) -> FollowJointTrajectory.Feedback:
    """Returns where the arm should be, where it is, and the difference."""
    desired, actual = arm.desired(now_s), arm.state(now_s)
    error = desired[0] - actual[0], desired[1] - actual[1]
    feedback = FollowJointTrajectory.Feedback(
        header=header_to_msg("", now_s), joint_names=list(arm.joint_names)
    )
    feedback.desired, feedback.actual, feedback.error = (
        JointTrajectoryPoint(positions=where.tolist(), velocities=speed.tolist())
        for where, speed in (desired, actual, error)
    )
    return feedback
