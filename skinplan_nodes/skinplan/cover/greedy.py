"""Good covers without proof: the upper bound of `minimum_cover`."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix, csr_matrix

from skinplan.transforms import Array

Indices = NDArray[np.int64]


def greedy_cover(
    matrix: csr_matrix, columns: csc_matrix, demand: Indices, weights: Array, favour: Array
) -> Indices:
    """Takes the column that covers most for its weight, again and again, then drops needless ones.

    Args:
        matrix: Rows to be covered by columns, shape (n, c), values 0 and 1.
        columns: The same matrix by columns.
        demand: Columns needed by each row, shape (n,), at most as many as it has.
        weights: Weight of each column, shape (c,).
        favour: Factor on what a column seems to gain, shape (c,).

    Returns:
        The chosen columns, rising, shape (k,).
    """
    left = demand.astype(np.int64).copy()
    gain = np.asarray((left > 0).astype(float) @ matrix).ravel()
    factor = favour / weights
    taken = np.zeros(matrix.shape[1], dtype=bool)
    picked: list[int] = []
    while np.any(left > 0):
        worth = np.where(taken, -1.0, gain * factor)
        best = int(np.argmax(worth))
        taken[best] = True
        picked.append(best)
        rows = columns.indices[columns.indptr[best] : columns.indptr[best + 1]]
        done = rows[left[rows] == 1]
        left[rows] -= 1
        gain -= np.bincount(matrix[done].indices, minlength=len(gain))
    return _without_needless(columns, demand, weights, picked)


def _without_needless(
    columns: csc_matrix, demand: Indices, weights: Array, picked: list[int]
) -> Indices:
    """Drops columns whose rows are all covered often enough by the rest, heavy ones first."""
    spare = np.asarray(columns[:, picked].sum(axis=1)).ravel().astype(np.int64) - demand
    kept = set(picked)
    for column in sorted(picked, key=lambda c: (-weights[c], c)):
        rows = columns.indices[columns.indptr[column] : columns.indptr[column + 1]]
        if np.all(spare[rows] >= 1):
            spare[rows] -= 1
            kept.remove(column)
    return np.array(sorted(kept), dtype=np.int64)


def best_greedy(
    matrix: csr_matrix, demand: Indices, weights: Array, guides: list[Array], enough: float
) -> Indices:
    """Returns the lightest of several greedy covers; stops at one that weighs ``enough``.

    Args:
        matrix: Rows to be covered by columns, shape (n, c).
        demand: Columns needed by each row, shape (n,).
        weights: Weight of each column, shape (c,).
        guides: Factors on the gain, each of shape (c,).
        enough: A weight that no cover goes below.
    """
    columns = matrix.tocsc()
    best: Indices | None = None
    for guide in guides:
        found = greedy_cover(matrix, columns, demand, weights, guide)
        if best is None or weights[found].sum() < weights[best].sum() - 1e-12:
            best = found
        if weights[best].sum() <= enough + 1e-9:
            break
    return best if best is not None else np.zeros(0, dtype=np.int64)
