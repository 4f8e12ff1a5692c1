"""The mock base: closed forms of motion, stopping errors in their bounds, refusals."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

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


commands = st.lists(
    st.tuples(st.floats(0.1, 4.0), st.sampled_from(["goal", "cancel", "stop", "jump"])),
    max_size=5,
)


def obey(robot, command, number):
    if command == "goal":
        robot.goal(planar(1.0 - 2.0 * (number % 2), 0.7 * number, 0.5 * number))
    elif command == "jump":
        robot.jump(0.1)
    else:
        getattr(robot, command)()


@settings(max_examples=12, deadline=None)
@given(commands, st.floats(0.05, 0.6), st.integers(0, 3))
# Two orders lie between two ticks.
@example([(3.0, "goal"), (0.5, "goal")], 0.5, 0)
def test_limits_hold_and_any_ticks_give_the_same_states(orders, tick, seed):
    config = BaseConfig(jump_probability=0.5)
    coarse, fine = MockBase(config, CELL, seed, START), MockBase(config, CELL, seed, START)
    coarse.goal(planar(3.0, 1.0, 1.0))
    fine.goal(planar(3.0, 1.0, 1.0))
    now, speeds, rates, wheels, times = 0.0, [0.0], [0.0], [fine.odometry], [0.0]
    # So long as the next order is not due, `fine` goes in small steps, `coarse` in one.
    for number, (wait, command) in enumerate([*orders, (40.0, "stop")]):
        grid = np.arange(now, now + wait, tick)[1:]
        for step in grid:
            fine.step(step)
            speeds.append(fine.speed)
            rates.append(fine.turn_rate)
            wheels.append(fine.odometry)
        now += wait
        times += [*grid, now]
        coarse.step(now)
        fine.step(now)
        wheels.append(fine.odometry)
        np.testing.assert_allclose(fine.believed, coarse.believed, atol=1e-9)
        np.testing.assert_allclose(fine.true, coarse.true, atol=1e-9)
        np.testing.assert_allclose(fine.odometry, coarse.odometry, atol=1e-9)
        assert fine.speed == pytest.approx(coarse.speed, abs=1e-9)
        obey(coarse, command, number)
        obey(fine, command, number)
    assert np.abs(speeds).max() <= CELL.base_speed_m_s + 1e-9
    assert np.abs(rates).max() <= config.turn_speed_rad_s + 1e-9
    assert np.all((np.abs(speeds) < 1e-12) | (np.abs(rates) < 1e-12))
    ways = np.array([difference(a, b)[0] for a, b in itertools.pairwise(wheels)])
    assert (ways - np.diff(times) * CELL.base_speed_m_s).max() <= 1e-9


@settings(max_examples=20, deadline=None)
@given(st.floats(0.0, 6.0))
def test_a_stop_brings_standstill_within_speed_over_deceleration(after):
    config = BaseConfig()
    robot = base()
    robot.goal(planar(3.0, 1.0, 1.0))
    robot.step(after)
    speed, rate = abs(robot.speed), abs(robot.turn_rate)
    robot.stop()
    longest = max(
        speed / config.stop_deceleration_m_s2, rate / config.stop_turn_deceleration_rad_s2
    )
    assert robot.remaining_s <= longest + 1e-9
    before = robot.believed
    robot.step(after + longest + 1e-9)
    assert not robot.moving and robot.speed == robot.turn_rate == 0.0
    assert difference(before, robot.believed)[0] <= speed * longest / 2 + 1e-9
    stood = robot.true
    robot.step(after + 100.0)
    np.testing.assert_array_equal(robot.true, stood)


def test_a_new_goal_while_driving_changes_no_speed_at_once():
    robot = base()
    robot.goal(planar(6.0, 0.0, 0.0))
    robot.step(3.0)
    speed = robot.speed
    robot.goal(planar(0.0, 2.0, 0.0))
    assert robot.speed == pytest.approx(speed)
    speeds = []
    for now in np.arange(3.0, 3.0 + robot.remaining_s, 0.02):
        robot.step(now)
        speeds.append(robot.speed)
    assert np.abs(np.diff(speeds)).max() <= BaseConfig().acceleration_m_s2 * 0.02 + 1e-9
    robot.step(100.0)
    np.testing.assert_allclose(robot.believed, planar(0.0, 2.0, 0.0), atol=1e-9)


def test_a_jump_of_the_localisation_moves_neither_base_nor_odometry():
    for drive in (False, True):
        robot = base()
        if drive:
            robot.goal(planar(4.0, 0.0, 0.0))
            robot.step(2.5)
        true, wheels, believed = robot.true, robot.odometry, robot.believed
        robot.jump(0.08)
        np.testing.assert_allclose(robot.true, true, atol=1e-12)
        np.testing.assert_allclose(robot.odometry, wheels, atol=1e-12)
        assert difference(believed, robot.believed)[0] == pytest.approx(0.08)
        assert robot.moving == drive
        robot.step(60.0)
        if drive:
            np.testing.assert_allclose(robot.believed, planar(4.0, 0.0, 0.0), atol=1e-9)
            assert difference(robot.true, robot.believed)[0] <= CELL.base_error_m


def test_jumps_happen_in_their_share_of_the_drives():
    robot = MockBase(BaseConfig(jump_probability=0.3), CELL, 1, START)
    jumps, now = 0, 0.0
    for drive in range(200):
        before = robot.T_map_odom
        robot.goal(planar(float(drive % 2), 0.0, 0.0))
        now += 60.0
        robot.step(now)
        moved = difference(before, robot.T_map_odom)[0]
        jumps += moved > 0.0
        assert not robot.moving
    assert 0.2 < jumps / 200 < 0.4


def test_the_speed_of_the_cell_counts_up_to_that_of_the_base():
    robot = base(cell=replace(CELL, base_speed_m_s=3.0))
    robot.goal(planar(20.0, 0.0, 0.0))
    speeds = []
    for now in np.arange(0.0, robot.remaining_s, 0.1):
        robot.step(now)
        speeds.append(robot.speed)
    assert max(speeds) == pytest.approx(1.5)
