"""Thins a cloud without losing the few points that a motion hangs on.

A long section is held along itself by nothing but its narrow ends: points spread evenly leave
hardly any there, and the pose settles where chance has it. As in the geometrically stable sampling
of Gelfand et al. (2003), the points are chosen by what they say about the motions.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.inspection.closest import SurfaceIndex
from skinplan.inspection.determined import jacobian
from skinplan.inspection.points import evenly
from skinplan.transforms import Array, apply

# A point holds a motion when this share of its square is along the normal [1].
_HOLDS = 0.1
# Each motion should be held by as much as so many points that move along their normals.
_ENOUGH = 100.0


@dataclass(frozen=True, eq=False)
class Sample:
    """Some points of a cloud.

    Attributes:
        points: shape (n, 3) [m].
        stands_for: So many points of the cloud each stands for, shape (n,): what is known of a
            motion is not more for having kept the points that hold it.
    """

    points: Array
    stands_for: Array

    @classmethod
    def all_alike(cls, points: Array) -> "Sample":
        """Points that stand for equally many, shape (n, 3) [m]."""
        return cls(points, np.ones(len(points)))


class Choice:
    """Which points of one cloud are used.

    Args:
        cloud: Tracker frame, shape (n, 3) [m].
        index: The part's surface.
        T_part_tracker: Coarse pose, shape (4, 4) [m].
        most: At most so many are looked at to find those that hold a motion.
        spacing_m: Side of the cubes that have one point each in the even choice [m].
    """

    def __init__(
        self, cloud: Array, index: SurfaceIndex, T_part_tracker: Array, most: int, spacing_m: float
    ) -> None:
        self._cloud, self._index, self._to_part = cloud, index, T_part_tracker
        self._picked = evenly(len(cloud), most)
        self._local = apply(T_part_tracker, cloud[self._picked])
        self._even = first_of_cubes(self._local, spacing_m)

    @property
    def even(self) -> Array:
        """Points spread evenly, frame of the coarse pose, shape (k, 3) [m]."""
        return self._local[self._even]

    def fine(self, T: Array) -> Sample:
        """The even ones and those that hold a motion.

        Args:
            T: Takes the frame of the coarse pose to where the part nearly is, shape (4, 4) [m].
        """
        held = holding(apply(T, self._local), self._even, self._index)
        numbers, counts = with_holding(self._even, held, len(self._local))
        return Sample(self._local[numbers], counts)

    def final(self, T: Array, count: int) -> Sample:
        """So many points of the whole cloud, and those that hold a motion, as `fine`."""
        even = evenly(len(self._cloud), count)
        held = holding(apply(T, self._local), evenly(len(self._local), count), self._index)
        numbers, counts = with_holding(even, self._picked[held], len(self._local))
        return Sample(apply(self._to_part, self._cloud[numbers]), counts)


def with_holding(
    even: NDArray[np.int64], held: NDArray[np.int64], count: int
) -> tuple[NDArray[np.int64], Array]:
    """Adds the points that a motion hangs on to an even choice.

    Args:
        even: Numbers of points spread evenly over a cloud, shape (k,).
        held: Of those that are kept all, shape (m,).
        count: Points among which the latter were looked for.

    Returns:
        Numbers and how many points each stands for, shapes (n,).
    """
    others = np.setdiff1d(even, held)
    share = max(count - len(held), 1) / max(len(others), 1)
    counts = np.concatenate([np.full(len(others), share), np.ones(len(held))])
    return np.concatenate([others, held]), counts


def holding(cloud: Array, even: NDArray[np.int64], index: SurfaceIndex) -> NDArray[np.int64]:
    """Finds the points of a cloud that motions hang on which an even choice knows little of.

    Args:
        cloud: Nearly in place, workpiece frame, shape (n, 3) [m].
        even: Numbers of points spread evenly over it, shape (k,).
        index: The part's surface.

    Returns:
        Increasing numbers, shape (m,); none when the even choice holds every motion.
    """
    middle = cloud.mean(axis=0)
    size = float(np.sqrt(np.mean(np.sum((cloud - middle) ** 2, axis=1))))

    def rows_of(points: Array) -> Array:
        return jacobian(points, index.normals_near(points), middle, size)[:, :6]

    known = rows_of(cloud[even])
    if np.linalg.eigvalsh(known.T @ known)[0] >= _ENOUGH:
        return np.zeros(0, dtype=np.int64)
    rows = rows_of(cloud)
    _, directions = np.linalg.eigh(rows.T @ rows)
    held = (rows @ directions) ** 2
    found = [
        _strongest(each, _ENOUGH)
        for each, so_far in zip(held.T, held[even].sum(axis=0), strict=True)
        if so_far < _ENOUGH
    ]
    return np.unique(np.concatenate([np.zeros(0, np.int64), *found]))


def _strongest(held: Array, enough: float) -> NDArray[np.int64]:
    """Numbers of the points that hold a motion best, until they hold it well enough."""
    order = np.argsort(-held, kind="stable")
    order = order[: np.count_nonzero(held > _HOLDS)]
    count = int(np.searchsorted(np.cumsum(held[order]), enough)) + 1
    return np.asarray(order[:count])


def first_of_cubes(points: Array, side_m: float) -> NDArray[np.int64]:
    """Returns the number of the first point of each cube of that side, increasing."""
    cells = np.floor(points / side_m).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    return np.sort(first)
