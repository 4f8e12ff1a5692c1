"""The box of a cloud or a part: size and rough pose without correspondences (R2.1, R2.4)."""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from skinplan.inspection.points import evenly
from skinplan.transforms import Array, inverse, transform

# Robust extents leave this share of the points out on either side [%]: debris, and the part's very
# edge.
_TAIL = 0.5


@dataclass(frozen=True, eq=False)
class Box:
    """Box of points: frame with x along the longer side and z across the thinnest, shape (4, 4).

    Sizes (3,) [m].
    """

    T_points_box: Array
    size: Array

    @classmethod
    def around(cls, points: Array) -> "Box":
        """Rectangle of least area in the plane of the points.

        Tails are cut so that debris does not count.
        """
        centre = np.median(points, axis=0)
        _, _, axes = np.linalg.svd(
            (points - centre)[evenly(len(points), 20_000)], full_matrices=False
        )
        flat = (points - centre) @ axes.T
        kept = np.all(np.abs(flat - np.median(flat, axis=0)) <= 1.5 * _span(flat), axis=1)
        angle = _rectangle_angle(flat[kept, :2])
        turn = np.array(
            [[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
        )
        rotation = turn @ axes
        if np.ptp(flat[kept] @ turn.T, axis=0)[0] < np.ptp(flat[kept] @ turn.T, axis=0)[1]:
            rotation = rotation[[1, 0, 2]]
        rotation[2] = np.cross(rotation[0], rotation[1])
        along = (points - centre) @ rotation.T
        low, high = np.percentile(along, [_TAIL, 100.0 - _TAIL], axis=0)
        middle = centre + (low + high) / 2.0 @ rotation
        return cls(transform(middle, rotation.T), (high - low) / (1.0 - 2.0 * _TAIL / 100.0))


def _span(flat: Array) -> Array:
    low, high = np.percentile(flat, [_TAIL, 100.0 - _TAIL], axis=0)
    return np.asarray(np.maximum(high - low, 1e-6))


def _rectangle_angle(flat: Array) -> float:
    # Debris off the part would set the rectangle: trimmed along several directions first.
    kept = np.ones(len(flat), dtype=bool)
    for angle in np.linspace(0.0, np.pi, 12, endpoint=False):
        along = flat @ np.array([np.cos(angle), np.sin(angle)])
        low, high = np.percentile(along, [0.05, 99.95])
        kept &= (along >= low) & (along <= high)
    _, _, degrees = cv2.minAreaRect(flat[kept].astype(np.float32))
    return float(np.deg2rad(degrees))


def box_poses(cloud: Box, part: Box) -> list[Array]:
    """The poses in which the boxes coincide.

    Both faces, four turns (two of them only fit a square).
    """
    found = []
    for flip in (0.0, np.pi):
        for quarter in range(4):
            if quarter % 2 and abs(part.size[0] - part.size[1]) > 0.1 * part.size[0]:
                continue
            turn = Rotation.from_euler("xz", [flip, quarter * np.pi / 2]).as_matrix()
            found.append(cloud.T_points_box @ transform(rotation=turn) @ inverse(part.T_points_box))
    return found
