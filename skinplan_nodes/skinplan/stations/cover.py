"""Eq (6) to its optimum over the candidates, by mixed-integer programming (HiGHS), with the proof.

Eq (6) has no term for the number of stations and its lambda mixes points and metres. It is solved
lexicographically: most points covered, then fewest stations, then least D + P. The neighbour of a
station is the next one along the heading; a single station has D = P = 0, and P = 0 as all
candidates have the same heading.
"""

import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import LinearConstraint, milp
from scipy.sparse import coo_matrix, csr_matrix, hstack

from skinplan.errors import NoCandidatesError
from skinplan.transforms import Array

WANTED_SPACING_RATIO = 0.9  # w of eq (6), in lengths of the rectangle
_TIME_LIMIT_S = 20.0
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Choice:
    """The chosen candidates.

    Attributes:
        chosen: Numbers of the candidates, rising along the heading, shape (k,).
        lower_bound: Proven least number that covers as much.
        proven: No smaller set covers as much.
        deviation_m: The sum of D + P [m].
    """

    chosen: NDArray[np.int64]
    lower_bound: int
    proven: bool
    deviation_m: float


def choose(covers: NDArray[np.bool_], places: Array, wanted_m: float) -> Choice:
    """Chooses candidates by eq (6).

    Args:
        covers: Which candidate covers which point, shape (c, n).
        places: Middles of the candidates, rising along the heading in their first column, shape (c,
            2) [m].
        wanted_m: w, the wanted spacing of neighbours [m].

    Raises:
        NoCandidatesError: There are no candidates, or they cover nothing.
    """
    coverable = covers.any(axis=0)
    if not len(covers) or not coverable.any():
        raise NoCandidatesError(
            "no station can be chosen: there is no candidate that covers any point"
        )
    matrix = _distinct_columns(covers[:, coverable])
    found = milp(
        np.ones(len(covers)),
        constraints=LinearConstraint(matrix.T, lb=1.0),
        integrality=np.ones(len(covers)),
        bounds=(0, 1),
        options={"time_limit": _TIME_LIMIT_S},
    )
    if found.x is None:
        picked = _greedy(matrix)
        return Choice(picked, 1, False, deviation(places[picked], wanted_m))
    count = int(np.round(found.x).sum())
    bound = int(np.ceil(found.mip_dual_bound - 1e-6))
    picked = np.flatnonzero(np.round(found.x) > 0)
    picked = _least_deviation(matrix, places, wanted_m, count, picked)
    _LOG.debug("%d of %d candidates, at least %d needed", count, len(covers), bound)
    return Choice(picked, bound, found.status == 0, deviation(places[picked], wanted_m))


def deviation(places: Array, wanted_m: float) -> float:
    """Returns the sum of D(s_i), middles (k, 2) [m]; the last one's neighbour is before it."""
    if len(places) < 2:
        return 0.0
    gaps = np.abs(np.linalg.norm(np.diff(places, axis=0), axis=1) - wanted_m)
    return float(gaps.sum() + gaps[-1])


def _least_deviation(
    matrix: csr_matrix, places: Array, wanted_m: float, count: int, fallback: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Among all sets of ``count`` candidates that cover all points the one with the least sum of D.

    A set is a path from a source over its members, in their order, to a sink: one flow variable per
    ordered pair (`chains`).
    """
    size = len(places)
    if count < 2:
        return _most_central(matrix, places)
    gap, constraints = chains(places, wanted_m)
    pairs = len(gap)
    cost = np.concatenate([np.zeros(size), gap, np.zeros(2 * size), gap])
    covered = hstack([matrix.T, csr_matrix((matrix.shape[1], 2 * pairs + 2 * size))])
    total = csr_matrix(np.concatenate([np.ones(size), np.zeros(2 * pairs + 2 * size)])[None])
    constraints += [
        LinearConstraint(covered, 1.0, np.inf),
        LinearConstraint(total, count, count),
    ]
    integrality = np.concatenate([np.ones(size), np.zeros(2 * pairs + 2 * size)])
    options = {"time_limit": _TIME_LIMIT_S}
    found = milp(
        cost, constraints=constraints, integrality=integrality, bounds=(0, 1), options=options
    )
    if found.x is None:
        _LOG.warning("spacing of %d stations not optimised: %s", count, found.message)
        return fallback
    return np.flatnonzero(np.round(found.x[:size]) > 0)


def chains(places: Array, wanted_m: float) -> tuple[Array, list[LinearConstraint]]:
    """Makes the constraints that join two or more chosen candidates, in order, to a chain.

    Args:
        places: Middles of the candidates, rising along the heading, shape (c, 2) [m].
        wanted_m: w, the wanted spacing of neighbours [m].

    Returns:
        The deviation of every ordered pair from w, shape (p,) [m], and constraints on the variables
        chosen (c), pair of neighbours (p), first (c), last (c), last pair (p).
    """
    size = len(places)
    a, b = np.triu_indices(size, 1)
    gap = np.abs(np.linalg.norm(places[b] - places[a], axis=1) - wanted_m)
    pairs = len(a)
    out_of, into = _incidence(a, size), _incidence(b, size)
    one, none_p, none_c = _eye(size), csr_matrix((size, pairs)), csr_matrix((size, size))
    leaves = hstack([-one, out_of, none_c, one, none_p])
    enters = hstack([-one, into, one, none_c, none_p])
    ends = hstack([none_c, none_p, none_c, -one, into])
    last_is_used = hstack(
        [csr_matrix((pairs, size)), -_eye(pairs), csr_matrix((pairs, 2 * size)), _eye(pairs)]
    )
    starts = csr_matrix(
        np.concatenate([np.zeros(size + pairs), np.ones(size), np.zeros(size + pairs)])[None]
    )
    return gap, [
        LinearConstraint(leaves, 0.0, 0.0),
        LinearConstraint(enters, 0.0, 0.0),
        LinearConstraint(ends, 0.0, 0.0),
        LinearConstraint(last_is_used, -np.inf, 0.0),
        LinearConstraint(starts, 1.0, 1.0),
    ]


def _most_central(matrix: csr_matrix, places: Array) -> NDArray[np.int64]:
    """Of the candidates that cover everything alone the one in the middle of all of them."""
    whole = np.flatnonzero(np.asarray(matrix.sum(axis=1)).ravel() >= matrix.shape[1])
    gaps = np.linalg.norm(places[whole] - places[whole].mean(axis=0), axis=1)
    return whole[[int(np.argmin(np.round(gaps, 9)))]]


def _distinct_columns(covers: NDArray[np.bool_]) -> csr_matrix:
    """Points that the same candidates cover make the same constraint: one of each is kept."""
    return csr_matrix(np.unique(covers, axis=1).astype(float))


def _greedy(matrix: csr_matrix) -> NDArray[np.int64]:
    left = np.ones(matrix.shape[1])
    picked: list[int] = []
    while left.any():
        picked.append(int(np.argmax(matrix @ left)))
        left[matrix[picked[-1]].indices] = 0.0
    return np.array(sorted(picked), dtype=np.int64)


def _incidence(nodes: NDArray[np.int64], size: int) -> csr_matrix:
    return coo_matrix(
        (np.ones(len(nodes)), (nodes, np.arange(len(nodes)))), shape=(size, len(nodes))
    ).tocsr()


def _eye(size: int) -> csr_matrix:
    return csr_matrix((np.ones(size), (np.arange(size), np.arange(size))), shape=(size, size))
