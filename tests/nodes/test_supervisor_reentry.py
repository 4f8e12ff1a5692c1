"""Going on in the middle of a segment: from where the arm stands, slowly, nothing twice."""

import numpy as np
import pytest

from skinplan.trajectory.model import SCAN, Segment
from skinplan_nodes.supervisor.reentry import nearest, passed, rest, slowed_start, until, way_back


def segment(seed: int = 1, points: int = 5, duration_s: float = 4.0) -> Segment:
    """A smooth way of six joints; point k is passed at k + 1 of points + 1 equal parts."""
    times = np.linspace(0.0, duration_s, 201)
    rng = np.random.default_rng(seed)
    size, phase = rng.uniform(0.2, 1.0, 6), rng.uniform(0.0, 3.0, 6)
    angle = times[:, None] / duration_s * np.pi + phase
    point_s = duration_s * np.arange(1, points + 1) / (points + 1)
    return Segment(
        SCAN,
        times,
        size * np.sin(angle),
        size * np.cos(angle) * np.pi / duration_s,
        np.arange(10, 10 + points),
        2.0,
        point_s,
    )


def at(way: Segment, time_s: float) -> np.ndarray:
    return np.array([np.interp(time_s, way.times, column) for column in way.positions.T])


@pytest.mark.parametrize("seed", range(5))
def test_the_place_on_the_way_is_found(seed: int) -> None:
    way = segment(seed)
    for time_s in (0.0, 0.013, 1.7, 3.99, 4.0):
        found = nearest(way, at(way, time_s), 0.02)
        assert found.time_s == pytest.approx(time_s, abs=1e-6)
        assert found.distance_rad < 1e-9
    beside = at(way, 2.0) + 0.3
    assert nearest(way, beside, 0.02).distance_rad > 0.02


def test_of_two_passes_the_earlier_one_counts() -> None:
    times = np.linspace(0.0, 4.0, 401)
    there_and_back = np.tile(np.minimum(times, 4.0 - times)[:, None], (1, 6))
    way = Segment(SCAN, times, there_and_back, there_and_back * 0.0, np.arange(2), 1.0)
    assert nearest(way, np.full(6, 0.5), 0.001).time_s == pytest.approx(0.5)
    assert nearest(way, np.full(6, 0.5004), 0.01).time_s == pytest.approx(0.5004)


def test_the_rest_begins_where_the_arm_stands_at_rest_and_ends_as_planned() -> None:
    way = segment()
    here = at(way, 1.7) + 0.004
    left = rest(way, 1.7, here)
    assert left is not None
    np.testing.assert_array_equal(left.positions[0], here)
    np.testing.assert_array_equal(left.velocities[0], 0.0)
    np.testing.assert_array_equal(left.positions[-1], way.positions[-1])
    np.testing.assert_allclose(left.velocities[-1], way.velocities[-1])
    assert (np.diff(left.times) > 0.0).all()
    assert left.points.tolist() == [12, 13, 14]
    assert passed(way, 1.7) == {10, 11}
    assert (np.diff(left.point_s) > 0.0).all() and left.point_s[-1] < left.duration_s


def test_the_way_is_taken_up_slowly_and_nowhere_faster_than_planned() -> None:
    way = segment()
    left = rest(way, 1.0, at(way, 1.0))
    assert left is not None
    speed = np.abs(np.diff(left.positions, axis=0)).max(axis=1) / np.diff(left.times)
    planned = np.abs(np.diff(way.positions, axis=0)).max(axis=1) / np.diff(way.times)
    assert speed.max() <= planned.max() + 1e-6
    assert speed[0] < 0.2 * planned.max()
    # ln(10) / 0.9 s for the first planned second, the others as planned.
    assert left.duration_s == pytest.approx(2.0 + np.log(10.0) / 0.9, abs=1e-6)
    # Velocities are those of the positions.
    middle = 0.5 * (left.velocities[1:] + left.velocities[:-1])[5:]
    slope = (np.diff(left.positions, axis=0) / np.diff(left.times)[:, None])[5:]
    np.testing.assert_allclose(slope, middle, atol=0.02)


def test_points_are_passed_where_they_were_planned() -> None:
    way = segment()
    left = rest(way, 1.0, at(way, 1.0))
    assert left is not None
    for point, time_s in zip(left.points, left.point_s, strict=True):
        planned_s = way.point_s[way.points.tolist().index(point)]
        np.testing.assert_allclose(at(left, time_s), at(way, planned_s), atol=2e-3)


def test_piece_and_rest_are_the_whole() -> None:
    way = segment()
    for time_s in (0.3, 1.7, 3.9):
        piece, left = until(way, time_s), rest(way, time_s, at(way, time_s))
        assert piece is not None and left is not None
        assert [*piece.points, *left.points] == way.points.tolist()
        np.testing.assert_allclose(piece.positions[-1], left.positions[0])
        assert piece.tcp_path_m + left.tcp_path_m == pytest.approx(way.tcp_path_m)
    assert until(way, 0.0) is None
    assert rest(way, way.duration_s, way.positions[-1]) is None
    assert until(way, 99.0) is way


def test_points_without_times_count_as_passed_at_the_end_only() -> None:
    way = segment()
    unknown = Segment(way.kind, way.times, way.positions, way.velocities, way.points, 2.0)
    assert passed(unknown, 3.9) == set()
    left = rest(unknown, 3.9, at(way, 3.9))
    assert left is not None and left.points.tolist() == way.points.tolist()


def test_a_slow_start_leaves_way_and_points_as_they_are() -> None:
    way = segment()
    slow = slowed_start(way)
    np.testing.assert_array_equal(slow.positions, way.positions)
    assert slow.points.tolist() == way.points.tolist() and slow.duration_s > way.duration_s


def test_the_way_back_is_the_way_there_turned_round() -> None:
    first = segment(3)
    second = segment(4)
    joined = Segment(
        SCAN,
        second.times,
        second.positions + first.positions[-1] - second.positions[0],
        second.velocities,
        second.points,
        1.0,
    )
    piece = until(joined, 1.3)
    assert piece is not None
    here = piece.positions[-1] + 0.003
    back = way_back([first, piece], here, 0.02)
    assert back is not None
    np.testing.assert_array_equal(back.positions[0], here)
    np.testing.assert_array_equal(back.positions[-1], first.positions[0])
    assert (np.diff(back.times) > 0.0).all()
    assert back.duration_s > 2.0 * (first.duration_s + 1.3)
    assert len(back.points) == 0
    # Every place of it lies on the way there.
    for q in back.positions[1:]:
        near = min(nearest(part, q, 1e-6).distance_rad for part in (first, piece))
        assert near < 1e-9
    speed = np.abs(np.diff(back.positions, axis=0)).max(axis=1) / np.diff(back.times)
    there = np.abs(np.diff(first.positions, axis=0)).max(axis=1) / np.diff(first.times)
    assert speed[2:].max() < there.max()
    assert way_back([first], here, 0.02) is None
    assert way_back([], here, 0.02) is None
