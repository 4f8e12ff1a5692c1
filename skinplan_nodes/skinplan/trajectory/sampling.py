"""Where a motion has to be sampled so that straight lines between the samples are near enough."""

import numpy as np
from numpy.typing import NDArray

from skinplan.transforms import Array

_LONGEST_S = 0.04  # samples also say where the arm is: they are never farther apart


def sample_counts(
    durations: Array, accelerations: Array, levers: Array, deviation_m: float
) -> NDArray[np.int64]:
    """Says into how many intervals segments have to be divided for lines to stay near the motion.

    Between samples a step dt apart a joint is at most ``a dt^2 / 8`` from the line, which moves the
    scanner by at most that times the joint's lever arm; all joints together at most by the sum.

    Args:
        durations: Of the segments, shape (n,) [s].
        accelerations: Largest absolute ones on each segment, shape (n, 6) [rad/s^2].
        levers: Lever arm of each joint, shape (6,) [m].
        deviation_m: Largest distance of the scanner [m].

    Returns:
        Counts, shape (n,).
    """
    way = accelerations @ levers  # [m/s^2]
    step = np.sqrt(8.0 * deviation_m / np.maximum(way, 1e-12))
    counts = np.ceil(durations / np.minimum(step, _LONGEST_S) - 1e-9)
    return np.maximum(counts, 1).astype(np.int64)


def sample_shares(counts: NDArray[np.int64]) -> tuple[NDArray[np.int64], Array]:
    """Divides segments evenly.

    Args:
        counts: Number of intervals of each segment, shape (n,).

    Returns:
        Segment and share of its duration for each sample, in order of time, both of shape (m,):
        the start of each segment, and at last the end of the last one as share 1.
    """
    owner = np.repeat(np.arange(len(counts), dtype=np.int64), counts)
    share = (np.arange(len(owner)) - (np.cumsum(counts) - counts)[owner]) / counts[owner]
    return np.append(owner, len(counts) - 1), np.append(share, 1.0)
