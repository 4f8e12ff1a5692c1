import numpy as np
import pytest

from skinplan.stations.candidates import floor_frame, make_candidates, overlap, refined_centre
from skinplan.stations.rectangle import Rectangle

RECTANGLE = Rectangle(1.0, 0.4, 0.6)


def test_overlap_of_equal_rectangles_by_hand():
    others = np.array([[0.0, 0.0], [0.5, 0.0], [0.5, 0.2], [2.0, 0.0], [0.0, 0.5]])
    # Common areas 0.4, 0.2, 0.1, 0, 0 of 0.4 each.
    assert np.allclose(overlap(np.zeros(2), others, RECTANGLE), (1, 1 / 3, 1 / 7, 0, 0))


def test_of_two_that_overlap_the_one_with_more_points_stays():
    points = np.array([[0.0, 0.0], [0.05, 0.0], [0.5, 0.0], [-0.4, 0.0]])
    # From x = 0 and 0.05 all four and three (0.5 and -0.4 are 0.45 apart from 0.05).
    found = make_candidates(points, RECTANGLE, 0.8)
    assert [0.0, 0.0] in found.centres.tolist() and [0.05, 0.0] not in found.centres.tolist()
    assert found.covers[found.centres.tolist().index([0.0, 0.0])].all()


def test_what_stays_does_not_overlap_and_what_went_overlaps_a_better_one():
    points = np.random.default_rng(0).uniform((-2, -0.2), (2, 0.2), (120, 2))
    found = make_candidates(points, RECTANGLE, 0.5)
    for i, centre in enumerate(found.centres):
        others = np.delete(found.centres, i, axis=0)
        assert overlap(centre, others, RECTANGLE).max() <= 0.5
    kept = {tuple(np.round(c, 6)) for c in found.centres}
    counts = found.covers.sum(axis=1)
    half = 0.5 * np.array([1.0, 0.4]) + 1e-9
    for point in points:
        if tuple(np.round(point, 6)) not in kept:
            own = np.all(np.abs(points - point) <= half, axis=1).sum()
            assert np.any((overlap(point, found.centres, RECTANGLE) > 0.5) & (counts >= own))


def test_every_point_stays_covered_or_nearly_so_at_a_high_threshold():
    points = np.random.default_rng(1).uniform((-2, -0.1), (2, 0.1), (200, 2))
    assert make_candidates(points, RECTANGLE, 0.8).covers.any(axis=0).mean() > 0.99


def test_order_of_points_does_not_matter():
    points = np.random.default_rng(2).uniform((-2, -0.2), (2, 0.2), (80, 2))
    turned = np.random.default_rng(3).permutation(80)
    a, b = make_candidates(points, RECTANGLE), make_candidates(points[turned], RECTANGLE)
    assert np.array_equal(a.centres, b.centres)
    assert np.array_equal(a.covers[:, turned], b.covers)


def test_refinement_goes_to_the_centroid_and_no_farther_than_cover_allows():
    even = np.array([[-0.2, 0.0], [0.2, 0.1]])
    assert np.allclose(refined_centre(even, np.array([0.1, 0.1]), RECTANGLE), (0.0, 0.05))
    # Most points right, one far left: the centroid 0.3 would lose it (0.4 - 0.5 = -0.1).
    skew = np.array([[-0.4, 0.0], *[[0.5, 0.0]] * 4])
    found = refined_centre(skew, np.zeros(2), RECTANGLE)
    assert np.allclose(found, (0.1, 0.0))
    assert np.all(np.abs(skew - found) <= (0.5 + 1e-9, 0.2 + 1e-9))
    assert np.allclose(refined_centre(np.zeros((0, 2)), np.array([3.0, 4.0]), RECTANGLE), (3, 4))


@pytest.mark.parametrize("heading", [-2.0, 0.0, 0.4, 3.0])
def test_the_part_is_on_the_left_of_the_base(heading):
    left = np.array([-np.sin(heading), np.cos(heading), 0.0])
    views = np.tile(left, (5, 1)) + np.array([0.0, 0.0, 0.3])
    found = floor_frame(np.zeros((5, 2)), views / np.linalg.norm(views, axis=1, keepdims=True))
    assert np.isclose(np.exp(1j * found), np.exp(1j * heading))


def test_a_part_that_lies_takes_its_long_axis():
    points = np.stack([np.linspace(-1, 1, 20), 0.5 * np.linspace(-1, 1, 20)], axis=1)
    found = floor_frame(points, np.tile([0.0, 0.0, -1.0], (20, 1)))
    assert np.isclose(found, np.arctan2(0.5, 1.0))
