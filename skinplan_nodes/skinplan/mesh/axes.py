"""Axes that turn with a part."""

import numpy as np

from skinplan.transforms import Array

# Axes, or ends of an axis, that differ by less (relative) are alike but for rounding.
_ALIKE = 1e-6


def own_axes(places: Array, weights: Array) -> Array | None:
    """Returns the principal axes of points, the longest first, each toward its longer tail.

    Args:
        places: shape (n, 3) [m].
        weights: What each point weighs, shape (n,).

    Returns:
        Right-handed axes as rows, shape (3, 3); None where there are none of its own, because two
        axes or the two ends of one are alike (a square, a rectangle).
    """
    shares = weights / max(float(weights.sum()), 1e-30)
    offsets = places - shares @ places
    spreads, columns = np.linalg.eigh((offsets * shares[:, None]).T @ offsets)
    if np.diff(spreads).min() <= _ALIKE * spreads[2]:
        return None
    # The third axis follows from the other two; along the flattest, tails say least.
    plane = columns[:, [2, 1]]
    along = offsets @ plane
    tails = shares @ (along * along * along) / spreads[2] ** 1.5
    if np.abs(tails).min() < _ALIKE:
        return None
    long, wide = (plane * np.sign(tails)).T
    return np.stack([long, wide, np.cross(long, wide)])
