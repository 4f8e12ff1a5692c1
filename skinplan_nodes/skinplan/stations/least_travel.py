"""Of all smallest sets of stations the one with least travel and most margin."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from skinplan.cover.reduce import needed_rows
from skinplan.transforms import Array

_STEPS = 2.0e10  # multiplications that looking through all triples may cost
_ROUNDS = 20

Indices = NDArray[np.int64]


class _Search:
    """All sets of up to three candidates that cover what is asked for."""

    def __init__(self, covers: NDArray[np.bool_], places: Array, margins: Array) -> None:
        self.covers = covers
        self._misses = (~covers).astype(np.float32)
        self._places, self._loss = places, 1.0 - margins

    def cost(self, chosen: Indices) -> float:
        """The way from the first to the last station, and what they lack in margin."""
        return float(np.ptp(self._places[chosen]) + self._loss[chosen].sum())

    def best(self, needed: NDArray[np.bool_], count: int, fixed: Indices) -> Indices | None:
        """Adds ``count`` candidates to fixed ones so that the cost is least; None = impossible."""
        if not needed.any():
            return fixed
        row = np.flatnonzero(needed)[np.argmin(self.covers[:, needed].sum(axis=0))]
        columns = np.flatnonzero(self.covers[:, row])
        if count <= 2:
            return self._last(needed, count, columns, fixed)
        found, least = None, np.inf
        for column in columns:
            rest = needed & ~self.covers[column]
            answer = self.best(rest, count - 1, np.append(fixed, column))
            if answer is not None and self.cost(answer) < least - 1e-9:
                found, least = answer, self.cost(answer)
        return found

    def _last(
        self, needed: NDArray[np.bool_], count: int, columns: Indices, fixed: Indices
    ) -> Indices | None:
        """The last one or two: of the columns of one row, and with each any that does the rest."""
        rest = (needed & ~self.covers[columns]).astype(np.float32)
        if count == 1:
            columns = columns[~rest.any(axis=1)]
            pairs = columns[:, None]
        else:
            first, second = np.nonzero(rest @ self._misses.T < 0.5)
            pairs = np.stack([columns[first], second], axis=1)
        if not len(pairs):
            return None
        places = self._places[pairs]
        low, high = places.min(axis=1), places.max(axis=1)
        if len(fixed):
            low = np.minimum(low, self._places[fixed].min())
            high = np.maximum(high, self._places[fixed].max())
        cost = np.round(high - low + self._loss[pairs].sum(axis=1), 9)
        return np.append(fixed, pairs[np.argmin(cost)])


def least_travel(
    covers: NDArray[np.bool_], chosen: Indices, places: Array, margins: Array
) -> Indices:
    """Chooses no more candidates than ``chosen`` that cover as much, with the least cost.

    The cost is the way along the part from the first to the last station [m] plus one minus the
    margin for each station: a metre of travel weighs as much as all of the margin. Up to three
    stations it is the least of all; more are improved three neighbours at a time (two where there
    are very many candidates) until nothing changes.

    Args:
        covers: Which candidate covers which point, shape (c, n).
        chosen: A smallest set that covers all that can be covered, shape (k,).
        places: Places of the candidates along the part, shape (c,) [m].
        margins: Mean margin of what a candidate reaches, in [0, 1], shape (c,).

    Returns:
        The candidates, in their order along the part, shape (k,).
    """
    points = covers[chosen].any(axis=0)
    if not points.any():
        return chosen
    distinct = np.unique(covers[:, points], axis=1)
    distinct = distinct[:, needed_rows(csr_matrix(distinct.T.astype(float)))]
    search = _Search(distinct, places, margins)
    columns = float(np.sort(distinct.sum(axis=0))[:2].prod())
    size = 3 if columns * distinct.size <= _STEPS else 2
    none = np.zeros(0, dtype=np.int64)
    chosen = _ordered(chosen, places)
    for _ in range(_ROUNDS if len(chosen) > size else 1):
        before = search.cost(chosen)
        for first in range(max(1, len(chosen) - size + 1)):
            free = np.arange(first, min(first + size, len(chosen)))
            fixed = np.delete(chosen, free) if len(chosen) > size else none
            needed = np.asarray(~distinct[fixed].any(axis=0))
            answer = search.best(needed, len(free), fixed)
            if answer is not None and search.cost(answer) < search.cost(chosen) - 1e-9:
                chosen = _ordered(answer, places)
        if search.cost(chosen) > before - 1e-9:
            break
    return chosen


def _ordered(chosen: Indices, places: Array) -> Indices:
    return chosen[np.lexsort((chosen, places[chosen]))]
