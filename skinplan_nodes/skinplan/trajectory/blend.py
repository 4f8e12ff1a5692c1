"""Joint paths without stops: corners between the legs of a transit are rounded where that is free.

A corner is replaced by a parabola (quadratic Bézier curve) that touches both legs, the largest of a
few that is free of collision.
"""

import numpy as np

from skinplan.robot.collision import CollisionWorld
from skinplan.transforms import Array

_SIZES_RAD = (1.2, 0.6, 0.3, 0.15)  # how far before and behind the corner the curve begins and ends
_ON_CURVE = 8
_KNOT_RAD = 0.2  # straight pieces get knots so far apart: a spline through them stays straight


def blended(world: CollisionWorld, legs: list[Array]) -> list[Array]:
    """Rounds the corners of legs.

    Args:
        world: Arm and surroundings.
        legs: Joint paths, each begins where the one before ends, shape (k >= 2, 6) [rad].

    Returns:
        Joint paths to be driven from rest to rest: one, or more where a corner can't be rounded.
        Knots stand at most 0.2 rad apart where there is more than one line.
    """
    result: list[Array] = []
    for leg in legs:
        if result:
            joined = _joined(world, result[-1], leg)
            if joined is not None:
                result[-1] = joined
                continue
        result.append(leg)
    return [leg if len(leg) == 2 else _knotted(leg) for leg in result]


def _joined(world: CollisionWorld, first: Array, second: Array) -> Array | None:
    """One path of two, the corner rounded; None where no curve is free."""
    corner = second[0]
    lengths = _length(first), _length(second)
    for size in _SIZES_RAD:
        before = _cut(first[::-1], min(size, 0.5 * lengths[0]))
        after = _cut(second, min(size, 0.5 * lengths[1]))
        t = np.linspace(0.0, 1.0, _ON_CURVE + 1)[:, None]
        curve = (1 - t) ** 2 * before[0] + 2 * t * (1 - t) * corner + t**2 * after[0]
        if np.all(world.free(world.dense(curve)[0])):
            return np.vstack([before[:0:-1], curve, after[1:]])
    return None


def _length(q: Array) -> float:
    return float(np.abs(np.diff(q, axis=0)).max(axis=1).sum())


def _cut(q: Array, distance: float) -> Array:
    """The path without its first piece, a distance long (largest joint motion)."""
    way = np.append(0.0, np.cumsum(np.abs(np.diff(q, axis=0)).max(axis=1)))
    step = int(np.clip(np.searchsorted(way, distance, side="right") - 1, 0, len(q) - 2))
    share = (distance - way[step]) / max(way[step + 1] - way[step], 1e-12)
    begin = q[step] + min(share, 1.0) * (q[step + 1] - q[step])
    return np.vstack([begin, q[step + 1 :]])


def _knotted(q: Array) -> Array:
    """Adds knots on long steps and leaves out steps without length."""
    way = np.abs(np.diff(q, axis=0)).max(axis=1)
    q = q[np.append(True, way > 1e-6)]
    way = np.abs(np.diff(q, axis=0)).max(axis=1)
    count = np.maximum(np.ceil(way / _KNOT_RAD), 1).astype(int)
    owner = np.repeat(np.arange(len(count)), count)
    share = (np.arange(len(owner)) - (np.cumsum(count) - count)[owner]) / count[owner]
    return np.vstack([q[owner] + share[:, None] * (q[owner + 1] - q[owner]), q[-1:]])
