from itertools import combinations

import numpy as np
import pytest

from skinplan.errors import NoCandidatesError
from skinplan.stations.cover import choose, deviation


def line(places, half, points):
    places = np.asarray(places, float)
    covers = np.abs(points[None] - places[:, None]) <= half
    return covers, np.stack([places, np.zeros(len(places))], axis=1)


def brute_force(covers, places, wanted):
    """Most points, then fewest stations, then least deviation, over all subsets."""
    best = None
    for size in range(1, len(covers) + 1):
        for chosen in combinations(range(len(covers)), size):
            covered = covers[list(chosen)].any(axis=0).sum()
            key = (-covered, size, round(deviation(places[list(chosen)], wanted), 9))
            best = key if best is None or key < best else best
        if best[0] == -covers.any(axis=0).sum():
            return best
    return best


def test_the_choice_equals_brute_force_on_random_small_instances():
    for seed in range(60):
        rng = np.random.default_rng(seed)
        points = np.sort(rng.uniform(0, 4, rng.integers(5, 30)))
        covers, places = line(np.sort(rng.uniform(0, 4, rng.integers(1, 9))), 0.6, points)
        if not covers.any():
            continue
        found = choose(covers, places, 1.0)
        covered = covers[found.chosen].any(axis=0).sum()
        key = (-covered, len(found.chosen), round(found.deviation_m, 9))
        best = brute_force(covers, places, 1.0)
        assert key[:2] == best[:2]
        assert key[2] == pytest.approx(best[2], abs=1e-6)
        assert found.proven and found.lower_bound == len(found.chosen)


def test_an_arbitrary_cover_that_is_no_line_equals_brute_force():
    for seed in range(40):
        rng = np.random.default_rng(100 + seed)
        covers = rng.random((7, 12)) < 0.35
        places = np.stack([np.sort(rng.uniform(0, 4, 7)), rng.uniform(0, 1, 7)], axis=1)
        if covers.any():
            found = choose(covers, places, 1.0)
            best = brute_force(covers, places, 1.0)
            assert (-covers[found.chosen].any(axis=0).sum(), len(found.chosen)) == best[:2]
            assert found.deviation_m == pytest.approx(best[2], abs=1e-6)


def test_deviation_by_hand():
    assert deviation(np.array([[0.0, 0.0]]), 1.0) == 0.0
    # Gaps 1.2 and 0.7 of 1.0: 0.2 + 0.3, and the last one's own neighbour again 0.3.
    assert deviation(np.array([[0.0, 0], [1.2, 0], [1.9, 0]]), 1.0) == pytest.approx(0.8)


def test_ties_go_to_the_smaller_set_and_then_to_the_wanted_spacing():
    points = np.array([0.0, 1.0, 2.0, 3.0])
    covers, places = line([0.5, 1.5, 2.5], 0.6, points)
    assert choose(covers, places, 2.0).chosen.tolist() == [0, 2]
    both = np.vstack([covers, covers[2]])
    places = np.vstack([places, [[2.6, 0.0]]])
    assert choose(both, places, 2.1).chosen.tolist() == [0, 3]
    assert choose(both, places, 2.0).chosen.tolist() == [0, 2]


def test_the_wanted_spacing_never_costs_a_point_or_a_station():
    points = np.array([0.0, 1.0, 2.0, 3.0])
    covers, places = line([0.5, 2.5, 1.4, 1.6], 0.6, points)
    order = np.argsort(places[:, 0])
    for wanted in (0.0, 0.2, 50.0):
        found = choose(covers[order], places[order], wanted)
        assert len(found.chosen) == 2 and covers[order][found.chosen].any(axis=0).all()


def test_one_station_stands_in_the_middle():
    points = np.array([0.0, 0.1])
    covers, places = line([-0.5, -0.2, 0.1, 0.5], 1.0, points)
    found = choose(covers, places, 1.0)
    assert found.chosen.tolist() in ([1], [2]) and found.deviation_m == 0.0


@pytest.mark.parametrize("covers", [np.zeros((0, 3), dtype=bool), np.zeros((2, 3), dtype=bool)])
def test_no_candidates_are_an_error(covers):
    with pytest.raises(NoCandidatesError):
        choose(covers, np.zeros((len(covers), 2)), 1.0)
