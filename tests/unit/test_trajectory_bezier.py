import time

import numpy as np
import pytest

from skinplan.errors import InputError, JointsInvalidError
from skinplan.robot.arm import ArmModel
from skinplan.robot.cell import CellConfig
from skinplan.trajectory.bezier import bezier_curve, largest_jerk, time_bezier
from skinplan.trajectory.pacing import Course
from skinplan.trajectory.timing import Limits, time_path

CELL = CellConfig()
ARM = ArmModel.load(CELL)
SCAN = Limits(ARM.velocity, 5.0, 0.2)
FREE = Limits(ARM.velocity, 5.0, np.inf)
HOME = np.array(CELL.home_rad)
LIMITS = pytest.mark.parametrize("limits", [SCAN, FREE], ids=["scan", "free"])


def smooth(count=60, size=0.6):
    """A way of joints that swing with different phases."""
    turn = np.linspace(0.0, 2.0 * np.pi, count)[:, None]
    return HOME + size * np.sin(turn * [1.0, 0.5, 0.7, 1.3, 0.4, 0.9] + [0, 1, 2, 3, 4, 5])


def shaky(seed, count=40):
    rng = np.random.default_rng(seed)
    return HOME + np.cumsum(rng.normal(size=(count, 6)) * 0.05, axis=0)


def cornered():
    """Straight legs that meet at right angles, with a step of a tenth beside a corner."""
    side = np.eye(6)[[0, 1, 0, 3]] * [[1], [1], [-1], [1]]
    legs = [0.03 * np.arange(1, 11)[:, None] * side[0]]
    for direction in side[1:]:
        lengths = np.concatenate([[0.003], 0.03 * np.arange(1, 11)])
        legs.append(legs[-1][-1] + lengths[:, None] * direction)
    return HOME + np.vstack([np.zeros((1, 6)), *legs])


def reversing():
    there = HOME + np.linspace(0, 1, 10)[:, None] * np.array([0.3, 0, 0.2, 0, 0, 0])
    return np.vstack([there, there[-2::-1]])


WAYS = {
    "smooth": smooth(),
    "shaky": shaky(0),
    "cornered": cornered(),
    "reversing": reversing(),
    "one joint": HOME + np.linspace(0, 1, 30)[:, None] * np.eye(6)[4],
    "one step": np.stack([HOME, HOME + [1.0, -0.5, 0.2, 0.0, 0.1, 0.0]]),
    "tiny steps": HOME + 1e-6 * np.arange(200)[:, None] * np.array([1, 0.5, 0, 0, -1, 0]),
    "tiny among large": HOME
    + np.array([0, 0.1, 0.1 + 1e-7, 0.2, 0.2 + 1e-6, 0.2 + 2e-6, 0.5])[:, None] * np.ones(6),
}
EACH_WAY = pytest.mark.parametrize("q", WAYS.values(), ids=WAYS.keys())


def polynomials(curve):
    """Each segment's control points as eq (2), evaluated by plain products of the angles."""

    def at(segment, u, angles=curve.control_angles):
        weights = [1, 5, 10, 10, 5, 1] * (1 - u) ** np.arange(5, -1, -1) * u ** np.arange(6)
        return weights @ angles[segment]

    return at


def scanner_speeds(times, q):
    places = ARM.forward_scanner(q)[:, :3, 3]
    return np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(times)


def distance_from_polyline(points, corners):
    """Distance of points from the nearest segment of a polyline, shape (n,)."""
    start, way = corners[:-1], np.diff(corners, axis=0)
    gap = points[:, None] - start
    share = np.einsum("nkj,kj->nk", gap, way) / (way**2).sum(axis=1)
    gap -= np.clip(share, 0.0, 1.0)[:, :, None] * way
    return np.linalg.norm(gap, axis=2).min(axis=1)


@EACH_WAY
@LIMITS
def test_position_velocity_and_acceleration_are_continuous_at_the_joins(q, limits):
    curve = bezier_curve(ARM, q, limits)
    segments = np.arange(len(curve.durations) - 1)
    for order, size in ((0, 1.0), (1, np.pi), (2, 5.0)):
        before = curve.inside(segments, np.ones(len(segments)), order)
        behind = curve.inside(segments + 1, np.zeros(len(segments)), order)
        assert np.abs(behind - before).max(initial=0.0) < 1e-9 * size


