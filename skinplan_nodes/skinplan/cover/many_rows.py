"""Covers with very many rows that are nearly alike, as surface samples are.

The relaxation and the search see the rows in play only; rows that a solution leaves short come into
play next. What few rows prove to be needed is needed for all of them.

Nothing depends on time: the search is limited by its number of nodes, so that the same input gives
the same cover on every machine.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import LinearConstraint, linprog, milp
from scipy.sparse import csr_matrix

from skinplan.cover.greedy import best_greedy
from skinplan.cover.minimum import CoverResult
from skinplan.errors import InputError
from skinplan.transforms import Array

_FIRST_ROWS = 600
_MORE_ROWS = 300
_LP_ROUNDS = 20
_SAME = 5e-4
_FREED = 12
_MOST_SEARCHES = 60
_MOST_FREE = 120
_NODES = 50
# A cover so near to its bound is good enough: the last column costs most of the time.
_GAP = 0.02
_SHORT = 0.02
_SEED = 1

Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Relaxation:
    """A cover in which columns may be taken in part.

    Attributes:
        value: Sum of the parts' weights: no cover weighs less.
        share: Part of each column, shape (c,).
        reduced: What more the relaxation would weigh with all of a column, shape (c,).
        rows: The rows that were in play, rising.
    """

    value: float
    share: Array
    reduced: Array
    rows: Indices


def relax(matrix: csr_matrix, demand: Indices, weights: Array) -> Relaxation:
    """Solves the linear relaxation.

    Args:
        matrix: Rows to be covered by columns, shape (n, c), values 0 and 1.
        demand: Columns needed by each row, shape (n,), at most as many as it has.
        weights: Weight of each column, shape (c,), above 0.

    Returns:
        The relaxation over the rows that turned out to matter.

    Raises:
        InputError: A row demands more columns than it has.
    """
    _require(matrix, demand)
    noise = np.random.default_rng(_SEED)
    rows = _first_rows(matrix, demand, noise)
    before = 0.0
    for _ in range(_LP_ROUNDS):
        answer = linprog(
            weights, A_ub=-matrix[rows], b_ub=-demand[rows], bounds=(0.0, 1.0), method="highs"
        )
        if answer.status != 0:
            # Half-solved: no bound but the trivial one.
            return Relaxation(0.0, np.ones(len(weights)), np.zeros(len(weights)), rows)
        missing = demand - matrix @ answer.x
        grown = answer.fun - before
        before = float(answer.fun)
        if missing.max(initial=0.0) < _SHORT or grown < _SAME * before:
            break
        rows = _with_short(rows, missing, _SHORT, noise)
    return Relaxation(float(answer.fun), answer.x, answer.lower.marginals, rows)


def cover_many_rows(
    matrix: csr_matrix, demand: Indices, weights: Array | None = None
) -> CoverResult:
    """Chooses a light set of columns that covers each row as often as it demands.

    Args:
        matrix: Rows to be covered by columns, shape (n, c), values 0 and 1.
        demand: Columns needed by each row, shape (n,), at most as many as it has.
        weights: Weight of each column, shape (c,), above 0; None = 1 each.

    Returns:
        The cover, with the bound proven; deterministic.

    Raises:
        InputError: A row demands more columns than it has.
    """
    cost = np.ones(matrix.shape[1]) if weights is None else np.asarray(weights, dtype=float)
    whole = bool(np.all(cost == np.round(cost)))
    matrix, demand = _distinct(matrix, np.asarray(demand, dtype=np.int64))
    if not len(demand):
        none = np.zeros(0, dtype=np.int64)
        return CoverResult(none, 0.0, 0.0, True, none, none)
    relaxed = relax(matrix, demand, cost)
    bound = _up(relaxed.value, whole)
    guides = [0.02 + relaxed.share, np.ones(len(cost))]
    best = best_greedy(matrix, demand, cost, guides, bound)
    if cost[best].sum() > (1.0 + _GAP) * bound + 1e-6:
        best = _searched(matrix, demand, cost, relaxed, best, bound)
    total = float(cost[best].sum())
    none = np.zeros(0, dtype=np.int64)
    return CoverResult(best, total, min(bound, total), total <= bound + 1e-6, none, none)


def _searched(
    matrix: csr_matrix,
    demand: Indices,
    cost: Array,
    relaxed: Relaxation,
    best: Indices,
    bound: float,
) -> Indices:
    """Searches for a lighter cover: frees neighbouring columns and covers their rows anew.

    Each small problem goes to HiGHS over the rows in play, with the columns that the relaxation
    likes best and a limit on its nodes; what that leaves short is filled greedily.
    """
    searches, centre, still = 0, 0, 0
    while searches < _MOST_SEARCHES and still < len(best):
        if cost[best].sum() <= (1.0 + _GAP) * bound + 1e-6:
            break
        centre %= len(best)
        freed = _neighbours(matrix, best, centre)
        kept = np.setdiff1d(best, freed)
        found = _again(matrix, demand, cost, relaxed, kept, float(cost[freed].sum()))
        searches += 1
        if found is not None and cost[found].sum() < cost[best].sum() - 1e-9:
            best, still = found, 0
        else:
            still += _FREED // 2
        centre += _FREED // 2
    return best


def _neighbours(matrix: csr_matrix, chosen: Indices, centre: int) -> Indices:
    """Returns the chosen columns that share most rows with one of them, and with those."""
    part = matrix[:, chosen]
    shared = np.asarray((part.T @ part).todense())
    near = {centre}
    order = [centre]
    for column in order:
        for other in np.argsort(-shared[column], kind="stable").tolist():
            if len(near) >= _FREED or shared[column, other] == 0.0:
                break
            if other not in near:
                near.add(other)
                order.append(other)
    return chosen[np.array(order)]


def _again(
    matrix: csr_matrix,
    demand: Indices,
    cost: Array,
    relaxed: Relaxation,
    kept: Indices,
    goal: float,
) -> Indices | None:
    """Covers what is left by kept columns with less than ``goal``; None when that fails."""
    have = np.asarray(matrix[:, kept].sum(axis=1)).ravel()
    left = np.maximum(demand - have, 0.0)
    asked = relaxed.rows[left[relaxed.rows] > 0]
    part = matrix[asked]
    free = np.setdiff1d(np.flatnonzero(part.getnnz(axis=0)), kept)
    # Columns that the relaxation uses, then those that it would mind least.
    order = np.lexsort((relaxed.reduced[free], -relaxed.share[free]))
    free = np.sort(free[order[:_MOST_FREE]])
    part = part[:, free]
    if np.any(np.diff(part.indptr) < left[asked]):
        return None
    answer = milp(
        cost[free],
        constraints=[
            LinearConstraint(part, lb=left[asked]),
            LinearConstraint(cost[free][None], ub=goal - 0.5 * float(cost.min())),
        ],
        integrality=np.ones(len(free)),
        bounds=(0, 1),
        options={"node_limit": _NODES},
    )
    if answer.x is None:
        return None
    taken = np.zeros(len(cost), dtype=bool)
    taken[kept] = True
    taken[free[np.round(answer.x) > 0]] = True
    return _filled(matrix, demand, taken, cost)


def _filled(matrix: csr_matrix, demand: Indices, taken: NDArray[np.bool_], cost: Array) -> Indices:
    """Adds columns to a cover that leaves rows short."""
    left = np.maximum(demand - np.asarray(matrix @ taken.astype(float)), 0).astype(np.int64)
    short = np.flatnonzero(left)
    if not len(short):
        return np.flatnonzero(taken)
    free = np.flatnonzero(~taken)
    more = best_greedy(matrix[short][:, free], left[short], cost[free], [np.ones(len(free))], 0.0)
    return np.sort(np.concatenate([np.flatnonzero(taken), free[more]]))


def _first_rows(matrix: csr_matrix, demand: Indices, noise: np.random.Generator) -> Indices:
    """The rows with the fewest columns to spare, and some of the others."""
    if len(demand) <= 2 * _FIRST_ROWS:
        return np.arange(len(demand))
    spare = np.diff(matrix.indptr) - demand
    hardest = np.argsort(spare, kind="stable")[: _FIRST_ROWS // 2]
    others = noise.choice(len(demand), _FIRST_ROWS, replace=False)
    return np.union1d(hardest, others)


def _with_short(rows: Indices, missing: Array, least: float, noise: np.random.Generator) -> Indices:
    """Adds rows that are left short: the worst, and some of the others."""
    short = np.flatnonzero(missing > least)
    worst = short[np.argsort(-missing[short], kind="stable")[:_MORE_ROWS]]
    others = noise.choice(short, min(_MORE_ROWS, len(short)), replace=False)
    return np.unique(np.concatenate([rows, worst, others]))


def _distinct(matrix: csr_matrix, demand: Indices) -> tuple[csr_matrix, Indices]:
    """Leaves out rows without demand and all but one of rows with the same columns."""
    rows = np.flatnonzero(demand > 0)
    matrix, demand = matrix[rows], demand[rows]
    matrix.sort_indices()
    _require(matrix, demand)
    # Two sums of random numbers tell rows apart.
    noise = np.random.default_rng(_SEED)
    marks = matrix @ noise.integers(1, 1 << 50, size=(matrix.shape[1], 2)).astype(float)
    order = np.lexsort((np.arange(len(rows)), -demand, marks[:, 1], marks[:, 0]))
    first = np.ones(len(rows), dtype=bool)
    first[1:] = np.any(np.diff(marks[order], axis=0) != 0.0, axis=1)
    kept = np.sort(order[first])
    return matrix[kept], demand[kept]


def _require(matrix: csr_matrix, demand: Indices) -> None:
    short = np.flatnonzero(np.diff(matrix.indptr) < demand)
    if len(short):
        raise InputError(
            f"row {short[0]} demands {demand[short[0]]} columns and has "
            f"{matrix.indptr[short[0] + 1] - matrix.indptr[short[0]]}; a demand of at most the "
            "columns that a row has is accepted"
        )


def _up(value: float, whole: bool) -> float:
    return float(np.ceil(value - 1e-5)) if whole and np.isfinite(value) else value
