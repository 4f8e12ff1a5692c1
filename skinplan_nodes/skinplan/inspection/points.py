"""Clouds as they are given: checked, thinned out, and what makes their figures robust."""

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import InputError, NoCloudError
from skinplan.transforms import Array

#: Tukey's constant for 95 % efficiency with Gaussian noise.
TUKEY = 4.685
#: From the median absolute deviation to sigma.
SIGMA_OF_MAD = 1.4826
#: Fewer points are laid on no surface.
FEWEST = 30


def checked_points(points: Array) -> Array:
    """Returns points as float array of shape (n, 3).

    Raises:
        InputError: Another shape, or values that are not finite.
    """
    cloud = np.asarray(points, dtype=float)
    if cloud.ndim != 2 or cloud.shape[1] != 3:
        raise InputError(f"points: shape (n, 3) is accepted, found {cloud.shape}")
    bad = int(np.count_nonzero(~np.isfinite(cloud).all(axis=1)))
    if bad:
        raise InputError(
            f"points: finite coordinates are accepted, {bad} of {len(cloud)} points have others"
        )
    return cloud


def enough_points(points: Array) -> Array:
    """Returns points, as `checked_points`, that a part can be laid on.

    Raises:
        InputError: As there.
        NoCloudError: There are too few.
    """
    cloud = checked_points(points)
    if len(cloud) < FEWEST:
        raise NoCloudError(
            f"an alignment was asked for; at least {FEWEST} points are accepted, found {len(cloud)}"
        )
    return cloud


def evenly(count: int, most: int) -> NDArray[np.int64]:
    """Returns at most `most` indices spread evenly over range(count)."""
    if count <= most:
        return np.arange(count)
    return np.linspace(0, count - 1, most).astype(np.int64)
