"""Round trips of times, poses and joints; each with its illegal twin."""

import struct

import numpy as np
import pytest
from geometry_msgs.msg import Pose, PoseStamped, Quaternion, TransformStamped
from rclpy.serialization import serialize_message
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState

from skinplan.errors import InputError, JointsInvalidError
from skinplan.robot.arm import JOINT_NAMES
from skinplan.transforms import transform
from skinplan_nodes import conversions as c

NAN = float("nan")


def random_pose(seed):
    random = np.random.default_rng(seed)
    turn = Rotation.random(random_state=random).as_matrix()
    return transform(random.uniform(-5.0, 5.0, 3), turn)


@pytest.mark.parametrize("time_s", [0.0, 0.1, 12.345678901, 1234567.000000001])
def test_stamp_round_trip_is_good_to_a_nanosecond(time_s):
    assert c.stamp_from_msg(c.stamp_to_msg(time_s)) == pytest.approx(time_s, abs=1e-9)
    assert c.duration_from_msg(c.duration_to_msg(time_s)) == pytest.approx(time_s, abs=1e-9)


def test_stamp_does_not_carry_a_whole_second_as_nanoseconds():
    msg = c.stamp_to_msg(1.9999999999)
    assert (msg.sec, msg.nanosec) == (2, 0)


def test_stamp_refuses_nan():
    with pytest.raises(InputError, match="finite time"):
        c.stamp_to_msg(NAN)


@pytest.mark.parametrize("seed", range(5))
def test_pose_and_transform_round_trips(seed):
    pose = random_pose(seed)
    np.testing.assert_allclose(c.pose_from_msg(c.pose_to_msg(pose)), pose, atol=1e-12)
    np.testing.assert_allclose(c.transform_from_msg(c.transform_to_msg(pose)), pose, atol=1e-12)
    stamped = c.pose_stamped_to_msg(pose, "map", 3.25)
    np.testing.assert_allclose(c.pose_stamped_from_msg(stamped, "map"), pose, atol=1e-12)
    parent, child, found, time_s = c.transform_stamped_from_msg(
        c.transform_stamped_to_msg("map", "base_link", pose, 4.5)
    )
    assert (parent, child, time_s) == ("map", "base_link", 4.5)
    np.testing.assert_allclose(found, pose, atol=1e-12)


def test_empty_pose_is_the_identity():
    np.testing.assert_array_equal(c.pose_from_msg(Pose()), np.eye(4))


def test_pose_refuses_another_frame():
    with pytest.raises(InputError, match="frame 'map' is accepted, found 'odom'"):
        c.pose_stamped_from_msg(c.pose_stamped_to_msg(np.eye(4), "odom"), "map")
    with pytest.raises(InputError, match="found ''"):
        c.pose_stamped_from_msg(PoseStamped(), "map")


@pytest.mark.parametrize(
    "turn, text", [((0.0, 0.0, 0.0, 0.0), "length 0"), ((0.0, 0.0, 0.0, NAN), "finite")]
)
def test_pose_refuses_a_quaternion_that_is_none(turn, text):
    x, y, z, w = turn
    with pytest.raises(InputError, match=text):
        c.pose_from_msg(Pose(orientation=Quaternion(x=x, y=y, z=z, w=w)))


def test_transform_refuses_an_empty_name():
    with pytest.raises(InputError, match="two named frames"):
        c.transform_stamped_from_msg(TransformStamped())


def test_joint_state_round_trip_and_order_by_name():
    positions, velocities = np.arange(6) * 0.1, -np.arange(6) * 0.2
    msg = c.joint_state_to_msg(positions, velocities, 2.0)
    turned = JointState(
        name=[*msg.name[::-1], "gripper"],
        position=[*msg.position[::-1], 9.0],
        velocity=[*msg.velocity[::-1], 9.0],
    )
    for received in (msg, turned):
        found = c.joint_state_from_msg(received)
        np.testing.assert_array_equal(found[0], positions)
        np.testing.assert_array_equal(found[1], velocities)


def test_joint_state_without_velocities_has_unknown_ones():
    assert np.isnan(c.joint_state_from_msg(c.joint_state_to_msg(np.zeros(6)))[1]).all()


def test_start_state_empty_means_home():
    assert c.start_from_msg(JointState()) is None
    np.testing.assert_array_equal(c.start_from_msg(c.joint_state_to_msg(np.ones(6))), np.ones(6))


@pytest.mark.parametrize(
    "change, text",
    [
        ({"name": list(JOINT_NAMES[:5])}, "wrist_3_joint"),
        ({"name": [JOINT_NAMES[0]] * 6}, "every joint once"),
        ({"position": [0.0] * 5}, "found 5"),
        ({"position": [NAN] * 6}, "finite"),
    ],
)
def test_joint_state_refuses(change, text):
    msg = c.joint_state_to_msg(np.zeros(6))
    for name, value in change.items():
        setattr(msg, name, value)
    with pytest.raises(JointsInvalidError, match=text):
        c.joint_state_from_msg(msg)


def test_joint_trajectory_round_trip():
    random = np.random.default_rng(3)
    times, positions, velocities = np.linspace(0.0, 2.0, 9), *random.normal(size=(2, 9, 6))
    msg = c.joint_trajectory_to_msg(times, positions, velocities)
    found = c.joint_trajectory_from_msg(msg)
    np.testing.assert_allclose(found[0], times, atol=1e-9)
    np.testing.assert_array_equal(found[1], positions)
    np.testing.assert_array_equal(found[2], velocities)


def test_joint_trajectory_empty():
    msg = c.joint_trajectory_to_msg(np.zeros(0), np.zeros((0, 6)))
    assert [a.shape for a in c.joint_trajectory_from_msg(msg)] == [(0,), (0, 6), (0, 6)]
    assert [a.shape for a in c.joint_trajectory_from_msg(type(msg)())] == [(0,), (0, 6), (0, 6)]


@pytest.mark.parametrize(
    "names, text", [(JOINT_NAMES[1:], "missing"), ((*JOINT_NAMES, "gripper"), "found also")]
)
def test_joint_trajectory_refuses_names(names, text):
    msg = c.joint_trajectory_to_msg(np.zeros(1), np.zeros((1, 6)))
    msg.joint_names = list(names)
    with pytest.raises(JointsInvalidError, match=text):
        c.joint_trajectory_from_msg(msg)


def test_joint_trajectory_refuses_values():
    msg = c.joint_trajectory_to_msg(np.zeros(1), np.zeros((1, 6)))
    msg.points[0].positions = [0.0] * 5
    with pytest.raises(JointsInvalidError, match="point 0 has 5 positions"):
        c.joint_trajectory_from_msg(msg)
    msg.points[0].positions = [NAN] * 6
    with pytest.raises(JointsInvalidError, match="finite"):
        c.joint_trajectory_from_msg(msg)


def test_stamp_of_a_serialised_message():
    for stamp_s in (0.0, 1.25, 123456.789):
        message = c.joint_state_to_msg(np.zeros(6), None, stamp_s)
        data = serialize_message(message)
        assert c.raw_stamp_s(data) == pytest.approx(stamp_s, abs=1e-9)
        # The same of a machine with the other order of bytes.
        sec, nanosec = message.header.stamp.sec, message.header.stamp.nanosec
        other = b"\0\0\0\0" + struct.pack(">iI", sec, nanosec)
        assert c.raw_stamp_s(other) == pytest.approx(stamp_s, abs=1e-9)
