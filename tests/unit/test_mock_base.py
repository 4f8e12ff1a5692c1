"""The mock base: closed forms of motion, stopping errors in their bounds, refusals."""

from dataclasses import replace

import numpy as np
import pytest

from skinplan.errors import InputError
from skinplan.mock.base import BaseConfig, MockBase
from skinplan.mock.profile import Braking, Profile
from skinplan.robot.cell import CellConfig
from skinplan.transforms import difference, heading, planar, transform

CELL = CellConfig()
START = planar(0.0, 0.0, 0.0)


def base(seed=1, cell=CELL, start=START):
    return MockBase(BaseConfig(), cell, seed, start)


@pytest.mark.parametrize("distance", [0.3, 2.0, 5.0])
def test_profile_against_its_closed_form(distance):
    """Speed is the derivative of the way, within its limits; the duration is the known one."""
    profile = Profile(distance, 1.0, 0.5)
    long = distance / 1.0 + 1.0 / 0.5
    short = 2.0 * np.sqrt(distance / 0.5)
    assert profile.duration == pytest.approx(long if distance >= 2.0 else short)
    times = np.linspace(0.0, profile.duration, 400)
    way, speed = np.array([profile.at(t) for t in times]).T
    assert way[0] == 0.0
    assert way[-1] == distance
    assert speed.max() <= 1.0 + 1e-12
    np.testing.assert_allclose(np.gradient(way, times)[2:-2], speed[2:-2], atol=0.02)
    assert np.abs(np.diff(speed) / np.diff(times)).max() <= 0.5 + 1e-9


def test_braking_ends_at_rest():
    braking = Braking(1.0, 0.5)
    assert braking.at(99.0) == (pytest.approx(1.0), pytest.approx(0.0))
    assert braking.distance == pytest.approx(1.0)


def test_goal_is_reached_on_time_by_any_steps():
    goal = planar(2.0, 1.0, 1.2)
    jump, small = base(), base()
    jump.goal(goal)
    small.goal(goal)
    end = jump.remaining_s
    jump.step(0.6 * end)
    for now in np.arange(0.0, 0.6 * end, 0.01):
        small.step(now)
    small.step(0.6 * end)
    np.testing.assert_allclose(small.believed, jump.believed, atol=1e-12)
    np.testing.assert_allclose(small.true, jump.true, atol=1e-12)
    assert jump.moving
    jump.step(end)
    assert not jump.moving
    assert jump.speed == 0.0
    np.testing.assert_allclose(jump.believed, goal, atol=1e-9)


def test_it_never_moves_sideways_and_keeps_its_limits():
    robot = base()
    robot.goal(planar(1.0, 2.0, -2.0))
    times = np.arange(0.0, robot.remaining_s, 0.02)
    poses, speeds, rates = [], [], []
    for now in times:
        robot.step(now)
        poses.append(robot.believed)
        speeds.append(robot.speed)
        rates.append(robot.turn_rate)
    for here, there in zip(poses[:-1], poses[1:], strict=True):
        step = there[:2, 3] - here[:2, 3]
        side = np.array([-np.sin(heading(here)), np.cos(heading(here))])
        assert abs(step @ side) < 1e-9
    assert np.abs(speeds).max() <= CELL.base_speed_m_s + 1e-9
    assert np.abs(np.diff(speeds)).max() <= BaseConfig().acceleration_m_s2 * 0.02 + 1e-9
    assert np.abs(rates).max() <= BaseConfig().turn_speed_rad_s + 1e-9
    assert np.all((np.abs(speeds) < 1e-12) | (np.abs(rates) < 1e-12))


def test_a_goal_behind_is_reached_backwards():
    robot = base()
    robot.goal(planar(-2.0, 0.0, 0.0))
    robot.step(1.0)
    assert robot.speed < 0.0
    assert robot.turn_rate == 0.0


def test_stopping_errors_fill_their_bounds_and_repeat_with_the_seed():
    robot, again = base(7), base(7)
    distances, turns = [], []
    for stop in range(300):
        for one in (robot, again):
            one.goal(planar(1.0 + stop % 2, 0.0, 0.0))
            one.step(1e9 + stop * 100.0)
        np.testing.assert_array_equal(robot.true, again.true)
        distance, turn = difference(robot.believed, robot.true)
        distances.append(distance)
        turns.append(turn)
    assert max(distances) <= CELL.base_error_m
    assert max(turns) <= CELL.base_error_rad + 1e-9
    # Uniform over a disc: half of the stops are outside radius / sqrt(2).
    assert 0.4 < np.mean(np.array(distances) > CELL.base_error_m / np.sqrt(2)) < 0.6
    assert max(turns) > 0.9 * CELL.base_error_rad
    assert not np.allclose(base(8).true, base(7).true)


def test_the_true_pose_does_not_jump():
    robot = base()
    robot.goal(planar(1.0, 0.5, 0.3))
    before = robot.true
    for now in np.arange(0.0, robot.remaining_s + 0.1, 0.02):
        robot.step(now)
        assert difference(before, robot.true)[0] < 0.03
        before = robot.true


def test_where_it_stands_already_nothing_happens():
    robot = base()
    before = robot.true
    robot.goal(START)
    assert not robot.moving
    np.testing.assert_array_equal(robot.true, before)


def test_cancel_brakes_to_rest_without_a_jump():
    robot = base()
    robot.goal(planar(4.0, 0.0, 0.0))
    robot.step(2.5)
    speed, place = robot.speed, robot.believed[0, 3]
    robot.cancel()
    assert robot.speed == pytest.approx(speed)
    robot.step(60.0)
    assert robot.speed == 0.0
    assert robot.believed[0, 3] == pytest.approx(place + speed**2 / (2 * 0.5))
    assert robot.believed[0, 3] < 3.0
    robot.cancel()
    assert not robot.moving


def test_an_exact_base_is_where_it_believes():
    robot = base(cell=replace(CELL, base_error_m=0.0, base_error_rad=0.0))
    robot.goal(planar(1.0, 1.0, 1.0))
    robot.step(100.0)
    np.testing.assert_allclose(robot.true, planar(1.0, 1.0, 1.0), atol=1e-12)


def test_time_does_not_run_backwards():
    robot = base()
    robot.goal(planar(2.0, 0.0, 0.0))
    robot.step(3.0)
    here = robot.believed
    robot.step(1.0)
    np.testing.assert_array_equal(robot.believed, here)
    with pytest.raises(InputError, match="finite"):
        robot.step(np.nan)


@pytest.mark.parametrize(
    ("goal", "word"),
    [
        (np.full((4, 4), np.nan), "finite"),
        (np.eye(3), "shape"),
        (2.0 * np.eye(4), "orthonormal"),
        (transform((1.0, 0.0, 0.2)), "floor"),
        (transform((1.0, 0.0, 0.0), [[1, 0, 0], [0, 0, -1], [0, 1, 0]]), "floor"),
        (planar(60.0, 0.0, 0.0), "50"),
    ],
)
def test_goals_that_no_base_can_reach_are_refused(goal, word):
    robot = base()
    with pytest.raises(InputError, match=word):
        robot.goal(goal)
    assert not robot.moving
