"""The scan path, as the rooms exchange it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.transforms import Array

ROW = 0
FEATURE = 1


@dataclass(frozen=True, eq=False)
class LeftOut:
    """A pose that was wanted and could not be had.

    Attributes:
        target: The surface point, shape (3,) [m].
        reason: Why.
    """

    target: Array
    reason: str


@dataclass(frozen=True)
class PassReport:
    """What became of a pass whose depth and angles were to be optimised (T S3).

    Attributes:
        kind: ROW or FEATURE.
        group: Row or region number, as in `ScanPath.groups`.
        points: Number of its points.
        error_before: Mean of the evaluation function over its points as given; the unit is that of
            `skinplan.trajectory.pass_error`.
        error_after: Same, after the optimisation.
        moved: Number of points that were moved.
        reason: Why points were left as they are; empty when all were moved.
    """

    kind: int
    group: int
    points: int
    error_before: float
    error_after: float
    moved: int
    reason: str

    @property
    def improved(self) -> bool:
        """Whether the pass was changed."""
        return self.moved > 0


@dataclass(frozen=True, eq=False)
class ScanPath:
    """Scan path points in the workpiece frame, row points first (M2.1, M2.2).

    Attributes:
        positions: Scanner origins, shape (n, 3) [m].
        directions: Unit view directions (scanner +x), shape (n, 3).
        targets: Surface points that the poses were made for, shape (n, 3) [m].
        kinds: ROW or FEATURE, shape (n,).
        groups: Row number for row points, region number (from 1) for feature points, shape (n,).
            Row points of one row stand in the order along the row; a row that stops at a hole and
            goes on behind it has two numbers.
        strategy: Name of the strategy that made it.
        regions: Number of complex regions of the part.
        lower_bound: No fewer points of the candidates see as much; 0 = no bound known.
        left_out: Poses that were wanted and could not be had.
        passes: What the optimisation of its passes did; empty = they were not optimised.
    """

    positions: Array
    directions: Array
    targets: Array
    kinds: NDArray[np.int64]
    groups: NDArray[np.int64]
    strategy: str
    regions: int
    lower_bound: int = 0
    left_out: tuple[LeftOut, ...] = ()
    passes: tuple[PassReport, ...] = ()

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def row_points(self) -> int:
        """Number of row points."""
        return int(np.count_nonzero(self.kinds == ROW))

    @property
    def feature_points(self) -> int:
        """Number of feature points."""
        return int(np.count_nonzero(self.kinds == FEATURE))
