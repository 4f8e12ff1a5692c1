"""Rows and columns of a cover problem that can be left out without changing its minimum.

Three rules, repeated until none applies: a row that needs all of its columns forces them; a row is
met whenever another row is that lies inside it and demands no less; a column is never needed where
another one covers all of its rows for no more weight (only where those rows demand one column).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from skinplan.transforms import Array

_ROUNDS = 10
_DENSE_STEPS = 2.0e11  # multiplications of a dense product that a comparison of all pairs may cost
_SPARSE_STEPS = 3.0e8  # the same of a sparse product
_SPARSE_COST = 300.0  # one of a sparse product takes as long as so many of a dense one
_CHUNK = 1024

Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Reduction:
    """What is left of a cover problem.

    Attributes:
        forced: Columns that every optimum may be taken to hold, rising, shape (f,).
        rows: Rows that are left, rising, shape (r,).
        columns: Columns that are left, rising, shape (k,).
        matrix: The rows and columns left, shape (r, k), values 0 and 1.
        demand: How often each row left has still to be covered, shape (r,), all at least 1.
    """

    forced: Indices
    rows: Indices
    columns: Indices
    matrix: csr_matrix
    demand: Indices


def reduce(matrix: csr_matrix, demand: Indices, weights: Array) -> Reduction:
    """Applies the rules until nothing changes.

    Args:
        matrix: Rows to be covered by columns, shape (n, c), values 0 and 1.
        demand: Columns needed by each row, shape (n,), at most as many as it has.
        weights: Weight of each column, shape (c,), above zero.
    """
    rows = np.flatnonzero(demand > 0)
    columns = np.arange(matrix.shape[1])
    demand = demand[rows]
    matrix = matrix[rows]
    forced: list[Indices] = []
    for _ in range(_ROUNDS):
        size = matrix.shape
        must = _forced(matrix, demand)
        if len(must):
            forced.append(columns[must])
            demand = demand - np.asarray(matrix[:, must].sum(axis=1)).ravel().astype(np.int64)
            matrix, columns = _keep_columns(matrix, columns, ~_mask(must, matrix.shape[1]))
            matrix, rows, demand = _keep_rows(matrix, rows, demand, demand > 0)
        for needed in (_distinct_rows, needed_rows):
            matrix, rows, demand = _keep_rows(matrix, rows, demand, needed(matrix, demand))
        kept = _needed_columns(matrix, demand, weights[columns])
        matrix, columns = _keep_columns(matrix, columns, kept)
        if matrix.shape == size:
            break
    chosen = np.sort(np.concatenate(forced)) if forced else np.zeros(0, dtype=np.int64)
    return Reduction(chosen, rows, columns, matrix, demand)


def _keep_rows(
    matrix: csr_matrix, rows: Indices, demand: Indices, kept: NDArray[np.bool_]
) -> tuple[csr_matrix, Indices, Indices]:
    return matrix[kept], rows[kept], demand[kept]


def _keep_columns(
    matrix: csr_matrix, columns: Indices, kept: NDArray[np.bool_]
) -> tuple[csr_matrix, Indices]:
    return matrix[:, np.flatnonzero(kept)], columns[kept]


def _forced(matrix: csr_matrix, demand: Indices) -> Indices:
    tight = np.flatnonzero(np.diff(matrix.indptr) <= demand)
    return np.unique(matrix[tight].indices).astype(np.int64)


def _distinct_rows(matrix: csr_matrix, demand: Indices) -> NDArray[np.bool_]:
    """Of rows with the same columns the first of those that demand most is kept."""
    matrix.sort_indices()
    first: dict[bytes, int] = {}
    order = np.lexsort((np.arange(len(demand)), -demand))
    for row in order.tolist():
        key = matrix.indices[matrix.indptr[row] : matrix.indptr[row + 1]].tobytes()
        first.setdefault(key, row)
    return _mask(np.array(list(first.values()), dtype=np.int64), len(demand))


def needed_rows(matrix: csr_matrix, demand: Indices | None = None) -> NDArray[np.bool_]:
    """Tells which rows no row inside them, of no smaller demand, makes superfluous, shape (n,)."""
    demand = np.ones(matrix.shape[0], dtype=np.int64) if demand is None else demand
    size = np.diff(matrix.indptr)
    index = np.arange(len(size))
    dropped = np.zeros(len(size), dtype=bool)
    for chunk, common in _common(matrix):
        inside = common == size[None, :]  # row of the chunk holds all columns of the other row
        smaller = (size[None, :] < size[chunk, None]) | (index[None, :] < index[chunk, None])
        dropped[chunk] = np.any(inside & smaller & (demand[None, :] >= demand[chunk, None]), axis=1)
    return ~dropped


def _needed_columns(matrix: csr_matrix, demand: Indices, weights: Array) -> NDArray[np.bool_]:
    """Columns that no other one replaces."""
    turned = matrix.T.tocsr()
    size = np.diff(turned.indptr)
    index = np.arange(len(size))
    dropped = size == 0
    # Where a row asks for two columns, a column and the one that replaces it can both be needed.
    single = np.asarray(turned @ (demand > 1).astype(float)).ravel() == 0
    for chunk, common in _common(turned):
        inside = common == size[chunk, None]  # the other column holds all rows of the chunk's
        better = (size[None, :] > size[chunk, None]) | (weights[None, :] < weights[chunk, None])
        better |= index[None, :] < index[chunk, None]
        cheap = weights[None, :] <= weights[chunk, None]
        dropped[chunk] |= single[chunk] & np.any(inside & better & cheap, axis=1)
    return ~dropped


def _common(matrix: csr_matrix) -> Iterator[tuple[Indices, Array]]:
    """Yields chunks of row numbers and how many columns they share with every row.

    Nothing is yielded where comparing all pairs would cost more than it can save; that is judged by
    size alone, so that results do not depend on the machine.
    """
    count, width = matrix.shape
    dense = float(count) ** 2 * width
    sparse = float(np.sum(np.bincount(matrix.indices, minlength=max(width, 1)).astype(float) ** 2))
    by_dense = dense <= sparse * _SPARSE_COST
    if dense > _DENSE_STEPS if by_dense else sparse > _SPARSE_STEPS:
        return
    whole = matrix.astype(np.float32).toarray() if by_dense else matrix
    for start in range(0, count, _CHUNK):
        chunk = np.arange(start, min(start + _CHUNK, count))
        common = whole[chunk] @ whole.T
        yield chunk, common if by_dense else common.toarray()


def _mask(indices: Indices, size: int) -> NDArray[np.bool_]:
    result = np.zeros(size, dtype=bool)
    result[indices] = True
    return result
