"""What a strategy for the order of visit is given, and what it gives back."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from skinplan.scan_path.model import ScanPath
from skinplan.transforms import Array

if TYPE_CHECKING:
    from skinplan.trajectory.graph import StationGraph

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
        among: Indices of all points of the station, rising: views of the graph are numbers of
            these, shape (a,); empty when there is no graph.
        graph: The states of the points and the ways between them; None = not known.
        known: An order to improve; None = none yet.
        effort_s: About how long a search may take [s].
        tcp_turn_s: Time that the scanner loses by a full turn back [s].
    """

    path: ScanPath
    points: Indices
    interval_m: float
    begin: Array | None = None
    end: Array | None = None
    seed: int = 0
    among: Indices = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    graph: "StationGraph | None" = None
    known: Indices | None = None
    effort_s: float = 2.0
    tcp_turn_s: float = 0.07


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
