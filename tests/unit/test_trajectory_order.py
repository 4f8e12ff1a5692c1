import numpy as np
import pytest

from reach_scene import flat_path, path_of
from skinplan.scan_path.model import FEATURE, ROW
from skinplan.trajectory.order import (
    CLUSTER_POINTS,
    STEEPNESS_PER_MM,
    k_means,
    next_best_score,
    published_order,
    z_shaped,
)
from skinplan.trajectory.visit import VisitTask
from skinplan.transforms import Array, apply, rotate, transform

DOWN = np.array([0.0, 0.0, -1.0])


def mixed(seed=0, features=60):
    """Rows over a plate and features in two places above it."""
    rows = flat_path(1.6, 0.8, 0.2)
    rng = np.random.default_rng(seed)
    middle = np.where(np.arange(features)[:, None] % 2 == 0, (-0.5, 0.1, 0.05), (0.5, -0.1, 0.05))
    spots = middle + rng.uniform(-0.1, 0.1, (features, 3))
    return path_of(
        np.vstack([rows.targets, spots]),
        np.vstack([rows.directions, np.tile(DOWN, (features, 1))]),
        np.append(rows.kinds, np.full(features, FEATURE)),
        np.append(rows.groups, 1 + np.arange(features) % 2),
    )


def order_of(path, points, interval_m, begin=None):
    return published_order(VisitTask(path, points, interval_m, begin)).points


def score(previous, move, view, d0: float = 0.24) -> Array:
    return next_best_score(
        np.array(previous, float),
        np.zeros(3),
        DOWN,
        np.array([move], float),
        np.array([view], float),
        d0,
    )[0]


def test_eq_8_by_hand():
    # Straight on, same view, at d0 = 240 mm: (0.9 * 2 + 0.1 * 2) / (1 + e^0) = 1.
    assert score((1, 0, 0), (0.24, 0, 0), DOWN) == pytest.approx(1.0)
    # At a right angle, view turned by a right angle, 10 mm on: (0.9 + 0.1) / (1 + e^(0.02 * -230)).
    assert score((1, 0, 0), (0, 0.01, 0), (1, 0, 0)) == pytest.approx(1.0 / (1.0 + np.exp(-4.6)))
    # Back: cos alpha = -1 leaves the views' part: 0.1 * 2 / (1 + e^(0.02 * -140)).
    assert score((1, 0, 0), (-0.1, 0, 0), DOWN) == pytest.approx(0.2 / (1.0 + np.exp(-2.8)))


def test_k_is_per_millimetre():
    assert STEEPNESS_PER_MM == 0.02
    # 100 mm beyond d0: 1 / (1 + e^2) of the numerator; with k per metre about a half of it.
    assert score((1, 0, 0), (0.34, 0, 0), DOWN) == pytest.approx(2.0 / (1.0 + np.exp(2.0)))


def test_coincident_points_and_huge_distances_are_no_trouble():
    assert np.isfinite(score((1, 0, 0), (0, 0, 0), DOWN))
    assert np.isfinite(score((0, 0, 0), (0.1, 0, 0), DOWN))
    assert 0.0 <= score((1, 0, 0), (500.0, 0, 0), DOWN) < 1e-100


def test_rows_are_joined_to_a_z():
    path = flat_path(0.8, 0.4, 0.2)
    order = z_shaped(path, np.arange(len(path)))
    steps = np.linalg.norm(np.diff(path.positions[order], axis=0), axis=1)
    assert np.allclose(steps, 0.2)
    assert len(np.unique(order)) == len(path)


@pytest.mark.parametrize("corner", [(-1, -1), (-1, 1), (1, -1), (1, 1)])
def test_the_z_begins_at_the_corner_where_the_scanner_is(corner):
    path = flat_path(0.8, 0.4, 0.2)
    begin = np.array([0.6 * corner[0], 0.4 * corner[1], 0.3])
    first = path.positions[z_shaped(path, np.arange(len(path)), begin)[0]]
    assert np.allclose(first[:2], (0.4 * corner[0], 0.2 * corner[1]))


def test_pieces_of_a_row_behind_a_hole_are_driven_one_after_the_other():
    path = flat_path(1.6, 0.4, 0.2)
    groups = path.groups + 10 * (path.positions[:, 0] > 0.0)  # the second half has its own numbers
    split = path_of(path.targets, path.directions, path.kinds, groups)
    rows = np.arange(len(path))
    assert np.array_equal(z_shaped(split, rows), z_shaped(path, rows))


@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_row_points(count):
    path = flat_path(0.8, 0.4, 0.2)
    assert sorted(z_shaped(path, np.arange(count))) == list(range(count))


def test_every_point_comes_once_and_features_follow_their_nearest_row_point():
    path = mixed()
    points = np.arange(len(path))[3:]
    order = order_of(path, points, 0.08)
    assert sorted(order) == points.tolist()
    kinds = path.kinds[order]
    starts = np.flatnonzero((kinds[1:] == FEATURE) & (kinds[:-1] == ROW))
    # 60 points make three clusters of at most 25 on average.
    assert 1 <= len(starts) <= 3
    for start in starts:
        block = order[start + 1 :]
        block = block[: np.argmax(np.append(path.kinds[block] == ROW, True))]
        if len(block) <= 1.5 * CLUSTER_POINTS:
            centre = path.positions[block].mean(axis=0)
            rows = points[path.kinds[points] == ROW]
            gaps = np.linalg.norm(path.positions[rows] - centre, axis=1)
            assert gaps[rows == order[start]][0] <= gaps.min() + 0.05


def test_without_rows_the_clusters_are_visited_all_the_same():
    path = mixed()
    features = np.flatnonzero(path.kinds == FEATURE)
    for begin in (None, np.array([1.0, 0.0, 0.3])):
        assert sorted(order_of(path, features, 0.08, begin)) == features.tolist()


def test_the_order_does_not_depend_on_the_frame():
    path = mixed()
    T = transform((1.0, -2.0, 0.5), np.array([0.1, 0.5, -0.3, 0.8]))
    moved = path_of(apply(T, path.targets), rotate(T, path.directions), path.kinds, path.groups)
    points = np.arange(len(path))
    begin = np.array([-0.9, -0.5, 0.3])
    a = order_of(path, points, 0.08, begin)
    assert np.array_equal(a, order_of(moved, points, 0.08, apply(T, begin[None])[0]))


def test_k_means_separates_what_is_apart_and_has_no_empty_clusters():
    rng = np.random.default_rng(0)
    points = np.vstack([rng.normal(size=(20, 3)) * 0.05 + 3 * corner for corner in np.eye(3)])
    labels = k_means(points, 3)
    assert [len(set(labels[20 * i : 20 * i + 20])) for i in range(3)] == [1, 1, 1]
    assert len(set(labels)) == 3
    for count in range(1, 12):
        labels = k_means(rng.random((10, 3)), count)
        assert sorted(set(labels)) == list(range(max(labels) + 1)) and max(labels) < count
    assert k_means(np.zeros((5, 3)), 3).tolist() == [0] * 5
