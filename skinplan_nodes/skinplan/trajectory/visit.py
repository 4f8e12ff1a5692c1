"""What a strategy for the order of visit is given, and what it gives back."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.scan_path.model import ScanPath
from skinplan.transforms import Array

Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class VisitTask:
    """The points of one station.

    Attributes:
        path: The scan path, workpiece frame.
        points: Indices of the points that are reached here, rising, shape (p,).
        interval_m: d_interval of eq (5) [m].
        begin: Where the scanner comes from, workpiece frame, shape (3,) [m]; None = no preference.
        end: Where it goes afterwards, as ``begin``.
        seed: Of every random draw.
    """

    path: ScanPath
    points: Indices
    interval_m: float
    begin: Array | None = None
    end: Array | None = None
    seed: int = 0


@dataclass(frozen=True, eq=False)
class VisitOrder:
    """An order of visit.

    Attributes:
        points: The task's points, each once, in the order of visit, shape (p,).
        cost: What the strategy made small, in its own unit; NaN = nothing was.
        bound: No order of these points has a smaller cost; NaN = not known.
    """

    points: Indices
    cost: float = float("nan")
    bound: float = float("nan")

    @property
    def gap(self) -> float:
        """How far the cost may be above the least possible, as a share of it; NaN = not known."""
        return self.cost / self.bound - 1.0 if self.bound > 0.0 else float("nan")
