"""Points that someone wants measured: what they are, and whether they can be."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import InspectionPointsError
from skinplan.transforms import Array

_LARGEST_M = 60.0  # no part is longer; millimetres taken for metres are
_FARTHEST_M = 1000.0
_SAME_M = 1e-6


@dataclass(frozen=True, eq=False)
class InspectionPoints:
    """Points on a part, each to be looked at or touched along its inward normal.

    Attributes:
        targets: On the surface, workpiece frame, shape (n, 3) [m].
        normals: Outward unit normals, shape (n, 3).
        groups: Number of the surface that each belongs to, from 1, shape (n,).
    """

    targets: Array
    normals: Array
    groups: NDArray[np.int64]

    def __post_init__(self) -> None:
        """Checks what is given.

        Raises:
            InspectionPointsError: None, wrong shapes, not finite, not metres, not unit normals,
                groups below 1.
        """
        targets = require_points(self.targets)
        require_normals(self.normals, len(targets))
        groups = np.asarray(self.groups)
        if groups.shape != (len(targets),) or groups.dtype.kind not in "iu" or groups.min() < 1:
            raise InspectionPointsError(
                f"groups of {len(targets)} measuring points: as many whole numbers from 1 on are "
                f"accepted, found shape {groups.shape} of type {groups.dtype}"
            )

    def __len__(self) -> int:
        return len(self.targets)

    def repeated(self) -> NDArray[np.int64]:
        """Returns the numbers of points that are the same as an earlier one, rising."""
        both = np.concatenate([self.targets, self.normals], axis=1)
        _, first = np.unique(np.rint(both / _SAME_M), axis=0, return_index=True)
        return np.setdiff1d(np.arange(len(self)), first)


def require_points(points: Array, name: str = "measuring points") -> Array:
    """Returns points as array of shape (n, 3) [m].

    Raises:
        InspectionPointsError: None, wrong shape, not finite, or too far apart to be metres.
    """
    checked = np.asarray(points, dtype=float)
    if checked.size == 0:
        raise InspectionPointsError(f"{name}: none were found; at least one point is accepted")
    if checked.ndim != 2 or checked.shape[1] != 3 or not np.all(np.isfinite(checked)):
        raise InspectionPointsError(
            f"{name}: finite numbers of shape (n, 3) are accepted, found shape {checked.shape}"
            + ("" if np.all(np.isfinite(checked)) else " with values that are not finite")
        )
    extent = float(np.ptp(checked, axis=0).max())
    if extent > _LARGEST_M or np.abs(checked).max() > _FARTHEST_M:
        raise InspectionPointsError(
            f"{name}: {extent:.6g} m from end to end; up to {_LARGEST_M:g} m are accepted (are "
            "they in millimetres?)"
        )
    return checked


def require_normals(normals: Array, count: int) -> Array:
    """Returns unit normals as array of shape (count, 3).

    Raises:
        InspectionPointsError: Wrong shape, not finite, or not of unit length.
    """
    checked = np.asarray(normals, dtype=float)
    if checked.shape != (count, 3) or not np.all(np.isfinite(checked)):
        raise InspectionPointsError(
            f"normals: finite numbers of shape ({count}, 3) are accepted, found {checked.shape}"
        )
    lengths = np.linalg.norm(checked, axis=1)
    if np.any(np.abs(lengths - 1.0) > 1e-3):
        raise InspectionPointsError(
            f"normals: unit length is accepted, found lengths {lengths.min():.4g} to "
            f"{lengths.max():.4g}"
        )
    return checked / lengths[:, None]
