"""Open paths through all nodes with fixed ends: length, a first one, and local improvement."""

import numpy as np

from skinplan.errors import InputError
from skinplan.trajectory.visit import Indices
from skinplan.transforms import Array

_SEGMENT = 3  # or-opt moves up to so many nodes together, as it is commonly done
_GAIN = 1e-12  # smaller gains, as shares of the mean distance, are rounding


def require_distances(distances: Array) -> Array:
    """Returns distances between nodes as an array of shape (n, n).

    Raises:
        InputError: No square matrix of finite numbers from 0 on, not symmetric, or no node at all.
    """
    result = np.asarray(distances, dtype=float)
    if result.ndim != 2 or result.shape[0] != result.shape[1] or not len(result):
        raise InputError(
            f"distances of at least one node, shape (n, n), are accepted, found {result.shape}"
        )
    if not np.isfinite(result).all():
        raise InputError("finite distances are accepted, found NaN or infinite values")
    if result.min() < 0.0:
        raise InputError(f"distances from 0 on are accepted, found {result.min():g}")
    if not np.allclose(result, result.T, rtol=1e-9, atol=1e-12):
        raise InputError(
            "distances that are the same both ways are accepted, found "
            f"{np.abs(result - result.T).max():g} between the two ways"
        )
    return result


def path_length(distances: Array, orders: Indices) -> Array:
    """Returns the lengths of paths, shape (...), of node numbers, shape (..., n)."""
    return np.asarray(distances[orders[..., :-1], orders[..., 1:]].sum(axis=-1))


def nearest_path(distances: Array, start: int, end: int) -> Indices:
    """Goes from ``start`` always to the nearest node left, to ``end`` last, shape (n,)."""
    left = np.ones(len(distances), dtype=bool)
    left[[start, end]] = False
    order = [start]
    while left.any():
        order.append(int(np.argmin(np.where(left, distances[order[-1]], np.inf))))
        left[order[-1]] = False
    if end != start:
        order.append(end)
    return np.array(order, dtype=np.int64)


def improved_path(distances: Array, order: Indices, moves: int = 1000) -> Indices:
    """Shortens a path by 2-opt and or-opt, its first and last node fixed.

    The best of all reversals of a part and of all displacements of up to three nodes is made, until
    none shortens the path: the result is never longer than what was given.

    Args:
        distances: Symmetric, shape (n, n).
        order: Node numbers, shape (n,).
        moves: At most so many moves are made.

    Returns:
        Node numbers, shape (n,).
    """
    order = np.array(order, dtype=np.int64)
    least = _GAIN * float(distances.mean()) if len(distances) else 0.0
    for _ in range(moves):
        gain, better = max(_best_reversal(distances, order), _best_shift(distances, order), key=_of)
        if better is None or gain <= least:
            break
        order = better
    return order


def _of(move: tuple[float, Indices | None]) -> float:
    return move[0]


def _best_reversal(distances: Array, order: Indices) -> tuple[float, Indices | None]:
    """The reversal of nodes i..j between the ends that gains most (2-opt)."""
    if len(order) < 4:
        return 0.0, None
    along = distances[order[:, None], order[None, :]]
    steps = np.diagonal(along, 1)
    # Rows: i = 1..n-2, columns: j = 1..n-2.
    gains = steps[:-1, None] + steps[None, 1:] - along[:-2, 1:-1] - along[1:-1, 2:]
    gains = np.where(np.triu(np.ones_like(gains, dtype=bool), 1), gains, -np.inf)
    i, j = np.unravel_index(int(np.argmax(gains)), gains.shape)
    better = order.copy()
    better[i + 1 : j + 2] = order[i + 1 : j + 2][::-1]
    return float(gains[i, j]), better


def _best_shift(distances: Array, order: Indices) -> tuple[float, Indices | None]:
    """The displacement of up to three nodes to between two others that gains most (or-opt)."""
    along = distances[order[:, None], order[None, :]]
    best: tuple[float, Indices | None] = (0.0, None)
    for length in range(1, min(_SEGMENT, len(order) - 3) + 1):
        first = np.arange(1, len(order) - length)  # of the nodes that move
        last = first + length - 1
        freed = along[first - 1, first] + along[last, last + 1] - along[first - 1, last + 1]
        gap = np.arange(len(order) - 1)  # they go between gap and gap + 1
        apart = (gap[None, :] < first[:, None] - 1) | (gap[None, :] > last[:, None])
        link = along[gap, gap + 1]
        for flip in (False, True):
            head, tail = (last, first) if flip else (first, last)
            paid = along[gap[None, :], head[:, None]] + along[tail[:, None], gap[None, :] + 1]
            gains = np.where(apart, freed[:, None] - paid + link[None, :], -np.inf)
            i, k = np.unravel_index(int(np.argmax(gains)), gains.shape)
            if gains[i, k] > best[0]:
                best = (float(gains[i, k]), _shifted(order, int(first[i]), length, int(k), flip))
    return best


def _shifted(order: Indices, first: int, length: int, gap: int, flip: bool) -> Indices:
    moved = order[first : first + length]
    rest = np.delete(order, slice(first, first + length))
    place = gap + 1 if gap < first else gap + 1 - length
    return np.insert(rest, place, moved[::-1] if flip else moved)
