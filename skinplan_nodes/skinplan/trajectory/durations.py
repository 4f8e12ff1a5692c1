"""How long joint motion takes from rest to rest: closed forms, used as estimates."""

import numpy as np

from skinplan.transforms import Array


def rest_to_rest(change: Array, velocity: Array, acceleration: float) -> Array:
    """Returns the time of straight joint moves from rest to rest, (..., 6) [rad] -> (...) [s].

    Args:
        change: Sizes of the joint motion, shape (..., 6) [rad].
        velocity: Joint velocity limits, shape (6,) [rad/s].
        acceleration: Joint acceleration limit [rad/s^2].
    """
    short = 2.0 * np.sqrt(change / acceleration)
    long = change / velocity + velocity / acceleration
    return np.asarray(np.where(change < velocity**2 / acceleration, short, long).max(axis=-1))


def pair_changes(first: Array, second: Array, velocity: Array) -> tuple[Array, Array]:
    """Returns the least time [s] and the sum of joint motion [rad] between all pairs, each (a, b).

    Args:
        first: Joint positions, shape (a, 6) [rad].
        second: Joint positions, shape (b, 6) [rad].
        velocity: Joint velocity limits, shape (6,) [rad/s].
    """
    slowest, total = np.zeros((2, len(first), len(second)))
    # Joint by joint: several times faster than one array of three dimensions.
    for a, b, limit in zip(first.T, second.T, velocity, strict=True):
        change = np.abs(b[None] - a[:, None])
        total += change
        np.maximum(slowest, change / limit, out=slowest)
    return slowest, total


def polyline_s(q: Array, velocity: Array, acceleration: float) -> float:
    """Returns about how long a joint path, shape (k, 6) [rad], takes without a stop inside [s]."""
    change = np.abs(np.diff(q, axis=0)).sum(axis=0)
    return float(rest_to_rest(change, velocity, acceleration))
