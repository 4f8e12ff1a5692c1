"""Eq (6) as it is printed, with its weight lambda: for comparison with the lexicographic choice.

``N(S) + lambda * sum(D(s_i) + P(s_i))`` adds points and metres, so lambda says how many uncovered
points a metre of wrong spacing is worth [1/m]. At lambda = 0 only coverage counts; as lambda grows,
points are given up for even spacing, up to a single station, whose D and P are 0. w is the wanted
spacing of neighbours: 0 draws stations together, a w longer than the part drives them apart. P is
0: all candidates have one heading. Of equal values the set with fewer stations is taken.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import LinearConstraint, milp
from scipy.sparse import csr_matrix, eye_array, hstack

from skinplan.errors import InputError, NoCandidatesError
from skinplan.stations.cover import chains, deviation
from skinplan.transforms import Array

_COUNT_TIE = 1e-6  # a station's weight in the objective: decides among equal values only
_TIME_LIMIT_S = 20.0


def equation_6(
    covers: NDArray[np.bool_],
    places: Array,
    chosen: NDArray[np.int64],
    wanted_m: float,
    weight_per_m: float,
) -> float:
    """Returns the value of eq (6) of a set of candidates with one heading.

    Args:
        covers: Which candidate covers which point, shape (c, n).
        places: Middles of the candidates, rising along the heading, shape (c, 2) [m].
        chosen: The set, rising, shape (k,).
        wanted_m: w [m].
        weight_per_m: lambda [1/m].
    """
    uncovered = int(np.sum(~covers[chosen].any(axis=0)))
    return uncovered + weight_per_m * deviation(places[chosen], wanted_m)


def least_equation_6(
    covers: NDArray[np.bool_], places: Array, wanted_m: float, weight_per_m: float
) -> NDArray[np.int64]:
    """Returns the set with the least value of eq (6), rising, shape (k,).

    Args:
        covers: Which candidate covers which point, shape (c, n).
        places: Middles of the candidates, rising along the heading, shape (c, 2) [m].
        wanted_m: w, at least 0 [m].
        weight_per_m: lambda, at least 0 [1/m].

    Raises:
        InputError: A negative or infinite weight or spacing.
        NoCandidatesError: There is no candidate.
    """
    if not (0.0 <= wanted_m < np.inf and 0.0 <= weight_per_m < np.inf):
        raise InputError(
            f"w and lambda of at least 0 are accepted, found {wanted_m} m and {weight_per_m} 1/m"
        )
    if not len(covers):
        raise NoCandidatesError("no station can be chosen: there is no candidate")
    single = np.array([int(np.argmax(covers.sum(axis=1)))])
    several = _chain(covers, places, wanted_m, weight_per_m) if len(covers) > 1 else None
    if several is None:
        return single
    values = [
        equation_6(covers, places, found, wanted_m, weight_per_m) for found in (single, several)
    ]
    return single if values[0] <= values[1] + 1e-9 else several


def _chain(
    covers: NDArray[np.bool_], places: Array, wanted_m: float, weight_per_m: float
) -> NDArray[np.int64] | None:
    """The best set of two or more."""
    size, points = covers.shape
    gap, joined = chains(places, wanted_m)
    rest = 2 * len(gap) + 2 * size
    # After the variables of the chain: one for each point that is not covered.
    constraints = [
        LinearConstraint(hstack([c.A, csr_matrix((c.A.shape[0], points))]), c.lb, c.ub)
        for c in joined
    ]
    seen = hstack([csr_matrix(covers.T.astype(float)), csr_matrix((points, rest)),
                   eye_array(points)])  # fmt: skip
    total = np.concatenate([np.ones(size), np.zeros(rest + points)])
    constraints += [LinearConstraint(seen, lb=1.0), LinearConstraint(total[None], lb=2.0)]
    spacing = weight_per_m * gap
    found = milp(
        np.concatenate(
            [np.full(size, _COUNT_TIE), spacing, np.zeros(2 * size), spacing, np.ones(points)]
        ),
        constraints=constraints,
        integrality=np.concatenate([np.ones(size), np.zeros(rest + points)]),
        bounds=(0, 1),
        options={"time_limit": _TIME_LIMIT_S, "mip_rel_gap": 0.0},
    )
    return None if found.x is None else np.flatnonzero(np.round(found.x[:size]) > 0)
