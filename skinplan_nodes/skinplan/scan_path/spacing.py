"""The spacing law (M2.2 eq (4), (5))."""

import numpy as np

from skinplan.errors import InputError
from skinplan.transforms import Array


def equivalent_spacing(
    normals_i: Array, normals_j: Array, interval_m: float, sensitivity: float
) -> Array:
    """Distance that two target points must at least have (M2.2 eq (4)).

    ``d_e = d_interval * cos^k <n_i, n_j>`` for acute angles, 0 for others.

    Args:
        normals_i: Unit normals, shape (..., 3).
        normals_j: Unit normals, shape (..., 3), broadcast against the first.
        interval_m: d_interval of eq (5) [m], > 0.
        sensitivity: Exponent k [1], >= 0.

    Returns:
        d_e, shape (...) [m].

    Raises:
        InputError: Interval or sensitivity out of range, or shapes that do not fit.
    """
    if not (np.isfinite(interval_m) and interval_m > 0):
        raise InputError(f"a positive interval is accepted, found {interval_m}")
    if not (np.isfinite(sensitivity) and sensitivity >= 0):
        raise InputError(f"a sensitivity k of at least 0 is accepted, found {sensitivity}")
    first, second = np.asarray(normals_i, dtype=float), np.asarray(normals_j, dtype=float)
    if first.shape[-1:] != (3,) or second.shape[-1:] != (3,):
        raise InputError(
            f"normals of shape (..., 3) are accepted, found {first.shape} and {second.shape}"
        )
    cosine = np.clip((first * second).sum(axis=-1), -1.0, 1.0)
    return np.where(cosine > 0, interval_m * np.maximum(cosine, 0.0) ** sensitivity, 0.0)
