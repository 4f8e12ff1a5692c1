import numpy as np
import pytest

from skinplan.robot.arm import ArmModel
from skinplan.robot.cell import CellConfig
from skinplan.trajectory import timing
from skinplan.trajectory.timing import DWELL_S, SAMPLE_S, Limits, rest, time_line, time_path

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
