"""Distance from singular positions, and the filter in front of the inverse kinematics."""

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

from skinplan.robot.arm import ArmModel
from skinplan.robot.cell import CellConfig
from skinplan.robot.dexterity import Dexterity
from skinplan.robot.wrist_filter import NONE, SINGULAR, SOME, WristFilter

ROBOTS = ("ur5", "gcr14_1400")


def arm_of(robot):
    return ArmModel.load(dataclasses.replace(CellConfig(), robot=robot))


def random_joints(count, seed=0):
    return np.random.default_rng(seed).uniform(-np.pi, np.pi, (count, 6))


def test_a_ur5_has_the_sines_of_joints_3_and_5():
    q = random_joints(200)
    found = Dexterity(arm_of("ur5"))
    assert np.allclose(found.elbow(q), np.abs(np.sin(q[:, 2])))
    assert np.allclose(found.wrist(q), np.abs(np.sin(q[:, 4])))
    assert np.allclose(found.measure(q), np.abs(np.sin(q[:, [2, 4]])).min(axis=1))


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_jacobian_is_singular_where_a_measure_is_zero(robot):
    arm = arm_of(robot)
    found = Dexterity(arm)
    q = random_joints(20)
    # Angles of joints 3 and 5 at which the measure vanishes, by bisection on the signed sine.
    for joint, measure in ((2, found.elbow), (4, found.wrist)):
        angles = np.linspace(-np.pi, np.pi, 20001)
        probe = np.zeros((len(angles), 6))
        probe[:, joint] = angles
        zero = angles[np.argmin(measure(probe))]
        q[:, joint] = zero
        data = arm.model.createData()
        for row in q:
            jacobian = pin.computeFrameJacobian(
                arm.model, data, row, arm.model.getFrameId("tool0"), pin.LOCAL
            )
            assert np.linalg.svd(jacobian, compute_uv=False)[-1] < 1e-3
        q = random_joints(20)


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_filter_agrees_with_the_solver_on_random_poses(robot):
    arm = arm_of(robot)
    test, measure = WristFilter(arm), Dexterity(arm)
    assert test.applies
    T = arm.forward(random_joints(4000, 1))
    T[:, :3, 3] += np.random.default_rng(2).normal(0.0, 0.3, (4000, 3))
    branches, valid = arm.inverse(T)
    centres = T[:, :3, :3] @ test.centre_tool0 + T[:, :3, 3]
    grades = test.grade(centres, T[:, :3, :3] @ test.axis_tool0)
    clear = np.zeros_like(valid)
    clear[valid] = measure.clear(branches[valid])
    assert 0.3 < np.mean(grades == SOME) < 0.9 and np.any(grades == SINGULAR)
    assert np.array_equal(grades > NONE, valid.any(axis=1))
    assert np.array_equal(grades == SOME, clear.any(axis=1))


def test_an_arm_of_another_kind_lets_every_view_pass():
    test = WristFilter(arm_of("ur5"))
    test.applies = False
    assert np.all(test.grade(np.full((3, 3), 99.0), np.eye(3)) == SOME)


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_eight_branches_of_a_pose_have_eight_numbers(robot):
    arm = arm_of(robot)
    found = Dexterity(arm)
    branches, valid = arm.inverse(arm.forward(random_joints(300, 3)))
    full = np.flatnonzero(valid.all(axis=1))
    shoulders = np.array([found.shoulder(q) for q in branches[full]])
    full = full[(np.abs(shoulders) > 1e-3).all(axis=1)]
    assert len(full) > 30
    for q in branches[full]:
        assert sorted(found.branches(q)) == list(range(8))


@pytest.mark.parametrize("robot", ROBOTS)
def test_branches_do_not_depend_on_windings_nor_on_the_first_and_the_last_joint(robot):
    found, q = Dexterity(arm_of(robot)), random_joints(200, 4)
    rng = np.random.default_rng(5)
    wound = q + 2.0 * np.pi * rng.integers(-1, 2, q.shape)
    assert np.array_equal(found.branches(q), found.branches(wound))
    turned = q + rng.uniform(-3, 3, q.shape) * [1, 0, 0, 0, 0, 1]
    assert np.array_equal(found.branches(q), found.branches(turned))


@pytest.mark.parametrize("robot", ROBOTS)
def test_between_two_branches_the_jacobian_changes_its_sign(robot):
    """Its determinant is a product of shoulder, elbow and wrist: an odd change turns its sign."""
    arm = arm_of(robot)
    found, q = Dexterity(arm), random_joints(300, 6)
    data, frame = arm.model.createData(), arm.model.getFrameId("tool0")
    sign = np.array([
        np.sign(np.linalg.det(pin.computeFrameJacobian(arm.model, data, row, frame, pin.LOCAL)))
        for row in q
    ])  # fmt: skip
    number = found.branches(q)
    odd = (number & 1) ^ (number >> 1 & 1) ^ (number >> 2 & 1)
    same = sign == np.where(odd == 1, 1.0, -1.0)
    assert same.all() or not same.any()


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_jacobian_is_singular_where_the_wrist_is_above_the_first_axis(robot):
    arm = arm_of(robot)
    found, rng = Dexterity(arm), np.random.default_rng(7)
    data, frame = arm.model.createData(), arm.model.getFrameId("tool0")
    crossed = 0
    for q in random_joints(60, 8):
        other = q.copy()
        other[1:4] += rng.uniform(-1.5, 1.5, 3)
        ends = found.shoulder(np.stack([q, other]))
        if ends[0] * ends[1] >= 0.0:
            continue
        low, high = q, other
        for _ in range(60):  # bisection
            middle = 0.5 * (low + high)
            if found.shoulder(middle[None])[0] * ends[0] > 0.0:
                low = middle
            else:
                high = middle
        jacobian = pin.computeFrameJacobian(arm.model, data, low, frame, pin.LOCAL)
        assert np.linalg.svd(jacobian, compute_uv=False)[-1] < 1e-9
        crossed += 1
    assert crossed >= 10


def test_the_shoulder_of_a_ur5_by_hand():
    """Upper arm, forearm and wrist, in the plane of the arm; links of 425, 392.25, 94.65 mm."""
    q = random_joints(100, 9)
    a, b, c = q[:, 1], q[:, 1] + q[:, 2], q[:, 1] + q[:, 2] + q[:, 3]
    expected = -0.425 * np.cos(a) - 0.39225 * np.cos(b) + 0.09465 * np.sin(c)
    assert np.abs(Dexterity(arm_of("ur5")).shoulder(q) - expected).max() < 1e-9
