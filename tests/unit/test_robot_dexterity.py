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
