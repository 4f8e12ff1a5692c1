"""In which order points are visited, and which option of each is taken."""

import numpy as np
from numpy.typing import NDArray

from skinplan.transforms import Array

_APART_M = 1e3  # distance that pairs kept apart are given


def visit_order(
    points: Array,
    which: NDArray[np.int64],
    group: NDArray[np.int64],
    apart: set[tuple[int, int]],
) -> NDArray[np.int64]:
    """Order of visit: group by group, in each nearest first, ties by number.

    Args:
        points: All points, shape (n, 3) [m].
        which: Points to be visited, shape (p,).
        group: Group of each point, shape (n,).
        apart: Pairs (smaller, larger number) that do not follow one another while others are left.

    Returns:
        The points in order, shape (p,); each group begins at its least y.
    """
    parts = []
    for number in np.unique(group[which]):
        mine = which[group[which] == number]
        places = points[mine]
        gaps = np.round(np.linalg.norm(places[:, None] - places[None], axis=2), 6)
        for a, b in apart:
            rows = np.flatnonzero((mine == a) | (mine == b))
            if len(rows) == 2:
                gaps[rows[0], rows[1]] = gaps[rows[1], rows[0]] = _APART_M
        parts.append(mine[_nearest_first(gaps, int(np.lexsort((places[:, 2], places[:, 1]))[0]))])
    return np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)


def _nearest_first(gaps: Array, start: int) -> NDArray[np.int64]:
    left = np.ones(len(gaps), dtype=bool)
    order = [start]
    left[start] = False
    while left.any():
        order.append(int(np.argmin(np.where(left, gaps[order[-1]], np.inf))))
        left[order[-1]] = False
    return np.array(order, dtype=np.int64)


def joint_distances(first: Array, second: Array) -> Array:
    """Largest joint turn and a tenth of their sum between pairs, (a, 6), (b, 6) [rad], (a, b)."""
    gaps = np.abs(first[:, None] - second[None])
    return np.asarray(gaps.max(axis=2) + 0.1 * gaps.sum(axis=2))


def cheapest(layers: list[NDArray[np.int64]], steps: list[Array], cost: Array) -> NDArray[np.int64]:
    """The least sum of costs with one node of each layer (Viterbi), shape (layers,)."""
    if not layers:
        return np.zeros(0, dtype=np.int64)
    total = cost[layers[0]]
    back = []
    for layer, step in zip(layers[1:], steps, strict=True):
        sums = total[:, None] + step
        back.append(np.argmin(sums, axis=0))
        total = sums.min(axis=0) + cost[layer]
    at = int(np.argmin(total))
    chosen = [at]
    for pointers in reversed(back):
        at = int(pointers[at])
        chosen.append(at)
    return np.array([layer[k] for layer, k in zip(layers, chosen[::-1], strict=True)])
