"""Which points of a scan frame the scanner could have measured: in its range, not too oblique.

Seen from the scanner alone: neither the part nor the arm is asked.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skinplan.errors import InputError
from skinplan.scanner.model import ScannerModel
from skinplan.transforms import Array, apply, inverse

# The pose of the scanner is that of a moment up to some milliseconds beside the frame's.
RANGE_MARGIN_M = 0.003
INCIDENCE_MARGIN_RAD = float(np.deg2rad(1.0))
# A plane through the nearest points gives the normal where the scanner does not tell the incidence.
_NEIGHBOURS = 9


class FrameCheck:
    """Tells usable points from those beyond the range window or the incidence limit.

    Args:
        scanner: Range window and incidence limit.
        range_margin_m: A point so far beyond the window still counts [m].
        incidence_margin_rad: So much more oblique than the limit still counts [rad].
    """

    def __init__(
        self,
        scanner: ScannerModel,
        range_margin_m: float = RANGE_MARGIN_M,
        incidence_margin_rad: float = INCIDENCE_MARGIN_RAD,
    ) -> None:
        self._nearest_m = scanner.range_min_m - range_margin_m
        self._farthest_m = scanner.range_max_m + range_margin_m
        self._most_rad = scanner.incidence_max_rad + incidence_margin_rad

    def usable(
        self, points: Array, T_tracker_scanner: Array, incidence: Array | None = None
    ) -> NDArray[np.bool_]:
        """Returns which points can be used.

        Args:
            points: Tracker frame, shape (n, 3) [m].
            T_tracker_scanner: Pose of the scanner, shape (4, 4) [m]; +x is the view direction.
            incidence: Angle between view axis and inward surface normal, shape (n,) [rad]; NaN, or
                None for all = found from the points themselves.

        Raises:
            InputError: As many incidences as points are accepted, found another number.
        """
        if incidence is not None and np.shape(incidence) != (len(points),):
            raise InputError(
                f"incidence: {len(points)} angles are accepted, found {np.shape(incidence)}"
            )
        if len(points) == 0:
            return np.zeros(0, dtype=bool)
        local = apply(inverse(T_tracker_scanner), points)
        depth = local[:, 0]
        usable = (depth >= self._nearest_m) & (depth <= self._farthest_m)
        angles = np.full(len(points), np.nan) if incidence is None else np.asarray(incidence, float)
        unknown = np.isnan(angles)
        if unknown.any():
            angles = np.where(unknown, incidence_of(local), angles)
        # What can't be told (too few points for a plane) is not held against them.
        return np.asarray(usable & ~(angles > self._most_rad))


def incidence_of(local: Array) -> Array:
    """Returns the angle between the view axis and the surface through the nearest points.

    Args:
        local: Points in the scanner frame, shape (n, 3) [m].

    Returns:
        shape (n,) [rad], 0 to pi/2; NaN with fewer than 3 points.
    """
    if len(local) < 3:
        return np.full(len(local), np.nan)
    count = min(_NEIGHBOURS, len(local))
    _, near = cKDTree(local).query(local, k=count)
    around = local[near] - local[near].mean(axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
    return np.arccos(np.clip(np.abs(vectors[:, 0, 0]), 0.0, 1.0))
