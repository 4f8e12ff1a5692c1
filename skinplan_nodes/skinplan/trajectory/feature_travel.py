"""Travel through features that are driven one after another, each in one of several ways."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.distance import cdist

from skinplan.trajectory.visit import Indices
from skinplan.transforms import Array

# Ways that are equally long by symmetry differ in their last digits only: the first is taken.
_DECIMALS = 9


class FeatureTravel:
    """Finds the ways through features that make the whole travel shortest, for given orders.

    Args:
        positions: Of all points, shape (n, 3) [m].
        ways: For each feature the ways through it, as point numbers.
        begin: Where the travel comes from, shape (3,) [m]; None = anywhere.
        end: Where it goes to, shape (3,) [m]; None = anywhere.
    """

    def __init__(
        self,
        positions: Array,
        ways: Sequence[Sequence[Indices]],
        begin: Array | None = None,
        end: Array | None = None,
    ) -> None:
        self._ways = ways
        most = max(len(each) for each in ways)
        shape = (len(ways), most)
        # Ways that a feature does not have cost infinitely much.
        self._inside, self._first, self._last = (np.full(shape, np.inf) for _ in range(3))
        ends = np.zeros((2, *shape, 3))
        for number, each in enumerate(ways):
            count = len(each)
            ends[0, number, :count] = positions[[way[0] for way in each]]
            ends[1, number, :count] = positions[[way[-1] for way in each]]
            self._inside[number, :count] = [_length(positions[way]) for way in each]
        self._first = self._inside + (
            0.0 if begin is None else np.linalg.norm(ends[0] - begin, axis=2)
        )
        self._last = np.zeros(shape) if end is None else np.linalg.norm(ends[1] - end, axis=2)
        gaps = cdist(ends[1].reshape(-1, 3), ends[0].reshape(-1, 3))
        self._gaps = gaps.reshape(*shape, *shape).transpose(0, 2, 1, 3)

    def lengths(self, orders: Indices) -> Array:
        """Returns the least travel [m] of orders of all features, shape (c, f), shape (c,)."""
        costs, _ = self._costs(orders)
        return np.asarray(costs.min(axis=1))

    def points(self, order: Indices) -> tuple[Indices, float]:
        """Returns the points in the order of the shortest travel, shape (p,), and its length [m].

        Args:
            order: Numbers of all features, shape (f,).
        """
        costs, chosen = self._costs(order[None])
        pick = int(np.argmin(np.round(costs[0], _DECIMALS)))
        length, picks = float(costs[0, pick]), [pick]
        for choice in reversed(chosen):
            picks.append(int(choice[0, picks[-1]]))
        found = [self._ways[f][way] for f, way in zip(order, reversed(picks), strict=True)]
        return np.concatenate(found), length

    def improved(self, order: Indices, moves: int) -> Indices:
        """Shortens the travel by reversals and displacements, first and last feature fixed.

        The best of all is made each time, until none helps: the travel never gets longer.

        Args:
            order: Numbers of all features, shape (f,).
            moves: At most so many are made.
        """
        length = float(self.lengths(order[None])[0])
        for _ in range(moves if len(order) > 3 else 0):
            others = _neighbours(order)
            lengths = np.round(self.lengths(others), _DECIMALS)
            best = int(np.argmin(lengths))
            if lengths[best] >= length - 10.0**-_DECIMALS:
                break
            order, length = others[best], float(lengths[best])
        return order

    def _costs(self, orders: Indices) -> tuple[Array, list[Indices]]:
        """Least travel up to and with each way of the last feature, and the choices before it."""
        costs = self._first[orders[:, 0]]
        chosen: list[Indices] = []
        for place in range(1, orders.shape[1]):
            before, here = orders[:, place - 1], orders[:, place]
            total = costs[:, :, None] + self._gaps[before, here]
            choice = np.argmin(np.round(total, _DECIMALS), axis=1)
            chosen.append(choice)
            costs = np.take_along_axis(total, choice[:, None], axis=1)[:, 0] + self._inside[here]
        return costs + self._last[orders[:, -1]], chosen


def _neighbours(order: Indices) -> Indices:
    """All orders with one part reversed or one feature displaced, ends fixed, shape (c, f)."""
    result = []
    for i in range(1, len(order) - 1):
        rest = np.delete(order, i)
        result += [np.insert(rest, k, order[i]) for k in range(1, len(rest)) if k != i]
        for j in range(i + 2, len(order)):
            result.append(np.concatenate([order[:i], order[i:j][::-1], order[j:]]))
    return np.array(result)


def _length(places: Array) -> float:
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
