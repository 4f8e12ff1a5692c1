"""The mock arm in motion: limits, stops, speed scaling, tolerances; any ticks, the same states."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skinplan.errors import InputError, JointsInvalidError
from skinplan.mock.arm import Ending, MockArm, Tolerances
from skinplan.mock.pace import Pace
from skinplan.robot.arm import ArmModel
from skinplan.robot.cell import CellConfig

NAMES = ("pan", "lift", "elbow")
HOME = np.array([0.0, -1.0, 1.0])
V_MAX, A_MAX = 2.0, 5.0


def arm(**settings):
    return MockArm(NAMES, [-3.0] * 3, [3.0] * 3, V_MAX, HOME, **settings)


def smooth(duration=4.0, way=1.5, points=9):
    """A cubic spline's points with velocities: rest to rest, at most 1.5 way / duration."""
    times = np.linspace(0.0, duration, points)
    share = times / duration
    shape = np.array([1.0, -0.5, 0.25])
    where = HOME + np.outer(way * (3 * share**2 - 2 * share**3), shape)
    speed = np.outer(way * (6 * share - 6 * share**2) / duration, shape)
    return times, where, speed


def start(robot, **changes):
    times, where, speed = smooth()
    robot.accept(NAMES, times, where, 1.0, speed, **changes)
    return robot


def test_points_with_velocities_are_joined_by_cubics():
    robot = start(arm())
    times = np.linspace(1.0, 5.0, 300)
    share = (times - 1.0) / 4.0
    wanted = HOME[0] + 1.5 * (3 * share**2 - 2 * share**3)
    where, speed = robot.states(times)
    np.testing.assert_allclose(where[:, 0], wanted, atol=1e-12)
    np.testing.assert_allclose(np.gradient(where[:, 0], times)[2:-2], speed[2:-2, 0], atol=1e-3)


def test_a_cubic_that_is_too_fast_between_points_is_refused():
    robot = arm()
    with pytest.raises(JointsInvalidError, match="rad/s"):
        robot.accept(NAMES, [0.0, 1.0], [HOME, HOME + 1.5], 0.0, np.zeros((2, 3)))
    robot.accept(NAMES, [0.0, 1.0], [HOME, HOME + 1.3], 0.0, np.zeros((2, 3)))
    with pytest.raises(InputError, match="velocities"):
        robot.accept(NAMES, [0.0, 1.0], [HOME, HOME], 9.0, np.zeros((1, 3)))


commands = st.lists(
    st.tuples(
        st.floats(0.05, 2.0), st.sampled_from(["slow", "fast", "half", "stop", "stick", "go"])
    ),
    max_size=6,
)


def obey(robot, command, now):
    times, where, speed = smooth()
    if command == "stop":
        robot.stop(now)
    elif command == "stick":
        robot.stick(now)
    elif command == "go":
        robot.release()
        if robot.done(now):
            here = robot.state(now)[0]
            back = np.array([here, 0.5 * (here + HOME), HOME])
            robot.accept(NAMES, [0.0, 2.0, 4.0], back, now)
    else:
        robot.set_speed({"slow": 0.1, "half": 0.5, "fast": 1.0}[command], now)


@settings(max_examples=25, deadline=None)
@given(commands, st.floats(0.01, 0.5))
def test_limits_hold_and_any_ticks_give_the_same_states(orders, tick):
    coarse, fine = start(arm(repeatability_rad=1e-4)), start(arm(repeatability_rad=1e-4))
    now = 1.0
    for wait, command in orders:
        for step in np.arange(now, now + wait, tick):
            fine.state(step)
            fine.ending(step)
        now += wait
        obey(coarse, command, now)
        obey(fine, command, now)
    grid = np.arange(1.0, now + 12.0, 0.01)
    where, speed = coarse.states(grid)
    again, same = np.array([fine.state(float(t)) for t in grid]).swapaxes(0, 1)
    np.testing.assert_array_equal(where, again)
    np.testing.assert_array_equal(speed, same)
    assert np.abs(speed).max() <= V_MAX + 1e-9
    assert np.abs(where).max() <= 3.0 + 1e-9
    # No jump of the place: every step is what the speed allows.
    assert np.abs(np.diff(where, axis=0)).max() <= V_MAX * 0.01 + 1e-9


@settings(max_examples=20, deadline=None)
@given(st.floats(0.0, 4.5), st.sampled_from([1.0, 0.5]))
def test_a_stop_brings_standstill_within_speed_over_deceleration(after, rate):
    robot = arm()
    robot.set_speed(rate, 0.0)
    start(robot)
    now = 1.0 + after
    speed = np.abs(robot.state(now)[1]).max()
    robot.stop(now)
    # Ahead the path may ask for more than now: a stop is planned for the fastest piece ahead.
    longest = V_MAX / A_MAX
    rest, still = robot.states(np.linspace(now + longest, now + 20.0, 50))
    assert np.all(still == 0.0) and np.all(rest == rest[0])
    assert robot.done(now + longest)
    braking = np.linspace(now, now + longest, 200)
    speeds = robot.states(braking)[1]
    change = np.abs(np.diff(speeds, axis=0)) / np.diff(braking)[:, None]
    # Braking, and the path's own acceleration of at most 6 way / duration^2.
    assert change.max() <= A_MAX + 6.0 * 1.5 / 4.0**2 + 1e-6
    assert np.abs(speeds).max() <= max(speed, 1e-12) * 1.2 + 0.05


