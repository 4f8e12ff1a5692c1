"""The ladder graph: one layer of states per point, the least-cost way through all layers.

Two kinds of edges join neighbouring layers: straight (the scan goes on) and break (stop, transit).
All of them begin as possible, with an estimate of their time; whoever drives the search corrects
those that turn out otherwise and solves again, so that only edges near the best way are ever
checked (lazy evaluation).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.transforms import Array

STRAIGHT = 0
BREAK = 1

Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Solution:
    """The least-cost way.

    Attributes:
        states: State in each layer, shape (l,).
        kinds: STRAIGHT or BREAK of each edge, shape (l - 1,).
        cost_s: Its cost [s].
    """

    states: Indices
    kinds: Indices
    cost_s: float


class Ladder:
    """Layers of states with the costs between them."""

    def __init__(
        self, states_s: list[Array], straight_s: list[Array], break_s: list[Array]
    ) -> None:
        """Makes the graph of l layers.

        Args:
            states_s: Cost of each state of each layer, l arrays of shape (s_i,) [s].
            straight_s: Cost of straight edges, l - 1 arrays of shape (s_i, s_i+1) [s]; inf = none.
            break_s: Cost of breaks, as ``straight_s``.
        """
        self._states = states_s
        self._costs = (straight_s, break_s)
        self._least = [np.minimum(a, b) for a, b in zip(straight_s, break_s, strict=True)]

    def set_cost(self, kind: int, layer: int, state: int, following: int, cost_s: float) -> None:
        """Corrects the cost of an edge; inf = it is impossible."""
        self._costs[kind][layer][state, following] = cost_s
        other = float(self._costs[1 - kind][layer][state, following])
        self._least[layer][state, following] = min(cost_s, other)

    def solve(self) -> Solution | int:
        """Finds the least-cost way.

        Returns:
            The way; or the number of the first layer that can't be reached.
        """
        ahead = self._forward()
        for layer, cost in enumerate(ahead):
            if not np.any(np.isfinite(cost)):
                return layer
        states = [int(np.argmin(ahead[-1]))]
        for layer in range(len(ahead) - 2, -1, -1):
            states.append(int(np.argmin(ahead[layer] + self._least[layer][:, states[-1]])))
        states.reverse()
        straight, stop = self._costs
        kinds = [
            STRAIGHT if straight[i][a, b] <= stop[i][a, b] else BREAK
            for i, (a, b) in enumerate(zip(states, states[1:], strict=False))
        ]
        return Solution(
            np.array(states, dtype=np.int64),
            np.array(kinds, dtype=np.int64),
            float(ahead[-1].min()),
        )

    def best_edges(self, kind: int, counts: dict[int, int]) -> list[tuple[int, Indices]]:
        """Returns the edges that promise most, of one kind.

        Args:
            kind: STRAIGHT or BREAK.
            counts: How many by the layer that they begin in.

        Returns:
            For each layer its number and pairs of states, shape (k <= count, 2), by the cost of the
            best way through each of them.
        """
        ahead, behind = self._forward(), self._backward()
        result = []
        for layer, count in counts.items():
            through = ahead[layer][:, None] + self._costs[kind][layer] + behind[layer + 1][None]
            flat = through.ravel()
            some = min(count, flat.size)
            best = np.argpartition(flat, some - 1)[:some]
            best = best[np.isfinite(flat[best])]
            best = best[np.lexsort((best, np.round(flat[best], 9)))]
            result.append((layer, np.stack(np.unravel_index(best, through.shape), axis=1)))
        return result

    def _forward(self) -> list[Array]:
        """Least cost of the ways to each state, the state's own cost included."""
        result = [self._states[0]]
        for layer, own in enumerate(self._states[1:]):
            result.append((result[-1][:, None] + self._least[layer]).min(axis=0) + own)
        return result

    def _backward(self) -> list[Array]:
        """Least cost of the ways from each state on, the state's own cost included."""
        result = [self._states[-1]]
        for layer in range(len(self._states) - 2, -1, -1):
            way = (self._least[layer] + result[-1][None]).min(axis=1)
            result.append(way + self._states[layer])
        return result[::-1]
