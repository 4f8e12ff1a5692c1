"""The lightest set of columns that covers all rows often enough, with a proven lower bound.

The problem is reduced (`reduce`), its linear relaxation gives a bound, greedy covers guided by it
give a cover. Where the two do not meet, columns that no better cover can hold are left out by their
reduced costs, and HiGHS is asked for a better cover; if there is none, that is the proof.
"""

import logging
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import LinearConstraint, linprog, milp
from scipy.sparse import csr_matrix, issparse, spmatrix

from skinplan.cover.greedy import best_greedy
from skinplan.cover.reduce import Reduction, reduce
from skinplan.errors import InputError
from skinplan.transforms import Array

_LOG = logging.getLogger(__name__)
_GUIDES = 12
_TOLERANCE = 1e-6

Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class CoverResult:
    """A cover and what is known about it.

    Attributes:
        chosen: Numbers of the chosen columns, rising, shape (k,).
        cost: Sum of their weights; their number without weights.
        lower_bound: No cover weighs less than this; a whole number when all weights are.
        proven: The cover is a minimum: its cost is the lower bound.
        uncoverable: Rows that no column covers, rising, shape (u,); they are left out.
        short: Rows that have fewer columns than they demand, rising; their demand is cut to that.
    """

    chosen: Indices
    cost: float
    lower_bound: float
    proven: bool
    uncoverable: Indices
    short: Indices


def minimum_cover(
    matrix: spmatrix | ArrayLike,
    time_limit_s: float = 20.0,
    demand: ArrayLike | None = None,
    weights: ArrayLike | None = None,
) -> CoverResult:
    """Chooses the lightest set of columns so that every row is covered as often as it demands.

    Args:
        matrix: Which column covers which row: shape (rows, columns), sparse or dense, anything but
            zero covers.
        time_limit_s: Time for the search by HiGHS [s]; when it ends, the best cover is given with
            the bound proven so far.
        demand: Whole number of columns needed by each row, shape (rows,); None = 1 each. Cut to the
            number of columns that a row has.
        weights: Weight of each column, shape (columns,), above zero; None = 1 each.

    Returns:
        The cover. The same input gives the same answer as long as the time limit is not met.

    Raises:
        InputError: Wrong shapes, numbers that are not finite, a weight of zero or less, a demand
            that is negative or no whole number, or no time.
    """
    covers = _as_matrix(matrix)
    asked = _as_demand(demand, covers.shape[0])
    cost = _as_weights(weights, covers.shape[1])
    if not time_limit_s > 0.0:
        raise InputError(f"a time limit above 0 s is accepted, found {time_limit_s}")
    available = np.diff(covers.indptr).astype(np.int64)
    left = reduce(covers, np.minimum(asked, available), cost)
    found, bound = _solve(left, cost[left.columns], time_limit_s)
    chosen = np.sort(np.concatenate([left.forced, left.columns[found]]))
    total = float(cost[chosen].sum())
    bound = min(bound + float(cost[left.forced].sum()), total)
    return CoverResult(
        chosen,
        total,
        bound,
        total - bound <= _TOLERANCE * max(1.0, total),
        np.flatnonzero((available == 0) & (asked > 0)),
        np.flatnonzero(available < asked),
    )


