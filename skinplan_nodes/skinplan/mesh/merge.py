"""Makes one vertex of those with the same coordinates."""

import numpy as np
from numpy.typing import NDArray

from skinplan.transforms import Array

_FACTORS = (np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB))


def merge_vertices(vertices: Array, faces: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """Makes one vertex of those with exactly the same coordinates.

    Args:
        vertices: shape (v, 3).
        faces: shape (f, 3).

    Returns:
        Vertices in the order of their first use in the file, and the faces that name them.
    """
    plain = np.ascontiguousarray(vertices, dtype=np.float64) + 0.0  # -0.0 is 0.0
    first, group = _groups(_keys(plain))
    if not all(np.array_equal(plain[first, axis][group], plain[:, axis]) for axis in range(3)):
        _, first, group = np.unique(plain, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    return plain[first[order]], rank[group.reshape(-1)[faces]]


def _keys(points: Array) -> NDArray[np.uint64]:
    """Returns one number per point: sorting those is far cheaper than sorting rows.

    Two points may share a number by chance; the caller looks.
    """
    words = points.view(np.uint64)
    keys = np.zeros(len(points), dtype=np.uint64)
    for axis in range(3):
        keys ^= words[:, axis]
        # Numbers that were single precision end in zeros: their high half has to come down before
        # it is multiplied, or most of what tells points apart is lost.
        keys ^= keys >> np.uint64(32)
        keys *= _FACTORS[0]
        keys ^= keys >> np.uint64(29)
        keys *= _FACTORS[1]
    return keys ^ (keys >> np.uint64(32))


def _groups(keys: NDArray[np.uint64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Returns the first place of each different key, and the key's number for each place."""
    order = np.argsort(keys)
    ordered = keys[order]
    fresh = np.empty(len(keys), dtype=bool)
    fresh[:1] = True
    np.not_equal(ordered[1:], ordered[:-1], out=fresh[1:])
    group = np.empty(len(keys), dtype=np.int64)
    group[order] = np.cumsum(fresh) - 1
    starts = np.flatnonzero(fresh)
    # The sort is not stable, so the first place is the least of the group.
    first = np.minimum.reduceat(order, starts) if len(starts) else starts
    return first, group