def test_speed_scaling_stretches_time_and_can_pause():
    robot = start(arm())
    robot.set_speed(0.0, 2.0)
    paused = robot.state(3.0)[0]
    np.testing.assert_array_equal(robot.state(50.0)[0], paused)
    assert not robot.done(50.0) and robot.remaining_s(50.0) == np.inf
    assert robot.ending(50.0) is None, "its time stands, too"
    robot.set_speed(0.5, 50.0)
    assert 50.0 + 2.0 * 2.5 < 50.0 + robot.remaining_s(50.0) < 50.0 + 2.0 * 3.2
    end = 50.0 + robot.remaining_s(50.0)
    np.testing.assert_allclose(robot.state(end)[0], smooth()[1][-1], atol=1e-9)
    with pytest.raises(InputError, match="0 to 1"):
        robot.set_speed(1.5, 60.0)


def test_an_arm_that_sticks_violates_its_path_and_then_its_goal():
    robot = start(arm())
    robot.stick(2.0)
    times = np.arange(2.0, 9.0, 0.01)
    first = next(t for t in times if robot.ending(t) is not None)
    kind, text = robot.ending(first)
    assert kind is Ending.PATH_VIOLATED and "pan is 0.20" in text
    stood = robot.state(2.5)[0]
    np.testing.assert_array_equal(robot.state(first)[0], stood)
    robot.stop(first)
    assert robot.done(first)
    np.testing.assert_array_equal(robot.state(30.0)[0], stood)
    wide = Tolerances.same(3, path=np.inf, goal=0.1, goal_time_s=1.0)
    robot = start(arm(), tolerances=wide)
    robot.stick(2.0)
    assert robot.ending(5.5) is None, "within the goal's time"
    assert robot.ending(6.01)[0] is Ending.GOAL_VIOLATED


def test_velocity_tolerances_count():
    none = np.full(3, np.inf)
    tight = Tolerances(none, np.full(3, 0.05), none, none, 1.0)
    robot = start(arm(), tolerances=tight)
    robot.stick(2.0)
    kind, text = robot.ending(2.2)
    assert kind is Ending.PATH_VIOLATED and "rad/s" in text


def test_a_way_that_sticks_at_once_is_followed_again_after_release():
    robot = arm()
    robot.stick(0.5)
    start(robot)
    np.testing.assert_array_equal(robot.state(2.0)[0], HOME)
    robot.release()
    robot.stop(3.0)
    times, where, speed = smooth()
    robot.accept(NAMES, times, where, 4.0, speed)
    np.testing.assert_allclose(robot.state(9.0)[0], where[-1])


def test_it_comes_back_to_the_same_place_within_its_repeatability():
    """ISO 9283: the TCP comes to within 0.03 mm of where it was sent, always a little elsewhere."""
    cell = CellConfig()
    model = ArmModel.load(cell)
    share = 3e-5 / 6 / np.maximum(model.lever_arms(), 0.05)
    home = np.array(cell.home_rad)
    robot = MockArm(
        model.joint_names, model.lower, model.upper, model.velocity, home, repeatability_rad=share
    )
    wanted = model.forward_scanner(home[None])[0, :3, 3]
    places, now = [], 0.0
    for _ in range(40):
        here = robot.state(now)[0]
        robot.accept(model.joint_names, [0.0, 1.0, 2.0], [here, home + 0.3, home], now)
        now += 3.0
        places.append(model.forward_scanner(robot.state(now)[0][None])[0, :3, 3] - wanted)
    away = np.linalg.norm(places, axis=1)
    assert away.max() <= 3e-5
    assert away.std() > 1e-6


@given(
    st.lists(st.tuples(st.floats(0.01, 3.0), st.floats(0.0, 1.0), st.floats(0.0, 2.0)), max_size=5),
    st.floats(0.1, 5.0),
)
def test_pace_reaches_what_it_says(changes, wanted):
    pace, now = Pace(0.0, 1.0), 0.0
    for wait, rate, ramp in changes:
        now += wait
        pace.change(now, rate, ramp)
    progress = pace.at(now)[0]
    when = pace.reaches(progress + wanted)
    if np.isfinite(when):
        assert pace.at(when)[0] == pytest.approx(progress + wanted, rel=1e-6, abs=1e-6)
    times = np.linspace(0.0, now + 5.0, 400)
    found, rates = pace.many(times)
    assert np.all(np.diff(found) >= -1e-12), "it never goes back"
    assert rates.min() >= 0.0 and rates.max() <= 1.0
