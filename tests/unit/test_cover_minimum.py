"""The cover solver against brute force, closed forms and its own promises."""

import itertools

import numpy as np
import pytest
from scipy.sparse import coo_matrix, csr_matrix

from skinplan.cover.minimum import minimum_cover
from skinplan.cover.reduce import reduce
from skinplan.errors import InputError


def _brute(matrix, demand, weights):
    """The least weight of all subsets of columns that meet the (clipped) demand."""
    wanted = np.minimum(demand, matrix.sum(axis=1))
    best = np.inf
    for size in range(matrix.shape[1] + 1):
        for subset in itertools.combinations(range(matrix.shape[1]), size):
            if np.all(matrix[:, list(subset)].sum(axis=1) >= wanted):
                best = min(best, weights[list(subset)].sum())
        if np.isfinite(best) and np.all(weights == 1.0):
            break
    return best


@pytest.mark.parametrize("kind", ["plain", "demand", "weights", "both"])
def test_agrees_with_brute_force_on_random_instances(kind):
    rng = np.random.default_rng(5)
    for _ in range(60):
        rows, columns = rng.integers(1, 25), rng.integers(1, 10)
        matrix = (rng.random((rows, columns)) < rng.uniform(0.1, 0.6)).astype(int)
        demand = rng.integers(0, 4, rows) if kind in ("demand", "both") else np.ones(rows, int)
        whole = rng.integers(1, 5, columns).astype(float)
        weights = whole + rng.integers(0, 2) * rng.random(columns)
        weights = weights if kind in ("weights", "both") else np.ones(columns)
        result = minimum_cover(csr_matrix(matrix), demand=demand, weights=weights)
        assert result.proven
        assert result.cost == pytest.approx(_brute(matrix, demand, weights), rel=1e-5)
        assert result.lower_bound == pytest.approx(result.cost, rel=1e-5)
        got = matrix[:, result.chosen].sum(axis=1)
        assert np.all(got >= np.minimum(demand, matrix.sum(axis=1)))
        assert np.array_equal(
            result.uncoverable, np.flatnonzero((matrix.sum(axis=1) == 0) & (demand > 0))
        )
        assert np.array_equal(result.short, np.flatnonzero(matrix.sum(axis=1) < demand))


def test_reduction_alone_keeps_the_minimum():
    rng = np.random.default_rng(6)
    for _ in range(80):
        matrix = (rng.random((rng.integers(2, 15), rng.integers(2, 9))) < 0.4).astype(int)
        demand = np.minimum(rng.integers(0, 3, len(matrix)), matrix.sum(axis=1))
        weights = rng.integers(1, 4, matrix.shape[1]).astype(float)
        left = reduce(csr_matrix(matrix, dtype=float), demand, weights)
        rest = left.matrix.toarray().astype(int)
        cost = weights[left.forced].sum() + _brute(rest, left.demand, weights[left.columns])
        assert cost == _brute(matrix, demand, weights)


def test_intervals_need_as_many_as_the_closed_form_says():
    # Points 0..n-1 on a line, windows of w points at every place: ceil(n / w) windows.
    for count, width in ((100, 7), (500, 50), (1000, 33)):
        matrix = np.zeros((count, count - width + 1))
        for start in range(matrix.shape[1]):
            matrix[start : start + width, start] = 1
        result = minimum_cover(matrix)
        assert result.cost == -(-count // width) and result.proven


def test_projective_plane_needs_the_search():
    # Lines of the plane of order 3 meet every point: the relaxation gives 13/4, the minimum is 4.
    lines = {(0, 1, 3, 9)}
    lines = {tuple(sorted((p + s) % 13 for p in line)) for line in lines for s in range(13)}
    matrix = np.zeros((13, 13))
    for number, line in enumerate(sorted(lines)):
        matrix[number, list(line)] = 1
    result = minimum_cover(matrix)
    subsets = itertools.combinations(range(13), len(result.chosen) - 1)
    assert result.proven
    assert not any(np.all(matrix[:, list(s)].sum(axis=1) >= 1) for s in subsets)


def test_order_of_rows_and_columns_does_not_change_the_minimum():
    rng = np.random.default_rng(8)
    matrix = rng.random((120, 40)) < 0.12
    cost = minimum_cover(matrix).cost
    for _ in range(3):
        rows, columns = rng.permutation(120), rng.permutation(40)
        assert minimum_cover(matrix[rows][:, columns]).cost == cost


def test_the_same_input_gives_the_same_answer():
    matrix = csr_matrix(np.random.default_rng(9).random((200, 60)) < 0.1)
    first, second = minimum_cover(matrix), minimum_cover(matrix)
    assert np.array_equal(first.chosen, second.chosen)


def test_a_short_time_limit_gives_a_cover_and_an_honest_bound():
    matrix = csr_matrix(np.random.default_rng(1).random((600, 300)) < 0.03)
    result = minimum_cover(matrix, time_limit_s=0.05)
    covered = np.asarray(matrix[:, result.chosen].sum(axis=1)).ravel() > 0
    left_out = np.setdiff1d(np.arange(600), result.uncoverable)
    assert np.all(covered[left_out])
    assert result.lower_bound <= result.cost
    assert result.proven == (result.lower_bound == result.cost)


def test_input_is_left_alone_and_values_do_not_count():
    matrix = coo_matrix(([2.0, -1.0, 5.0], ([0, 1, 1], [0, 1, 0])), shape=(2, 2))
    before = matrix.toarray()
    assert minimum_cover(matrix).chosen.tolist() == [0]
    assert np.array_equal(matrix.toarray(), before)


def test_nothing_to_cover_and_nothing_to_cover_with():
    nothing = minimum_cover(np.zeros((0, 3)))
    assert nothing.proven and len(nothing.chosen) == 0
    no_columns = minimum_cover(np.zeros((3, 0)))
    assert no_columns.proven and no_columns.uncoverable.tolist() == [0, 1, 2]


@pytest.mark.parametrize(
    ("matrix", "options"),
    [
        (np.ones(3), {}),
        (np.array([[1.0, np.nan]]), {}),
        (np.ones((2, 2)), {"demand": [1]}),
        (np.ones((2, 2)), {"demand": [1, -1]}),
        (np.ones((2, 2)), {"demand": [1, 0.5]}),
        (np.ones((2, 2)), {"weights": [1, 0]}),
        (np.ones((2, 2)), {"weights": [1, np.inf]}),
        (np.ones((2, 2)), {"weights": [1.0]}),
        (np.ones((2, 2)), {"time_limit_s": 0.0}),
        (np.ones((2, 2)), {"time_limit_s": float("nan")}),
    ],
)
def test_refuses_what_is_no_cover_problem(matrix, options):
    with pytest.raises(InputError, match="accepted, found"):
        minimum_cover(matrix, **options)
