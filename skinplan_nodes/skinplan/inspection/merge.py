"""Merges scan frames into one cloud of bounded size.

One point per voxel, larger voxels when there are too many.
"""

import logging

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import InputError
from skinplan.inspection.points import checked_points
from skinplan.transforms import Array

_LOG = logging.getLogger(__name__)
# Voxel numbers per axis fit into 21 bits: +-1 million voxels.
_BITS = 21
_HALF = 1 << (_BITS - 1)


class MergedCloud:
    """Collects points; keeps the first of each voxel.

    Args:
        voxel_m: Side of a voxel [m].
        limit: At most so many points are kept; above, the voxels double until it is so.
        columns: Number of further values per point (intensity, incidence, ...).
        pending: So many points are collected before they are merged.

    Raises:
        InputError: A voxel or a limit that is not positive.
    """

    def __init__(
        self,
        voxel_m: float = 0.001,
        limit: int = 3_000_000,
        columns: int = 0,
        pending: int = 200_000,
    ) -> None:
        if not (voxel_m > 0.0 and limit > 0):
            raise InputError(
                f"merged cloud: a voxel and a limit above 0 are accepted, found {voxel_m}, {limit}"
            )
        self.voxel_m = voxel_m
        self.limit = limit
        self.received = 0
        self._pending_most = pending
        self._points = np.zeros((0, 3))
        self._extra = np.zeros((0, columns), dtype=np.float32)
        self._keys = np.zeros(0, dtype=np.int64)
        self._pending: list[tuple[Array, NDArray[np.float32]]] = []
        self._waiting = 0

    def add(self, points: Array, extra: NDArray[np.float32] | None = None) -> None:
        """Takes the points of a frame in.

        Args:
            points: shape (n, 3) [m], in one frame for all calls.
            extra: Further values, shape (n, columns); None = NaN.

        Raises:
            InputError: A wrong shape, or coordinates that are not finite or beyond a million
                voxels.
        """
        cloud = checked_points(points)
        columns = self._extra.shape[1]
        values = (
            np.full((len(cloud), columns), np.nan, np.float32)
            if extra is None
            else np.asarray(extra, np.float32)
        )
        if values.shape != (len(cloud), columns):
            raise InputError(
                f"further values: shape {(len(cloud), columns)} is accepted, found {values.shape}"
            )
        if len(cloud) and np.abs(cloud).max() >= self.voxel_m * (_HALF - 1):
            raise InputError(
                f"points: coordinates below {self.voxel_m * (_HALF - 1):.0f} m are accepted, "
                f"found {np.abs(cloud).max():.0f} m"
            )
        self.received += len(cloud)
        self._pending.append((cloud, values))
        self._waiting += len(cloud)
        if self._waiting >= self._pending_most:
            self._merge()

    def points(self) -> tuple[Array, NDArray[np.float32]]:
        """Returns merged points, shape (m, 3) [m], and further values, shape (m, columns)."""
        self._merge()
        return self._points, self._extra

    def __len__(self) -> int:
        self._merge()
        return len(self._points)

    @property
    def about(self) -> int:
        """Number of points, cheap: those of the last frames are counted before they are merged."""
        return len(self._points) + self._waiting

    def _merge(self) -> None:
        if not self._pending:
            return
        points = np.concatenate([self._points, *(p for p, _ in self._pending)])
        extra = np.concatenate([self._extra, *(e for _, e in self._pending)])
        keys = np.concatenate([self._keys, *(self._voxels(p) for p, _ in self._pending)])
        self._pending, self._waiting = [], 0
        self._keep_first(points, extra, keys)
        while len(self._points) > self.limit:
            self.voxel_m *= 2.0
            _LOG.info(
                "merged cloud above %d points: voxels of %g mm", self.limit, self.voxel_m * 1e3
            )
            self._keep_first(self._points, self._extra, self._voxels(self._points))

    def _keep_first(
        self, points: Array, extra: NDArray[np.float32], keys: NDArray[np.int64]
    ) -> None:
        _, first = np.unique(keys, return_index=True)
        first.sort()
        self._points, self._extra, self._keys = points[first], extra[first], keys[first]

    def _voxels(self, points: Array) -> NDArray[np.int64]:
        cells = np.floor(points / self.voxel_m).astype(np.int64) + _HALF
        return (cells[:, 0] << 2 * _BITS) | (cells[:, 1] << _BITS) | cells[:, 2]
