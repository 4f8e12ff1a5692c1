import numpy as np

from skinplan.stations.assign import assign


def test_each_point_goes_to_a_station_that_reaches_it():
    rng = np.random.default_rng(0)
    for _ in range(30):
        reaches = rng.random((4, 50)) < 0.4
        owner = assign(reaches, np.sort(rng.uniform(0, 4, 4)), rng.uniform(0, 4, 50))
        reached = reaches.any(axis=0)
        assert np.all(owner[~reached] == -1)
        assert np.all(reaches[owner[reached], np.flatnonzero(reached)])


def test_what_several_reach_is_split_evenly_and_without_gaps():
    along = np.linspace(0, 3, 31)
    places = np.array([0.75, 2.25])
    reaches = np.stack([along < 2.0, along > 1.0])
    owner = assign(reaches, places, along)
    assert abs(np.count_nonzero(owner == 0) - 15) <= 1
    assert np.all(np.diff(owner) >= 0)


def test_the_order_of_the_points_does_not_matter():
    rng = np.random.default_rng(1)
    along, reaches = rng.uniform(0, 3, 40), rng.random((3, 40)) < 0.6
    turned = rng.permutation(40)
    places = np.array([0.5, 1.5, 2.5])
    a = assign(reaches, places, along)
    assert np.array_equal(a[turned], assign(reaches[:, turned], places, along[turned]))


def test_a_point_that_its_own_station_misses_goes_to_the_nearest_that_reaches_it():
    along = np.array([0.1, 0.2, 0.3, 2.7, 2.8, 2.9])
    reaches = np.ones((3, 6), dtype=bool)
    reaches[0, 1] = False
    owner = assign(reaches, np.array([0.2, 1.5, 2.8]), along)
    assert owner[1] == 1


def test_one_station_and_none_reached():
    assert assign(np.ones((1, 4), dtype=bool), np.zeros(1), np.arange(4.0)).tolist() == [0] * 4
    assert assign(np.zeros((2, 3), dtype=bool), np.arange(2.0), np.arange(3.0)).tolist() == [-1] * 3
