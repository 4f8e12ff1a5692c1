"""Stations, as the rooms exchange them."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from skinplan.robot.records import ReachTable
from skinplan.stations.candidate_map import CandidateMap
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
        skipped: Points that no station reaches, each with the reason where it is nearest to being
            reached.
        robust_ratio: Share of the points that are reached also when the base stops beside its goal
            [1]; NaN = not asked.
        T_map_tracker: Tracker that must see the scanner, given or proposed, shape (4, 4) [m]; None
            = not known.
        marker_quality: E of eq (3) by which each station was asked to see a marker: T_E with margin
            [1]; NaN = not asked.
        records: Reach records, one row for each station; None = not kept.
        robust: Which station reaches which point also from beside its goal, shape (s, n); None =
            not asked or not kept.
        candidates_seen: The candidates, for pictures; None = not kept.
    """

    strategy: str
    stations: tuple[Station, ...]
    candidates: int
    lower_bound: int
    proven_optimal: bool
    reached_ratio: float
    skipped: tuple[SkippedPoint, ...]
    robust_ratio: float = float("nan")
    records: ReachTable | None = field(default=None, compare=False, repr=False)
    robust: NDArray[np.bool_] | None = field(default=None, compare=False, repr=False)
    candidates_seen: CandidateMap | None = field(default=None, compare=False, repr=False)
    T_map_tracker: Array | None = field(default=None, compare=False)
    marker_quality: float = float("nan")