def test_the_curve_is_that_of_eq_2():
    curve = bezier_curve(ARM, smooth(), SCAN)
    plain = polynomials(curve)
    for segment in range(0, len(curve.durations), 7):
        for u in (0.0, 0.13, 0.5, 0.9, 1.0):
            t = curve.times[segment] + u * curve.durations[segment]
            assert np.allclose(curve.at(np.array([t]))[0], plain(segment, u), atol=1e-12)
            # Derivatives by time, against differences of the plain curve.
            small = 1e-3
            if 0.1 < u < 0.95:
                low, here, high = (plain(segment, u + k * small) for k in (-1, 0, 1))
                dt = small * curve.durations[segment]
                rate = (high - low) / (2 * dt)
                assert np.allclose(curve.at(np.array([t]), 1)[0], rate, atol=2e-5)
                bend = (high - 2 * here + low) / dt**2
                assert np.allclose(curve.at(np.array([t]), 2)[0], bend, atol=2e-3)


@EACH_WAY
def test_control_points_beside_a_join_are_on_one_line_with_it(q):
    """R6, in the plane of time and angle; and the second ones on one parabola."""
    curve = bezier_curve(ARM, q, SCAN)
    t, angle = curve.control_times, curve.control_angles
    assert np.array_equal(angle[:-1, 5], angle[1:, 0]) or np.allclose(
        angle[:-1, 5], angle[1:, 0], rtol=0, atol=1e-15
    )
    before = (angle[:-1, 5] - angle[:-1, 4]) * curve.durations[1:, None]
    behind = (angle[1:, 1] - angle[1:, 0]) * curve.durations[:-1, None]
    scale = np.abs(before).max() + 1e-12
    assert np.allclose(t[:-1, 5], t[1:, 0])
    assert np.abs(before - behind).max(initial=0.0) < 1e-9 * scale + 1e-15
    bend = np.diff(angle, 2, axis=1) / (curve.durations[:, None, None] / 5) ** 2
    noise = 1e-15 / (curve.durations.min() / 5) ** 2
    assert np.abs(bend[:-1, -1] - bend[1:, 0]).max(initial=0.0) < 1e-7 + 4 * noise


@EACH_WAY
@LIMITS
def test_limits_are_kept_everywhere(q, limits):
    curve = bezier_curve(ARM, q, limits)
    assert np.all(curve.largest(1) <= limits.velocity * (1 + 1e-9))
    assert curve.largest(2).max() <= limits.acceleration * (1 + 1e-9)
    fine = np.linspace(0.0, curve.times[-1], int(curve.times[-1] / 0.001) + 50)
    assert np.all(np.abs(curve.at(fine, 1)) <= limits.velocity * (1 + 1e-9))
    assert np.abs(curve.at(fine, 2)).max() <= limits.acceleration * (1 + 1e-9)
    assert scanner_speeds(fine, curve.at(fine)).max() <= limits.tcp_speed
    # And by differences of nothing but positions.
    rate = np.diff(curve.at(fine), axis=0) / np.diff(fine)[:, None]
    assert np.all(np.abs(rate) <= limits.velocity * (1 + 1e-6))
    assert np.abs(np.diff(rate, axis=0)).max() / (fine[1] - fine[0]) < limits.acceleration * 1.001


@EACH_WAY
@LIMITS
def test_one_limit_is_used_and_the_motion_is_not_slower_than_it_has_to_be(q, limits):
    curve = bezier_curve(ARM, q, limits)
    used = max((curve.largest(1) / limits.velocity).max(), curve.largest(2).max() / 5.0)
    fine = np.linspace(0.0, curve.times[-1], 20000)
    used = max(used, scanner_speeds(fine, curve.at(fine)).max() / limits.tcp_speed)
    assert 0.98 < used <= 1.0 + 1e-9
    if 1e-3 < np.abs(np.diff(q, axis=0)).max(axis=1).min():
        assert curve.times[-1] < 1.3 * time_path(ARM, q, limits).times[-1]


def test_a_long_even_row_is_hardly_slower_than_by_topp_ra():
    q = HOME + np.linspace(0, 2, 120)[:, None] * np.array([0.8, 0, 0, 0, 0, 0])
    assert bezier_curve(ARM, q, SCAN).times[-1] < 1.02 * time_path(ARM, q, SCAN).times[-1]


