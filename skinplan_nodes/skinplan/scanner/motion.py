"""The views along the motion between scan points."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import InputError, ScanPathInvalidError
from skinplan.scan_path.model import ROW, ScanPath
from skinplan.scanner.views import checked_views
from skinplan.transforms import Array

STEP_M = 0.010
STEP_RAD = float(np.deg2rad(2.0))
_MOST_VIEWS = 2_000_000
_STRAIGHT = 1e-9


def row_sequences(path: ScanPath) -> list[NDArray[np.int64]]:
    """Returns the points of each row in their order: within a row the motion scans.

    Args:
        path: The scan path.

    Returns:
        Point numbers of each row, rows in the order of their numbers.
    """
    rows = np.flatnonzero(path.kinds == ROW)
    order = rows[np.argsort(path.groups[rows], kind="stable")]
    breaks = np.flatnonzero(np.diff(path.groups[order])) + 1
    return [part for part in np.split(order, breaks) if len(part)]


def views_between(
    positions: Array,
    directions: Array,
    sequences: Sequence[NDArray[np.int64]],
    step_m: float = STEP_M,
    step_rad: float = STEP_RAD,
) -> tuple[Array, Array]:
    """Interpolates the views between poses that follow each other.

    The position moves on a straight line, the view direction turns at a steady rate in one plane.
    The given poses themselves are not among the result.

    Args:
        positions: Scanner origins, shape (n, 3) [m].
        directions: Unit view directions, shape (n, 3).
        sequences: Pose numbers in the order of motion, one array for each motion without a break.
        step_m: Largest distance between neighbours [m].
        step_rad: Largest angle between neighbours [rad].

    Returns:
        Positions and unit directions, shape (m, 3) each.

    Raises:
        InputError: A step that is not positive, or so small that there were more than 2 million
            views.
        ScanPathInvalidError: Poses that are no poses, or numbers without a pose.
    """
    places, views = checked_views(positions, directions)
    if not (0.0 < step_m < np.inf and 0.0 < step_rad < np.inf):
        raise InputError(
            f"steps of motion above 0 are accepted, found {step_m} m and {step_rad} rad"
        )
    starts, ends = _pairs(sequences, len(places))
    angles = _angle(views[starts], views[ends])
    distances = np.linalg.norm(places[ends] - places[starts], axis=1)
    parts = np.maximum(np.ceil(np.maximum(distances / step_m, angles / step_rad) - 1e-9), 1.0)
    if parts.sum() > _MOST_VIEWS:
        raise InputError(
            f"motion in steps of {step_m} m and {step_rad} rad has {parts.sum():.3g} views; at "
            f"most {_MOST_VIEWS} are accepted"
        )
    counts = parts.astype(np.int64) - 1
    pair = np.repeat(np.arange(len(counts)), counts)
    number = np.arange(len(pair)) - np.repeat(np.cumsum(counts) - counts, counts) + 1
    share = (number / parts[pair])[:, None]
    first, last = starts[pair], ends[pair]
    return (
        places[first] + share * (places[last] - places[first]),
        _turned(views[first], views[last], angles[pair][:, None], share),
    )


def _pairs(
    sequences: Sequence[NDArray[np.int64]], count: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    numbers = [np.asarray(sequence, dtype=np.int64).reshape(-1) for sequence in sequences]
    for sequence in numbers:
        if len(sequence) and not (sequence.min() >= 0 and sequence.max() < count):
            raise ScanPathInvalidError(
                f"pose numbers from 0 to {count - 1} are accepted in a motion, found "
                f"{sequence.min()} to {sequence.max()}"
            )
    none = np.zeros(0, dtype=np.int64)
    return (
        np.concatenate([none, *(sequence[:-1] for sequence in numbers)]),
        np.concatenate([none, *(sequence[1:] for sequence in numbers)]),
    )


def _angle(first: Array, second: Array) -> Array:
    # Exact for small angles too, where the arc cosine is not.
    cross = np.linalg.norm(np.cross(first, second), axis=1)
    return np.arctan2(cross, np.einsum("ij,ij->i", first, second))


def _turned(first: Array, second: Array, angles: Array, share: Array) -> Array:
    """Turns unit vectors toward others by a share of the angle between them, all (m, 3), (m, 1)."""
    side = second - np.sum(first * second, axis=1, keepdims=True) * first
    length = np.linalg.norm(side, axis=1, keepdims=True)
    # Opposite directions have no plane of their own: turn about the axis that is farthest from
    # them; for equal ones the side does not matter.
    other = np.eye(3)[np.argmin(np.abs(first), axis=1)]
    other = np.cross(first, other)
    other /= np.linalg.norm(other, axis=1, keepdims=True)
    side = np.where(length > _STRAIGHT, side / np.maximum(length, _STRAIGHT), other)
    turned = np.cos(share * angles) * first + np.sin(share * angles) * side
    return turned / np.linalg.norm(turned, axis=1, keepdims=True)
