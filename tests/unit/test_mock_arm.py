"""The mock arm: straight joint motion on time, and a reason for every refusal."""

import numpy as np
import pytest

from skinplan.errors import InputError, JointsInvalidError, StartStateError
from skinplan.mock.arm import MockArm

NAMES = ("pan", "lift", "elbow")
HOME = np.array([0.0, -1.0, 1.0])


def arm():
    return MockArm(NAMES, [-3.0] * 3, [3.0] * 3, 2.0, HOME)


def test_state_is_linear_between_the_points():
    robot = arm()
    path = np.array([HOME, HOME + [1.0, 0.0, 0.0], HOME + [1.0, 0.5, 0.0]])
    robot.accept(NAMES, [0.0, 1.0, 2.0], path, 10.0)
    positions, velocities = robot.state(10.25)
    np.testing.assert_allclose(positions, HOME + [0.25, 0, 0])
    np.testing.assert_allclose(velocities, [1.0, 0.0, 0.0])
    positions, velocities = robot.state(11.5)
    np.testing.assert_allclose(positions, HOME + [1.0, 0.25, 0])
    np.testing.assert_allclose(velocities, [0.0, 0.5, 0.0])
    assert not robot.done(11.99)
    assert robot.done(12.0)
    np.testing.assert_allclose(robot.state(99.0)[0], path[-1])
    np.testing.assert_array_equal(robot.state(99.0)[1], 0.0)


def test_joints_go_by_name():
    robot = arm()
    order = [2, 0, 1]
    path = np.array([HOME, HOME + [0.1, 0.2, 0.3]])
    robot.accept([NAMES[i] for i in order], [0.0, 1.0], path[:, order], 0.0)
    np.testing.assert_allclose(robot.state(2.0)[0], path[1])


def test_a_first_point_in_the_future_is_reached_from_where_the_arm_is():
    robot = arm()
    robot.accept(NAMES, [2.0], [HOME + 1.0], 5.0)
    np.testing.assert_allclose(robot.state(6.0)[0], HOME + 0.5)


def test_the_past_is_remembered():
    robot = arm()
    robot.accept(NAMES, [0.0, 1.0], [HOME, HOME + 1.0], 10.0)
    robot.accept(NAMES, [0.0, 1.0], [HOME + 1.0, HOME], 11.0)
    np.testing.assert_allclose(robot.state(10.5)[0], HOME + 0.5)
    np.testing.assert_allclose(robot.state(9.0)[0], HOME)
    np.testing.assert_allclose(robot.state(11.25)[0], HOME + 0.75)


def test_stop_brakes_along_the_path_and_holds():
    robot = arm()
    robot.accept(NAMES, [0.0, 1.0], [HOME, HOME + 1.0], 10.0)
    robot.stop(10.4)
    assert not robot.done(10.59)
    np.testing.assert_allclose(robot.state(10.5)[1], 0.5)
    assert robot.done(10.6 + 1e-9)
    np.testing.assert_allclose(robot.state(20.0)[0], HOME + 0.4 + 1.0**2 / (2.0 * 5.0))
    np.testing.assert_array_equal(robot.state(20.0)[1], 0.0)
    np.testing.assert_allclose(robot.state(10.2)[0], HOME + 0.2)


def test_a_start_within_the_tolerance_makes_no_jump():
    robot = arm()
    robot.accept(NAMES, [0.0, 1.0], [HOME + 0.01, HOME + 1.0], 0.0)
    np.testing.assert_allclose(robot.state(0.0)[0], HOME)
    np.testing.assert_allclose(robot.state(1.0)[0], HOME + 1.0)


@pytest.mark.parametrize(
    ("names", "times", "positions", "error", "word"),
    [
        (("pan", "lift", "wrist"), [0, 1], [HOME, HOME], JointsInvalidError, "wrist"),
        (("pan", "lift"), [0, 1], [HOME[:2]] * 2, JointsInvalidError, "each of them"),
        (("pan", "pan", "lift"), [0, 1], [HOME] * 2, JointsInvalidError, "each of them"),
        (NAMES, [0, 2, 1], [HOME] * 3, InputError, "point 2"),
        (NAMES, [0, 0], [HOME] * 2, InputError, "rise"),
        (NAMES, [-1, 1], [HOME] * 2, InputError, "rise"),
        (NAMES, [], np.zeros((0, 3)), InputError, "n >= 1"),
        (NAMES, [0, 1], [HOME], InputError, "positions"),
        (NAMES, [0, 1], [HOME, HOME[:2]], InputError, "lengths"),
        (NAMES, [0, 1], [HOME, HOME * np.nan], InputError, "finite"),
        (NAMES, [0, np.inf], [HOME, HOME], InputError, "finite"),
        (NAMES, [0, 1], [HOME + 0.5, HOME], StartStateError, "stands at"),
        (NAMES, [0, 9], [HOME, HOME + 3.0], JointsInvalidError, r"\[-3.0000, 3.0000\]"),
        (NAMES, [0, 0.1], [HOME, HOME + 1.0], JointsInvalidError, "rad/s"),
    ],
)
def test_illegal_goals_are_refused_and_the_arm_stays(names, times, positions, error, word):
    robot = arm()
    with pytest.raises(error, match=word):
        robot.accept(names, times, positions, 1.0)
    np.testing.assert_array_equal(robot.state(5.0)[0], HOME)
    assert robot.done(1.0)


def test_a_home_that_does_not_fit_is_refused():
    with pytest.raises(JointsInvalidError, match="3 joints"):
        MockArm(NAMES, [-3.0] * 3, [3.0] * 3, 2.0, [0.0, 0.0])
    with pytest.raises(JointsInvalidError, match="lift"):
        MockArm(NAMES, [-3.0] * 3, [3.0] * 3, 2.0, [0.0, 4.0, 0.0])
