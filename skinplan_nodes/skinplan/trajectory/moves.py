"""Local search on open tours with fixed ends: 2-opt and or-opt moves, with a price for turns."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.transforms import Array

Indices = NDArray[np.int64]

_LONGEST = 3  # longest piece that or-opt moves
_TRIED = 24  # moves of each round that are looked at exactly
_SLACK = 0.2  # a move may look so much worse without turns and is still looked at exactly
_GAIN = 1e-9


@dataclass(frozen=True, eq=False)
class Tour:
    """An order of nodes, its ends fixed.

    Attributes:
        order: Nodes, shape (n,).
        cost: Sum of edges and turns.
    """

    order: Indices
    cost: float


def tour_costs(orders: Indices, cost: Array, turns: Array) -> Array:
    """Returns the costs of orders, shape (k, n) -> (k,).

    Args:
        orders: Nodes.
        cost: Cost of edges, shape (n, n).
        turns: Cost of going from a by b to c, shape (n, n, n).
    """
    edges = cost[orders[:, :-1], orders[:, 1:]].sum(axis=1)
    return np.asarray(edges + turns[orders[:, :-2], orders[:, 1:-1], orders[:, 2:]].sum(axis=1))


def improved(order: Indices, cost: Array, turns: Array) -> tuple[Tour, float]:
    """Improves an order until no move helps.

    Args:
        order: Nodes; the first and the last stay, shape (n,).
        cost: Cost of edges, symmetric but for those of the ends, shape (n, n).
        turns: Cost of turns, shape (n, n, n).

    Returns:
        The tour, and how many moves were looked at.
    """
    best = Tour(order, float(tour_costs(order[None], cost, turns)[0]))
    looked_at = 0.0
    while len(order) > 3:
        gains, moves = _candidates(best.order, cost)
        looked_at += len(gains)
        promising = np.argsort(np.round(gains, 9), kind="stable")[:_TRIED]
        promising = promising[gains[promising] < _SLACK]
        if not len(promising):
            break
        tried = np.stack([_moved(best.order, moves[i]) for i in promising])
        costs = np.round(tour_costs(tried, cost, turns), 9)
        chosen = int(np.argmin(costs))
        if costs[chosen] >= best.cost - _GAIN:
            break
        best = Tour(tried[chosen], float(costs[chosen]))
    return best, looked_at


def kicked(order: Indices, random: np.random.Generator) -> Indices:
    """Returns an order with two neighbouring pieces swapped (a double bridge), ends kept.

    There are at least two nodes between the ends.
    """
    inner = len(order) - 2
    longest = min(inner // 2, max(2, inner // 3), 25)
    first, second = random.integers(1, longest + 1, 2)
    begin = int(random.integers(1, inner - first - second + 2))
    middle, end = begin + first, begin + first + second
    return np.concatenate([order[:begin], order[middle:end], order[begin:middle], order[end:]])


def _candidates(order: Indices, cost: Array) -> tuple[Array, Indices]:
    """What moves change without turns, shape (m,), and the moves (kind, i, j, place), (m, 4)."""
    gains, moves = zip(_two_opt(order, cost), *_or_opt(order, cost), strict=True)
    return np.concatenate(gains), np.concatenate(moves)


def _two_opt(order: Indices, cost: Array) -> tuple[Array, Indices]:
    """Turning the piece from place i to j around."""
    n = len(order)
    i, j = np.triu_indices(n - 2, 1)
    i, j = i + 1, j + 1
    before, first, last, after = order[i - 1], order[i], order[j], order[j + 1]
    gain = cost[before, last] + cost[first, after] - cost[before, first] - cost[last, after]
    return gain, np.stack([np.zeros_like(i), i, j, j], axis=1)


def _or_opt(order: Indices, cost: Array) -> list[tuple[Array, Indices]]:
    """Moving the piece from place i to j behind another place, as it is (1) or turned (2)."""
    n = len(order)
    result = []
    for length in range(1, min(_LONGEST, n - 3) + 1):
        i, place = np.meshgrid(np.arange(1, n - length), np.arange(n - 1), indexing="ij")
        keep = (place < i - 1) | (place > i + length - 1)
        i, place = i[keep], place[keep]
        j = i + length - 1
        first, last = order[i], order[j]
        before, after = order[i - 1], order[j + 1]
        left, right = order[place], order[place + 1]
        out = cost[before, after] - cost[before, first] - cost[last, after] - cost[left, right]
        for kind, (a, b) in ((1, (first, last)), (2, (last, first))):
            gain = out + cost[left, a] + cost[b, right]
            result.append((gain, np.stack([np.full_like(i, kind), i, j, place], axis=1)))
    return result


def _moved(order: Indices, move: Indices) -> Indices:
    kind, i, j, place = move.tolist()
    piece = order[i : j + 1]
    if kind == 0:
        return np.concatenate([order[:i], piece[::-1], order[j + 1 :]])
    rest = np.concatenate([order[:i], order[j + 1 :]])
    at = place + 1 if place < i else place + 1 - len(piece)
    return np.concatenate([rest[:at], piece if kind == 1 else piece[::-1], rest[at:]])
