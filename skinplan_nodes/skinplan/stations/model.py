"""Stations, as the rooms exchange them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.transforms import Array


@dataclass(frozen=True, eq=False)
class Station:
    """A place for the base to stand (M2.3).

    Attributes:
        id: Number of the station, from 0, in the order of visit.
        T_map_base_link: Pose of the base, shape (4, 4) [m]; on the floor, heading only.
        points: Indices of the scan path points that are scanned here, shape (p,).
    """

    id: int
    T_map_base_link: Array
    points: NDArray[np.int64]


@dataclass(frozen=True)
class SkippedPoint:
    """A scan path point that is left out.

    Attributes:
        point: Index into the scan path.
        reason: Why.
    """

    point: int
    reason: str


@dataclass(frozen=True)
class StationPlan:
    """Where the base stands, in which order.

    Attributes:
        strategy: Name of the strategy.
        stations: In the order of visit.
        candidates: Number of candidates that the choice was made from.
        lower_bound: Proven least number of stations over the candidates; 0 = no bound known.
        proven_optimal: No smaller set of the candidates covers as much.
        reached_ratio: Share of the points that the arm really reaches from their station [1].
        skipped: Points that no station reaches.
    """

    strategy: str
    stations: tuple[Station, ...]
    candidates: int
    lower_bound: int
    proven_optimal: bool
    reached_ratio: float
    skipped: tuple[SkippedPoint, ...]
