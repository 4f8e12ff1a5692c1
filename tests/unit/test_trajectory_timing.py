import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from skinplan.robot.arm import ArmModel
from skinplan.robot.cell import CellConfig
from skinplan.trajectory import timing
from skinplan.trajectory.sampling import line_use, tcp_speeds
from skinplan.trajectory.timing import (
    DWELL_S,
    SAMPLE_M,
    SAMPLE_S,
    SPLINE_M,
    Limits,
    rest,
    tcp_length,
    time_line,
    time_path,
)

CELL = CellConfig()
ARM = ArmModel.load(CELL)
SCAN = Limits(ARM.velocity, 5.0, 0.2)
FREE = Limits(ARM.velocity, 5.0, np.inf)
HOME = np.array(CELL.home_rad)


def check(timed, limits):
    step = np.diff(timed.times)[:, None]
    assert timed.times[0] == 0.0 and np.all(step > 0) and step.max() <= 1.2 * SAMPLE_S
    assert np.all(np.abs(timed.velocities) <= limits.velocity + 1e-9)
    assert np.abs(np.diff(timed.velocities, axis=0) / step).max() <= limits.acceleration * (
        1 + 1e-6
    )
    assert np.abs(timed.velocities[[0, -1]]).max() < 1e-9
    middle = 0.5 * (timed.velocities[1:] + timed.velocities[:-1]) * step
    assert (
        np.abs(np.diff(timed.positions, axis=0) - middle).max()
        < 0.25 * limits.acceleration * SAMPLE_S**2
    )
    places = ARM.forward_scanner(timed.positions)[:, :3, 3]
    assert np.all(
        np.linalg.norm(np.diff(places, axis=0), axis=1) <= limits.tcp_speed * step[:, 0] * 1.001
    )


@pytest.mark.parametrize("size", [0.01, 0.5, 3.0])
def test_a_line_takes_the_time_of_the_trapezoid(size):
    change = size * np.array([1.0, -0.5, 0.2, 0.0, 0.1, 0.0])
    timed = time_line(HOME, HOME + change, FREE)
    check(timed, FREE)
    v, a = 0.98 * np.pi, 0.98 * 5.0
    expected = 2 * np.sqrt(size / a) if size < v * v / a else size / v + v / a
    assert timed.times[-1] == pytest.approx(expected, rel=1e-6)
    assert np.allclose(timed.positions[0], HOME) and np.allclose(timed.positions[-1], HOME + change)
    # Straight: all joints move in proportion.
    share = (timed.positions - HOME)[:, 0] / change[0]
    assert np.allclose(timed.positions, HOME + share[:, None] * change)


@pytest.mark.parametrize("seed", range(6))
def test_a_random_path_keeps_all_limits_and_passes_all_knots(seed):
    rng = np.random.default_rng(seed)
    q = HOME + np.cumsum(rng.normal(size=(40, 6)) * 0.05, axis=0)
    for limits in (SCAN, FREE):
        timed = time_path(ARM, q, limits)
        check(timed, limits)
        assert np.allclose(timed.positions[0], q[0]) and np.allclose(timed.positions[-1], q[-1])
        assert timed.path[0] == 0.0 and timed.path[-1] == pytest.approx(39.0)
        assert np.all(np.diff(timed.path) >= -1e-9)
        for number in range(1, 39):
            row = np.array([np.interp(number, timed.path, timed.positions[:, j]) for j in range(6)])
            assert np.abs(row - q[number]).max() < 0.02