def _solve(left: Reduction, weights: Array, time_limit_s: float) -> tuple[Indices, float]:
    """Returns the columns chosen of those left, and a bound on their weight."""
    if not len(left.rows):
        return np.zeros(0, dtype=np.int64), 0.0
    start = time.monotonic()
    whole = bool(np.all(weights == np.round(weights)))
    relaxed = linprog(
        weights, A_ub=-left.matrix, b_ub=-left.demand, bounds=(0.0, 1.0), method="highs"
    )
    value = float(relaxed.fun) if relaxed.status == 0 else 0.0
    bound = _up(value, whole)
    share = relaxed.x if relaxed.status == 0 else np.ones(len(weights))
    best = best_greedy(left.matrix, left.demand, weights, _guides(share), bound)
    upper = float(weights[best].sum())
    if upper - bound <= _TOLERANCE * max(1.0, upper):
        return best, upper
    goal = upper - 1.0 if whole else upper * (1.0 - _TOLERANCE)
    # A better cover can hold no column that costs the relaxation more than there is to gain.
    extra = relaxed.lower.marginals if relaxed.status == 0 else np.zeros(len(weights))
    kept = np.flatnonzero(value + extra <= goal + _TOLERANCE * max(1.0, upper))
    remaining = max(0.1, time_limit_s - (time.monotonic() - start))
    better, proven = _improve(left, weights, kept, goal, remaining)
    _LOG.debug("cover of %s: greedy %g, relaxed %g", left.matrix.shape, upper, value)
    if better is not None:
        best, upper = better, float(weights[better].sum())
    return best, max(bound, _up(min(proven, upper), whole))


def _improve(
    left: Reduction, weights: Array, kept: Indices, goal: float, time_limit_s: float
) -> tuple[Indices | None, float]:
    """Asks for a cover that weighs at most ``goal``, of kept columns; and a bound of any cover."""
    part = left.matrix[:, kept]
    if np.any(np.diff(part.indptr) < left.demand):
        return None, np.inf
    answer = milp(
        weights[kept],
        constraints=[
            LinearConstraint(part, lb=left.demand),
            LinearConstraint(weights[kept][None], ub=goal),
        ],
        integrality=np.ones(len(kept)),
        bounds=(0, 1),
        options={"time_limit": time_limit_s, "mip_rel_gap": 0.0},
    )
    if answer.status == 2:  # no better cover
        return None, np.inf
    # What is not kept belongs to no cover up to the goal, so the bound of the rest holds for all.
    bound = answer.mip_dual_bound
    proven = float(bound) if bound is not None and np.isfinite(bound) else 0.0
    if answer.x is None:
        return None, proven
    return kept[np.round(answer.x) > 0], proven


def _guides(share: Array) -> list[Array]:
    """Factors on the gain: none, the relaxation's, and that one with some noise."""
    noise = np.random.default_rng(0)
    guides = [np.ones(len(share)), 0.02 + share]
    guides += [
        (0.02 + share) * noise.uniform(0.7, 1.3, len(share)) for _ in range(_GUIDES - len(guides))
    ]
    return guides


def _up(value: float, whole: bool) -> float:
    return float(np.ceil(value - 1e-5)) if whole and np.isfinite(value) else value


def _as_matrix(matrix: spmatrix | ArrayLike) -> csr_matrix:
    if not issparse(matrix):
        matrix = np.asarray(matrix)
        if matrix.ndim != 2:
            raise InputError(
                f"a cover matrix of shape (rows, columns) is accepted, found {matrix.shape}"
            )
    result = csr_matrix(matrix, dtype=float, copy=True)
    if not np.all(np.isfinite(result.data)):
        raise InputError("a cover matrix of finite numbers is accepted, found NaN or infinity")
    result.sum_duplicates()
    result.data = (result.data != 0.0).astype(float)
    result.eliminate_zeros()
    result.sort_indices()
    return result


def _as_demand(demand: ArrayLike | None, rows: int) -> Indices:
    values = np.ones(rows) if demand is None else np.asarray(demand, dtype=float)
    if (
        values.shape != (rows,)
        or not np.all(np.isfinite(values))
        or np.any(values < 0.0)
        or np.any(values != np.round(values))
    ):
        raise InputError(
            f"a demand of shape ({rows},) of whole numbers of at least 0 is accepted, found shape "
            f"{values.shape}"
        )
    return values.astype(np.int64)


def _as_weights(weights: ArrayLike | None, columns: int) -> Array:
    values = np.ones(columns) if weights is None else np.asarray(weights, dtype=float)
    if values.shape != (columns,) or not np.all(np.isfinite(values)) or np.any(values <= 0.0):
        raise InputError(
            f"weights of shape ({columns},), finite and above 0, are accepted, found shape "
            f"{values.shape}"
        )
    return values
