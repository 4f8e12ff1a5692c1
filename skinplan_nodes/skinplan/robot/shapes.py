"""Closed-form distances between the primitive shapes of the cell, vectorised."""

import numpy as np

from skinplan.transforms import Array


def segment_distances(first: Array, second: Array) -> Array:
    """Returns distances between pairs of line segments, shape (n,) [m].

    Args:
        first: End points, shape (n, 2, 3) [m].
        second: End points, shape (n, 2, 3) [m].
    """
    d1, d2 = first[:, 1] - first[:, 0], second[:, 1] - second[:, 0]
    r = first[:, 0] - second[:, 0]
    a, e = np.einsum("ni,ni->n", d1, d1), np.einsum("ni,ni->n", d2, d2)
    b, c, f = (
        np.einsum("ni,ni->n", d1, d2),
        np.einsum("ni,ni->n", d1, r),
        np.einsum("ni,ni->n", d2, r),
    )
    denominator = a * e - b * b
    parallel = denominator <= 1e-12 * np.maximum(a * e, 1e-300)
    s = np.where(
        parallel, 0.0, np.clip((b * f - c * e) / np.where(parallel, 1.0, denominator), 0.0, 1.0)
    )
    t = np.clip(_ratio(b * s + f, e), 0.0, 1.0)
    s = np.clip(_ratio(b * t - c, a), 0.0, 1.0)
    t = np.clip(_ratio(b * s + f, e), 0.0, 1.0)
    gap = r + s[:, None] * d1 - t[:, None] * d2
    return np.asarray(np.linalg.norm(gap, axis=1))


def box_distances(points: Array, low: Array, high: Array) -> Array:
    """Returns distances of points, (n, 3) [m], from an axis-aligned box, (n,) [m]; 0 inside."""
    return np.asarray(
        np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=1)
    )


def segment_box_distances(segments: Array, low: Array, high: Array) -> Array:
    """Returns distances between line segments and an axis-aligned box, (n,) [m]; 0 = they meet.

    Half the squared distance from the box is convex along a line, and its slope is linear between
    the places where the line crosses the planes of the box's faces: the minimum is where the slope
    passes zero.

    Args:
        segments: End points, shape (n, 2, 3) [m].
        low: Lower corner of the box, shape (3,) [m].
        high: Upper corner, shape (3,) [m].
    """
    start, way = segments[:, 0], segments[:, 1] - segments[:, 0]
    moving = np.abs(way) > 1e-12
    safe = np.where(moving, way, 1.0)
    crossings = np.where(
        moving[:, None], (np.stack([low, high])[None] - start[:, None]) / safe[:, None], 0.0
    )
    ends = np.tile([0.0, 1.0], (len(start), 1))
    shares = np.sort(
        np.concatenate([np.clip(crossings.reshape(len(start), 6), 0.0, 1.0), ends], axis=1), axis=1
    )
    points = start[:, None] + shares[:, :, None] * way[:, None]
    outside = np.maximum(points - high, 0.0) - np.maximum(low - points, 0.0)
    slope = np.einsum("nki,ni->nk", outside, way)
    rows = np.arange(len(start))
    after = np.argmax(slope >= 0.0, axis=1)  # 0 when it rises from the start on
    after = np.where(slope[:, -1] < 0.0, shares.shape[1] - 1, after)
    before = np.maximum(after - 1, 0)
    rise = slope[rows, after] - slope[rows, before]
    part = np.where(
        (rise > 0.0) & (after > 0), -slope[rows, before] / np.where(rise > 0.0, rise, 1.0), 0.0
    )
    share = shares[rows, before] + np.clip(part, 0.0, 1.0) * (
        shares[rows, after] - shares[rows, before]
    )
    share = np.where(slope[:, -1] < 0.0, 1.0, share)
    return box_distances(start + share[:, None] * way, low, high)


def _ratio(numerator: Array, denominator: Array) -> Array:
    """Quotient, 0 where the segment has no length."""
    zero = denominator <= 1e-18
    return np.where(zero, 0.0, numerator / np.where(zero, 1.0, denominator))
