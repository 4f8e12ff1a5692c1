"""The cover of very many rows: against the exact one, brute force on lattices, its own promises."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from skinplan.cover.many_rows import cover_many_rows, relax
from skinplan.cover.minimum import minimum_cover
from skinplan.errors import InputError


def discs(length, width, radius, step, spacing):
    """Which discs about a lattice of centres hold which points of a rectangle."""
    points = np.stack(
        np.meshgrid(
            np.arange(spacing / 2, length, spacing), np.arange(spacing / 2, width, spacing)
        ),
        axis=-1,
    ).reshape(-1, 2)
    centres = np.stack(
        np.meshgrid(np.arange(step / 2, length, step), np.arange(step / 2, width, step)), axis=-1
    ).reshape(-1, 2)
    pairs = cKDTree(points).sparse_distance_matrix(cKDTree(centres), radius, output_type="ndarray")
    return csr_matrix(
        (np.ones(len(pairs)), (pairs["i"], pairs["j"])), shape=(len(points), len(centres))
    )


def random_instance(seed):
    noise = np.random.default_rng(seed)
    matrix = csr_matrix((noise.random((200, 25)) < 0.3).astype(float))
    return matrix, np.minimum(noise.integers(0, 4, 200), np.diff(matrix.indptr))


@pytest.mark.parametrize("seed", range(20))
def test_bound_and_cover_hold_the_minimum_between_them(seed):
    matrix, demand = random_instance(seed)
    exact = minimum_cover(matrix, demand=demand)
    assert exact.proven
    found = cover_many_rows(matrix, demand)
    assert np.all(matrix[:, found.chosen].sum(axis=1).A1 >= demand)
    assert found.lower_bound <= exact.cost <= found.cost
    assert found.cost <= exact.cost + 1
    assert found.cost == len(found.chosen)
    assert not found.proven or found.cost == exact.cost


@pytest.mark.parametrize("times", [1, 3])
def test_discs_on_a_panel_come_near_the_bound(times):
    matrix = discs(1.8, 0.8, 0.2, 0.05, 0.02)
    found = cover_many_rows(matrix, np.full(matrix.shape[0], times))
    assert np.all(matrix[:, found.chosen].sum(axis=1).A1 >= times)
    assert found.cost <= 1.1 * found.lower_bound + 2
    # Discs of so many times the area are needed at the very least.
    assert found.lower_bound >= times * 1.8 * 0.8 / (np.pi * 0.2**2)


def test_same_input_same_cover():
    matrix = discs(1.0, 0.6, 0.2, 0.05, 0.02)
    demand = np.full(matrix.shape[0], 2)
    first, second = cover_many_rows(matrix, demand), cover_many_rows(matrix, demand)
    assert np.array_equal(first.chosen, second.chosen)
    assert first.lower_bound == second.lower_bound


def test_repeated_rows_change_nothing():
    matrix, demand = random_instance(3)
    twice = csr_matrix(np.repeat(matrix.toarray(), 2, axis=0))
    found = cover_many_rows(twice, np.repeat(demand, 2))
    assert np.array_equal(found.chosen, cover_many_rows(matrix, demand).chosen)


def test_weights_decide():
    matrix = csr_matrix(np.array([[1.0, 1.0, 0.0], [1.0, 0.0, 1.0]]))
    assert cover_many_rows(matrix, [1, 1]).chosen.tolist() == [0]
    assert cover_many_rows(matrix, [1, 1], np.array([5.0, 1.0, 1.0])).chosen.tolist() == [1, 2]


def test_nothing_demanded_nothing_chosen():
    matrix = csr_matrix(np.ones((3, 2)))
    found = cover_many_rows(matrix, np.zeros(3))
    assert len(found.chosen) == 0
    assert found.proven


def test_relaxation_bounds_from_below():
    matrix, demand = random_instance(11)
    relaxed = relax(matrix, demand, np.ones(25))
    assert relaxed.value <= minimum_cover(matrix, demand=demand).cost + 1e-6
    assert np.all((relaxed.share >= -1e-9) & (relaxed.share <= 1 + 1e-9))


def test_demand_beyond_the_columns_is_refused():
    with pytest.raises(InputError, match="row 1 demands 2 columns and has 1"):
        cover_many_rows(csr_matrix(np.array([[1.0, 1.0], [0.0, 1.0]])), [1, 2])
