"""Which station scans which point: one that really reaches it, contiguous, balanced."""

import numpy as np
from numpy.typing import NDArray

from skinplan.transforms import Array


def assign(reaches: NDArray[np.bool_], places: Array, along: Array) -> NDArray[np.int64]:
    """Gives every point to a station that reaches it.

    The part is cut between neighbouring stations where both sides get equally many of the points in
    question; a point goes to the station of its piece, or, if that does not reach it, to the
    nearest one along the part that does.

    Args:
        reaches: Which station reaches which point, shape (k, n).
        places: Places of the stations along the part, rising, shape (k,) [m].
        along: Places of the points along the part, shape (n,) [m].

    Returns:
        Station of each point, -1 where none reaches it, shape (n,).
    """
    result = np.full(len(along), -1, dtype=np.int64)
    reached = reaches.any(axis=0)
    if not reached.any():
        return result
    wanted = np.searchsorted(_cuts(reaches, along), along, side="right")
    gaps = np.abs(places[:, None] - along[None])
    gaps[~reaches] = np.inf
    nearest = np.argmin(gaps, axis=0)
    own = reaches[np.minimum(wanted, len(places) - 1), np.arange(len(along))]
    result[reached] = np.where(own, wanted, nearest)[reached]
    return result


def _cuts(reaches: NDArray[np.bool_], along: Array) -> Array:
    """Cuts between neighbours, as near to equal shares as the zones that both reach allow."""
    count = len(reaches)
    order = np.sort(along[reaches.any(axis=0)])
    cuts = []
    for station in range(count - 1):
        equal = order[min(len(order) - 1, len(order) * (station + 1) // count)]
        both = along[reaches[station] & reaches[station + 1]]
        if len(both):
            # Away from the ends of the zone, so that neither station works at the rim of its reach.
            low, high = np.quantile(both, (0.25, 0.75))
            equal = float(np.clip(equal, low, high))
        cuts.append(equal)
    return np.maximum.accumulate(np.array(cuts)) if cuts else np.zeros(0)
