"""Candidates of M2.3 step 1: a rectangle about every projected point, then NMS."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.stations.rectangle import Rectangle
from skinplan.transforms import Array

IOU_THRESHOLD = 0.8
_CHUNK = 512


@dataclass(frozen=True, eq=False)
class Candidates:
    """Rectangles on the floor, all with the same heading.

    Attributes:
        centres: Middles in the floor frame (first axis along the heading, second to the left),
            shape (c, 2) [m].
        covers: Which rectangle covers which projected point, shape (c, n).
    """

    centres: Array
    covers: NDArray[np.bool_]


def floor_frame(projected: Array, directions: Array) -> float:
    """Returns the heading of bases parallel to the part, with the part on their left [rad].

    Args:
        projected: Scan positions on the floor, shape (n, 2) [m], map frame.
        directions: Unit view directions, shape (n, 3), map frame. Where they point mainly up or
            down, the long axis of the projected points is taken instead.
    """
    left = directions[:, :2].mean(axis=0)
    if np.linalg.norm(left) > 0.2:
        return float(np.arctan2(-left[0], left[1]))
    spread = projected - projected.mean(axis=0)
    along = np.linalg.svd(spread, full_matrices=False)[2][0]
    along = along * np.sign(along[np.argmax(np.abs(along))])
    return float(np.arctan2(along[1], along[0]))


def make_candidates(
    points: Array, rectangle: Rectangle, threshold: float = IOU_THRESHOLD
) -> Candidates:
    """Centres a rectangle on every point and thins them.

    Args:
        points: Projected points in the floor frame, shape (n, 2) [m].
        rectangle: The workspace rectangle.
        threshold: Of two rectangles with a greater IoU the one that covers fewer points goes; among
            equals the one that comes later along the heading.
    """
    places = np.unique(np.round(points, 6), axis=0)
    half = 0.5 * np.array([rectangle.length_m, rectangle.depth_m]) + 1e-9
    counts = np.concatenate(
        [
            _covers(points, places[start : start + _CHUNK], half).sum(axis=1)
            for start in range(0, len(places), _CHUNK)
        ]
    )
    order = np.lexsort((places[:, 1], places[:, 0], -counts))
    kept: list[int] = []
    for number in order:
        if not kept or np.max(overlap(places[number], places[kept], rectangle)) <= threshold:
            kept.append(int(number))
    kept = sorted(kept, key=lambda k: tuple(places[k]))
    centres = places[kept]
    return Candidates(centres, _covers(points, centres, half))


def overlap(centre: Array, others: Array, rectangle: Rectangle) -> Array:
    """Returns the IoU of a rectangle about (2,) [m] with equal ones about (m, 2) [m], (m,)."""
    size = np.array([rectangle.length_m, rectangle.depth_m])
    common = np.prod(np.maximum(size - np.abs(others - centre), 0.0), axis=1)
    return np.asarray(common / (2.0 * np.prod(size) - common))


def refined_centre(points: Array, centre: Array, rectangle: Rectangle) -> Array:
    """Step 3: the middle nearest to the centroid (7) at which all points stay covered, (2,) [m].

    Args:
        points: The covered points, shape (m, 2) [m].
        centre: Present middle, shape (2,) [m].
        rectangle: The workspace rectangle.
    """
    if not len(points):
        return centre
    half = 0.5 * np.array([rectangle.length_m, rectangle.depth_m])
    low, high = points.max(axis=0) - half, points.min(axis=0) + half
    return np.asarray(np.clip(points.mean(axis=0), np.minimum(low, high), np.maximum(low, high)))


def _covers(points: Array, centres: Array, half: Array) -> NDArray[np.bool_]:
    return np.asarray(np.all(np.abs(points[None] - centres[:, None]) <= half, axis=2))