def test_the_scanner_runs_at_its_limit_on_a_long_easy_way():
    q = HOME + np.linspace(0, 1, 60)[:, None] * np.array([0.8, 0, 0, 0, 0, 0])
    timed = time_path(ARM, q, SCAN)
    places = ARM.forward_scanner(timed.positions)[:, :3, 3]
    speed = np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(timed.times)
    middle = speed[len(speed) // 4 : -len(speed) // 4]
    assert np.all(middle > 0.9 * 0.2)
    length = np.linalg.norm(np.diff(places, axis=0), axis=1).sum()
    assert timed.times[-1] < 1.15 * length / 0.2


def test_two_positions_and_sharp_reversal():
    check(time_path(ARM, np.stack([HOME, HOME + 0.1]), SCAN), SCAN)
    there = HOME + np.linspace(0, 1, 10)[:, None] * np.array([0.3, 0, 0.2, 0, 0, 0])
    check(time_path(ARM, np.vstack([there, there[-2::-1]]), SCAN), SCAN)


def test_where_topp_ra_gives_up_the_path_is_driven_slowly(monkeypatch):
    class Hopeless(timing.TOPPRA):
        def compute_parameterization(self, *args, **kwargs):
            self.problem_data.sd_vec = None

    monkeypatch.setattr(timing, "TOPPRA", Hopeless)
    q = HOME + np.cumsum(np.random.default_rng(0).normal(size=(20, 6)) * 0.05, axis=0)
    timed = time_path(ARM, q, SCAN)
    check(timed, SCAN)
    assert np.allclose(timed.positions[-1], q[-1])


def test_rest_stays():
    timed = rest(HOME)
    assert timed.times.tolist() == [0.0, DWELL_S] and np.all(timed.positions == HOME)
    assert not timed.velocities.any()


def scanner(q):
    return ARM.forward_scanner(np.atleast_2d(q))[:, :3, 3]


def corners(seed, count=12, size=0.35):
    """A path of long, sharply turning joint motions."""
    rng = np.random.default_rng(seed)
    return HOME + np.cumsum(rng.uniform(-size, size, (count, 6)), axis=0)


def off_the_chords(places, q):
    """Distance of places from the nearest of the straight ways between joint positions."""
    ends = scanner(q)
    way = np.diff(ends, axis=0)
    share = np.einsum("pki,ki->pk", places[:, None] - ends[:-1], way)
    share = np.clip(share / np.maximum(np.einsum("ki,ki->k", way, way), 1e-18), 0.0, 1.0)
    nearest = ends[:-1] + share[:, :, None] * way
    return np.linalg.norm(places[:, None] - nearest, axis=2).min(axis=1)


def along(q, path):
    """Joint positions on straight joint motion at steps and shares of them."""
    step = np.minimum(path.astype(int), len(q) - 2)
    return q[step] + (path - step)[:, None] * (q[step + 1] - q[step])


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("limits", [SCAN, FREE], ids=["scan", "free"])
def test_the_motion_stays_near_straight_joint_motion(seed, limits):
    """The spline is held by added positions: the scanner keeps to the given motion's line."""
    q = corners(seed)
    timed = time_path(ARM, q, limits)
    check_limits(timed, limits)
    dense = np.vstack([along(q, np.linspace(i, i + 1, 200)) for i in range(len(q) - 1)])
    # The bound holds between the knots; chords between knots are off the curve of straight joint
    # motion by their sagitta, which shrinks with the knots: both together below twice the bound.
    assert off_the_chords(scanner(timed.positions), dense).max() <= 2.0 * SPLINE_M
    assert off_the_chords(scanner(q), dense).max() < 1e-9


@pytest.mark.parametrize("seed", range(6))
def test_densely_given_positions_are_kept_to_within_the_splines_bound(seed):
    """Positions a centimetre apart on a zigzag: chords are the motion asked for."""
    q = corners(seed, 6)
    q = np.vstack([along(q, np.linspace(i, i + 1, 41)[:-1]) for i in range(len(q) - 1)])
    timed = time_path(ARM, q, SCAN)
    assert off_the_chords(scanner(timed.positions), q).max() <= SPLINE_M + SAMPLE_M


def check_limits(timed, limits):
    step = np.diff(timed.times)[:, None]
    assert timed.times[0] == 0.0 and np.all(step > 0)
    mean = np.diff(timed.positions, axis=0) / step
    assert np.all(np.abs(timed.velocities) <= limits.velocity + 1e-9)
    assert np.all(np.abs(mean) <= limits.velocity + 1e-9)
    rate = np.diff(timed.velocities, axis=0) / step
    assert np.abs(rate).max() <= limits.acceleration * (1 + 1e-6)
    assert np.abs(timed.velocities[[0, -1]]).max() < 1e-9
    places = scanner(timed.positions)
    way = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert np.all(way <= limits.tcp_speed * step[:, 0] * (1 + 1e-9))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("limits", [SCAN, FREE], ids=["scan", "free"])
def test_lines_between_samples_stay_near_the_motion(seed, limits, monkeypatch):
    """Against the same motion sampled forty times as densely; both may be slowed as a whole."""
    coarse = time_path(ARM, corners(seed), limits)
    monkeypatch.setattr(timing, "SAMPLE_S", 0.001)
    fine = time_path(ARM, corners(seed), limits)
    when = fine.times / fine.times[-1] * coarse.times[-1]
    lines = np.stack([np.interp(when, coarse.times, c) for c in coarse.positions.T], axis=1)
    off = np.linalg.norm(scanner(lines) - scanner(fine.positions), axis=1)
    middle = np.interp(0.5 * (coarse.times[1:] + coarse.times[:-1]), when, off)
    assert middle.max() <= SAMPLE_M * 1.001
    # The bound is kept in the middle of a step; where the pace changes the most is beside it.
    assert off.max() <= 1.05 * SAMPLE_M
    assert len(coarse.times) < 0.3 * len(fine.times)


@pytest.mark.parametrize("seed", range(6))
def test_the_scanner_keeps_its_limit_along_the_lines_between_samples(seed):
    timed = time_path(ARM, corners(seed), SCAN)
    assert line_use(ARM, timed.times, timed.positions, SCAN.tcp_speed).max() <= 1.0 + 1e-9
    # By means of its own: places a hundredth of a step apart.
    share = np.linspace(0.0, 1.0, 101)
    for a, b, step in zip(timed.positions, timed.positions[1:], np.diff(timed.times), strict=False):
        places = scanner(a + share[:, None] * (b - a))
        speed = np.linalg.norm(np.diff(places, axis=0), axis=1).max() / (step / 100)
        assert speed <= SCAN.tcp_speed * 1.001


@pytest.mark.parametrize(("seed", "size"), [(8, 0.35), (12, 1.0), (26, 0.1), (0, 0.35)])
def test_the_scanner_keeps_its_limit_along_the_cubics_between_samples(seed, size):
    timed = time_path(ARM, corners(seed, size=size), SCAN)
    # By means of its own: places of the cubics, a fiftieth of a step apart.
    cubic = CubicHermiteSpline(timed.times, timed.positions, timed.velocities)
    ends = zip(timed.times, timed.times[1:], strict=False)
    times = np.concatenate([np.linspace(a, b, 51) for a, b in ends])
    way = np.linalg.norm(np.diff(scanner(cubic(times)), axis=0), axis=1)
    step = np.diff(times)
    speed = way[step > 0] / step[step > 0]
    assert speed.max() <= SCAN.tcp_speed * 1.005


@pytest.mark.parametrize("seed", range(6))
def test_the_path_says_when_the_given_positions_are_passed_though_more_were_added(seed):
    q = corners(seed)
    timed = time_path(ARM, q, SCAN)
    assert timed.path[0] == 0.0 and timed.path[-1] == pytest.approx(len(q) - 1)
    assert np.all(np.diff(timed.path) >= -1e-12)
    when = np.interp(np.arange(len(q)), timed.path, timed.times)
    assert np.all(np.diff(when) > 0.0)
    there = np.stack([np.interp(when, timed.times, column) for column in timed.positions.T], axis=1)
    # The motion passes each of them; samples around it are on lines that are near to it.
    assert np.linalg.norm(scanner(there) - scanner(q), axis=1).max() <= 2.0 * SAMPLE_M
    assert np.abs(there - q).max() < 0.01
    # A wrong map would be off by as much as half a step does.
    late = np.interp(np.arange(len(q) - 1) + 0.5, timed.path, timed.times)
    between = np.stack([np.interp(late, timed.times, c) for c in timed.positions.T], axis=1)
    assert np.linalg.norm(scanner(between) - scanner(q[:-1]), axis=1).max() > 0.01


@pytest.mark.parametrize("seed", range(6))
def test_positions_are_added_on_the_given_steps_only_and_the_given_ones_are_kept(seed):
    q = corners(seed)
    knots, given = timing._graded(ARM, q)
    assert len(knots) > len(q) and np.array_equal(knots[given], q)
    assert given[0] == 0 and given[-1] == len(knots) - 1 and np.all(np.diff(given) >= 1)
    for number, (first, last) in enumerate(zip(given, given[1:], strict=False)):
        way = q[number + 1] - q[number]
        gone = knots[first : last + 1] - q[number]
        share = gone @ way / (way @ way)
        assert np.abs(gone - share[:, None] * way).max() < 1e-12 and np.all(np.diff(share) > 0)


def test_nothing_is_added_where_the_spline_is_straight_anyway():
    q = HOME + np.linspace(0, 1, 60)[:, None] * np.array([0.8, 0, 0, 0, 0, 0])
    knots, given = timing._graded(ARM, q)
    assert np.array_equal(knots, q) and np.array_equal(given, np.arange(60))


@pytest.mark.parametrize("seed", range(3))
def test_speeds_of_the_scanner_equal_finite_differences(seed):
    rng = np.random.default_rng(seed)
    q, v = rng.uniform(-2, 2, (20, 6)), rng.uniform(-2, 2, (20, 6))
    h = 1e-6
    expected = np.linalg.norm(scanner(q + h * v) - scanner(q - h * v), axis=1) / (2 * h)
    assert tcp_speeds(ARM, q, v) == pytest.approx(expected, rel=1e-6)


def test_without_a_limit_of_the_scanner_lines_use_none_of_it():
    q = corners(0)
    assert not line_use(ARM, np.arange(len(q), dtype=float), q, np.inf).any()


def test_the_scanners_way_about_the_first_axis_is_an_arc():
    radius = np.linalg.norm(scanner(HOME)[0, :2])
    q = HOME + np.linspace(0, 1, 2000)[:, None] * np.array([1.2, 0, 0, 0, 0, 0])
    assert tcp_length(ARM, q) == pytest.approx(1.2 * radius, rel=1e-5)
