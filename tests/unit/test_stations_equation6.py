"""Eq (6) and (7) against hand-computed cases, brute force and their extremes."""

import itertools

import numpy as np
import pytest

from skinplan.errors import InputError, NoCandidatesError
from skinplan.stations.candidates import refined_centre
from skinplan.stations.equation6 import equation_6, least_equation_6
from skinplan.stations.rectangle import Rectangle


def row(spans, count):
    """Which of the points 0, 1, ... count - 1 lie in spans, and the spans' middles."""
    points = np.arange(count)
    covers = np.array([(points >= low) & (points <= high) for low, high in spans])
    middles = np.array([[0.5 * (low + high), 0.0] for low, high in spans])
    return covers, middles


def test_the_value_of_a_set_worked_out_by_hand():
    # Middles at 1, 4 and 9; w = 4: D = |3 - 4|, |5 - 4| and, for the last one, again |5 - 4|.
    covers, places = row([(0, 2), (3, 5), (8, 10)], 12)
    everything = np.arange(3)
    # Points 6, 7 and 11 are not covered: N = 3.
    assert equation_6(covers, places, everything, 4.0, 10.0) == pytest.approx(3 + 10 * 3.0)
    assert equation_6(covers, places, everything, 4.0, 0.0) == 3.0
    # One station has no neighbour: D = P = 0.
    assert equation_6(covers, places, np.array([1]), 4.0, 10.0) == 9.0
    # Two: each is the other's neighbour, |8 - 4| twice.
    assert equation_6(covers, places, np.array([0, 2]), 4.0, 0.5) == pytest.approx(6 + 0.5 * 8.0)


def test_the_least_value_agrees_with_all_subsets():
    rng = np.random.default_rng(4)
    for _ in range(40):
        size, points = int(rng.integers(1, 7)), int(rng.integers(1, 12))
        covers = rng.random((size, points)) < 0.4
        places = np.stack([np.sort(rng.uniform(0.0, 5.0, size)), np.zeros(size)], axis=1)
        wanted, weight = rng.uniform(0.0, 2.0), rng.choice([0.0, 0.3, 3.0, 50.0])
        best = min(
            equation_6(covers, places, np.array(subset), wanted, weight)
            for count in range(1, size + 1)
            for subset in itertools.combinations(range(size), count)
        )
        found = least_equation_6(covers, places, wanted, weight)
        assert equation_6(covers, places, found, wanted, weight) == pytest.approx(best, abs=1e-5)


def test_lambda_at_its_extremes():
    covers, places = row([(0, 3), (3, 6), (5, 9)], 10)
    # 0: only coverage counts, and two stations leave one point out.
    assert least_equation_6(covers, places, 3.0, 0.0).tolist() == [0, 1, 2]
    # Very large: any wrong spacing is worse than any number of points; one station has none.
    assert len(least_equation_6(covers, places, 2.9, 1e6)) == 1
    # ... unless several have exactly the wanted spacing.
    even, middles = row([(0, 2), (3, 5), (6, 8)], 9)
    assert least_equation_6(even, middles, 3.0, 1e6).tolist() == [0, 1, 2]


def test_w_at_its_extremes():
    # The ends must be covered; in between one of four, all equally good for coverage.
    covers, places = row([(0, 4), (1, 5), (2, 6), (3, 7)], 1)
    covers = np.array([[1, 0], [1, 0], [0, 1], [0, 1]], dtype=bool)
    assert least_equation_6(covers, places, 0.0, 0.1).tolist() == [1, 2]  # together
    assert least_equation_6(covers, places, 100.0, 0.001).tolist() == [0, 3]  # apart


def test_the_centroid_draws_the_rectangle_as_far_as_its_points_allow():
    # Eq (7): the centroid of (0, 0), (0, 0.1) and (0.9, 0.05) is (0.3, 0.05). A rectangle 1.0 long
    # that holds all three can have its middle from 0.4 to 0.5: 0.4 is nearest.
    points = np.array([[0.0, 0.0], [0.0, 0.1], [0.9, 0.05]])
    moved = refined_centre(points, np.array([0.5, 0.05]), Rectangle(1.0, 0.3, 0.6))
    assert moved == pytest.approx([0.4, 0.05])
    free = refined_centre(points, np.array([0.5, 0.05]), Rectangle(3.0, 0.3, 0.6))
    assert free == pytest.approx([0.3, 0.05])


def test_what_is_no_weight_is_refused():
    covers, places = row([(0, 3), (3, 6)], 7)
    for wanted, weight in ((-1.0, 1.0), (1.0, -1.0), (np.nan, 1.0), (1.0, np.inf)):
        with pytest.raises(InputError, match="accepted, found"):
            least_equation_6(covers, places, wanted, weight)
    with pytest.raises(NoCandidatesError):
        least_equation_6(covers[:0], places[:0], 1.0, 1.0)