@EACH_WAY
def test_extrema_are_exact(q):
    curve = bezier_curve(ARM, q, FREE)
    shares = np.linspace(0.0, 1.0, 2001)
    for order in (1, 2, 3):
        largest = curve.largest(order)
        for segment in range(0, len(curve.durations), max(1, len(curve.durations) // 12)):
            dense = curve.inside(np.full(len(shares), segment), shares, order)
            found = np.abs(dense).max(axis=0)
            scale = np.abs(curve.control_values(order)[segment]).max()
            assert np.all(found <= largest[segment] + 1e-9 * scale)
            assert np.all(largest[segment] <= found + 1e-5 * scale)


@EACH_WAY
@LIMITS
def test_it_passes_all_positions_from_rest_to_rest(q, limits):
    timed = time_bezier(ARM, q, limits)
    assert timed.times[0] == 0.0 and np.all(np.diff(timed.times) > 0.0)
    assert timed.path[0] == 0.0 and timed.path[-1] == len(q) - 1
    assert np.all(np.diff(timed.path) > 0.0)
    passed = np.isin(timed.path, np.arange(len(q)))
    assert np.abs(timed.positions[passed] - q).max() < 1e-12
    assert not timed.velocities[[0, -1]].any()
    curve = bezier_curve(ARM, q, limits)
    assert not curve.accelerations[[0, -1]].any() and not curve.velocities[[0, -1]].any()
    # Where a sample says it is on the path, it is: not beyond the step's ends along the chord.
    step = np.minimum(timed.path.astype(int), len(q) - 2)
    way = np.diff(q, axis=0)[step]
    along = np.einsum("nj,nj->n", timed.positions - q[step], way) / (way**2).sum(axis=1)
    assert np.abs(along - (timed.path - step)).max() < 0.5


@EACH_WAY
@LIMITS
def test_it_stays_near_the_chords(q, limits):
    """The stated bound holds, and is small beside the steps."""
    curve = bezier_curve(ARM, q, limits)
    bound = curve.chord_deviation()
    shares = np.linspace(0.0, 1.0, 41)
    steps = np.linalg.norm(np.diff(q, axis=0), axis=1)
    for segment in range(len(bound)):
        dense = curve.inside(np.full(len(shares), segment), shares)
        ends = curve.positions[[segment, segment + 1]]
        assert distance_from_polyline(dense, ends).max() <= bound[segment] + 1e-12
    bends = np.abs(np.linalg.norm(curve.accelerations, axis=1))
    most = 0.15 * curve.durations**2 * np.maximum(bends[:-1], bends[1:])
    assert np.all(bound <= most + 1e-12)
    # Not even a reversal or a corner beside a tiny step makes it swing out.
    times = np.linspace(0, curve.times[-1], 4000)
    assert distance_from_polyline(curve.at(times), q).max() < 0.3 * steps.max()


def test_a_straight_line_stays_straight():
    q = HOME + np.array([0, 0.02, 0.03, 0.031, 0.2, 0.5])[:, None] * np.arange(1, 7)
    curve = bezier_curve(ARM, q, SCAN)
    assert curve.chord_deviation().max() < 1e-12


def test_one_joint_moves_alone():
    timed = time_bezier(ARM, WAYS["one joint"], SCAN)
    others = [0, 1, 2, 3, 5]
    assert np.all(timed.positions[:, others] == HOME[others])
    assert not timed.velocities[:, others].any()


@EACH_WAY
@pytest.mark.parametrize("deviation", [0.0005, 0.00002])
def test_between_samples_a_straight_line_is_near_enough_at_the_scanner(q, deviation):
    timed = time_bezier(ARM, q, FREE, deviation)
    curve = bezier_curve(ARM, q, FREE)
    fine = np.linspace(0.0, curve.times[-1], 20000)
    line = np.stack([np.interp(fine, timed.times, joint) for joint in timed.positions.T], axis=1)
    gap = ARM.forward_scanner(line)[:, :3, 3] - ARM.forward_scanner(curve.at(fine))[:, :3, 3]
    assert np.linalg.norm(gap, axis=1).max() <= deviation
    assert np.diff(timed.times).max() <= 0.04 + 1e-9
    assert np.abs(timed.velocities - curve.at(timed.times, 1)).max() < 1e-6


def test_the_jerk_is_bounded_and_topp_ra_has_none():
    q = smooth()
    curve = bezier_curve(ARM, q, FREE)
    fine = np.linspace(0.0, curve.times[-1], 50001)
    rate = np.diff(curve.at(fine, 2), axis=0) / np.diff(fine)[:, None]
    assert np.abs(rate).max() <= curve.largest_jerk * (1 + 1e-9)
    assert np.abs(rate).max() > 0.98 * curve.largest_jerk
    coarse, dense = (time_bezier(ARM, q, FREE, d) for d in (0.0005, 0.000001))
    assert largest_jerk(coarse) <= largest_jerk(dense) * 1.5 <= 1.5 * curve.largest_jerk
    assert largest_jerk(dense) > 0.8 * curve.largest_jerk
    two = time_bezier(ARM, WAYS["one step"], FREE)
    assert 0.0 < largest_jerk(two) <= bezier_curve(ARM, WAYS["one step"], FREE).largest_jerk


@EACH_WAY
def test_lines_between_the_samples_keep_the_scanner_within_its_speed(q):
    timed = time_bezier(ARM, q, SCAN)
    fine = np.linspace(0.0, timed.times[-1], int(timed.times[-1] / 0.001) + 50)
    line = np.stack([np.interp(fine, timed.times, joint) for joint in timed.positions.T], axis=1)
    assert scanner_speeds(fine, line).max() <= 0.2 * 1.001


def test_a_scanner_that_turns_about_itself_keeps_its_speed_by_lines_too():
    """Wrist and shoulder turn against each other: small scanner speeds of large joint speeds."""
    turn = 0.25 * np.sin(np.linspace(0.0, 4.0 * np.pi, 80))[:, None]
    q = HOME + turn * np.array([1.0, -1.0, 2.0, -1.0, -1.0, 0.5])
    timed = time_bezier(ARM, q, SCAN)
    fine = np.linspace(0.0, timed.times[-1], int(timed.times[-1] / 0.001))
    line = np.stack([np.interp(fine, timed.times, joint) for joint in timed.positions.T], axis=1)
    assert scanner_speeds(fine, line).max() <= 0.2 * 1.001


def test_a_very_long_path_takes_a_few_seconds():
    q = smooth(3000, 3.0)
    begin = time.perf_counter()
    timed = time_bezier(ARM, q, SCAN)
    assert time.perf_counter() - begin < 30.0
    assert timed.path[-1] == 2999
    assert scanner_speeds(timed.times, timed.positions).max() <= 0.2


def test_the_same_path_has_the_same_motion():
    a, b = (time_bezier(ARM, shaky(3), SCAN) for _ in range(2))
    for name in ("times", "positions", "velocities", "path"):
        assert np.array_equal(getattr(a, name), getattr(b, name))


def test_the_way_back_takes_as_long():
    q = shaky(4)
    there, back = bezier_curve(ARM, q, SCAN), bezier_curve(ARM, q[::-1], SCAN)
    assert there.times[-1] == pytest.approx(back.times[-1], rel=0.01)


def test_slower_keeps_the_curve():
    curve = bezier_curve(ARM, smooth(), SCAN)
    slow = curve.slowed(2.0)
    times = np.linspace(0, curve.times[-1], 100)
    assert np.allclose(slow.at(2 * times), curve.at(times), atol=1e-12)
    assert np.allclose(slow.largest(3), curve.largest(3) / 8)


def test_a_course_has_no_long_step_beside_a_short_one_and_keeps_all_positions():
    q = HOME + np.array([0, 0.1, 0.1001, 0.4, 0.8])[:, None] * np.ones(6)
    course = Course.through(q)
    ratio = course.lengths[1:] / course.lengths[:-1]
    assert max(ratio.max(), 1 / ratio.min()) < 4.0
    whole = course.places == np.round(course.places)
    assert course.places[whole].tolist() == [0, 1, 2, 3, 4]
    assert np.allclose(course.positions[whole], q, atol=1e-15)
    between = np.stack([np.interp(course.places, np.arange(5), joint) for joint in q.T], axis=1)
    assert np.allclose(course.positions, between)


@pytest.mark.parametrize(
    ("q", "text"),
    [
        (np.zeros((3, 5)), "shape"),
        (np.zeros(6), "shape"),
        (np.full((3, 6), np.nan), "finite"),
        (HOME[None], "at least 2"),
        (np.stack([HOME, HOME + 0.1, HOME + 0.1, HOME]), "positions 1 and 2 equal"),
    ],
)
def test_what_is_no_path_is_refused(q, text):
    with pytest.raises(JointsInvalidError, match=text):
        time_bezier(ARM, q, SCAN)


@pytest.mark.parametrize(
    "limits",
    [
        Limits(np.zeros(6), 5.0, 0.2),
        Limits(ARM.velocity, 0.0, 0.2),
        Limits(ARM.velocity, 5.0, 0.0),
        Limits(ARM.velocity, np.nan, 0.2),
        Limits(ARM.velocity, -1.0, 0.2),
        Limits(np.full(6, np.inf), 5.0, 0.2),
    ],
)
def test_limits_that_allow_nothing_are_refused(limits):
    with pytest.raises(InputError, match="limits above zero"):
        time_bezier(ARM, smooth(), limits)


@pytest.mark.parametrize("deviation", [0.0, -1.0, np.nan])
def test_a_deviation_of_nothing_is_refused(deviation):
    with pytest.raises(InputError, match="deviation"):
        time_bezier(ARM, smooth(), SCAN, deviation)
