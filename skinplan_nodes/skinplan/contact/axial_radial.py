"""The station algorithm of C 3.1, steps (1) to (9), for any arm and any points.

The axis of the part is y, its radial direction x. Three things the paper leaves open: y = Y_max
falls into the last interval (the intervals are half open); an interval without points gets no
station; of equal counts the smallest k is taken (or the middle one). As printed, the sum of the
counts must be greater than the number of points, which one station can never fulfil:
`overlap_required` = False drops that.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.contact.settings import AxialRadialSettings
from skinplan.errors import NothingReachedError
from skinplan.part.inspection_points import require_points
from skinplan.transforms import Array

_LOG = logging.getLogger(__name__)

#: Which of all points the arm reaches, shape (n,), with its base at (x, y) [m].
Reach = Callable[[float, float], NDArray[np.bool_]]


@dataclass(frozen=True, eq=False)
class RadialStation:
    """One interval of the axis and the station chosen for it.

    Attributes:
        start_x_m: S_i_x of eq (5), mean x of the interval's points [m].
        x_m: Place of the arm's base, S_i_x + k Delta L [m].
        y_m: S_i_y of step (3) [m].
        k: Number of radial steps.
        counts: N_p_i,k: points reached at k = 1.. K_max, shape (K_max,).
        reached: M_fill_i: points reached at the chosen k, shape (n,).
        own: Points of the interval, M_i, shape (n,).
    """

    start_x_m: float
    x_m: float
    y_m: float
    k: int
    counts: NDArray[np.int64]
    reached: NDArray[np.bool_]
    own: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class AxialRadialPlan:
    """What the algorithm ends with.

    Attributes:
        stations: In rising y.
        complete: Both conditions of step (9) hold. False: S_num ended, and these stations cover
            the most points of all S_num tried.
        reached_sum: N_sum of these stations.
        history: (S_num, N_sum, points covered) of every S_num tried.
    """

    stations: tuple[RadialStation, ...]
    complete: bool
    reached_sum: int
    history: tuple[tuple[int, int, int], ...]

    @property
    def covered(self) -> NDArray[np.bool_]:
        """Points that some station reaches, shape (n,)."""
        return np.any([station.reached for station in self.stations], axis=0)


def plan_axial_radial(
    points: Array, reach: Reach, settings: AxialRadialSettings | None = None
) -> AxialRadialPlan:
    """Finds the stations.

    Args:
        points: M, measuring points in the axial frame, shape (n, 3) [m].
        reach: Asked at every place of step (6).
        settings: Figures; None = those of the paper.

    Returns:
        The first S_num that fulfils step (9), or the best of all tried.

    Raises:
        InspectionPointsError: No points, wrong shape, values that are not finite or not metres.
        NothingReachedError: No point is reached from any place tried.
    """
    settings = settings or AxialRadialSettings()
    points = require_points(points)
    best: AxialRadialPlan | None = None
    history: list[tuple[int, int, int]] = []
    for count in range(1, settings.stations_max + 1):
        stations = _stations(points, count, reach, settings)
        total = int(sum(station.reached.sum() for station in stations))
        covered = int(np.any([station.reached for station in stations], axis=0).sum())
        history.append((count, total, covered))
        overlap = total > len(points) or not settings.overlap_required
        plan = AxialRadialPlan(stations, overlap and covered == len(points), total, tuple(history))
        _LOG.debug("%d stations: sum %d, %d of %d covered", count, total, covered, len(points))
        if plan.complete:
            return plan
        if best is None or covered > int(best.covered.sum()):
            best = plan
    if best is None or not best.covered.any():
        raise NothingReachedError(
            f"none of {len(points)} points is reached from up to {settings.stations_max} stations "
            f"at {settings.k_max} radial steps of {settings.step_m} m"
        )
    return AxialRadialPlan(best.stations, False, best.reached_sum, tuple(history))


def axial_bins(y: Array, count: int) -> tuple[NDArray[np.int64], Array]:
    """Steps (1), (3), (4): interval of each point, shape (n,), and S_i_y, shape (count,) [m]."""
    low, span = float(y.min()), float(np.ptp(y))
    middles = low + (2.0 * np.arange(1, count + 1) - 1.0) * span / (2.0 * count)
    share = np.zeros(len(y)) if span == 0.0 else (y - low) / span
    bins = np.minimum((share * count).astype(np.int64), count - 1)
    return np.asarray(bins, dtype=np.int64), np.asarray(middles)


def _stations(
    points: Array, count: int, reach: Reach, settings: AxialRadialSettings
) -> tuple[RadialStation, ...]:
    bins, middles = axial_bins(points[:, 1], count)
    found = []
    for number, y in enumerate(middles.tolist()):
        own = bins == number
        if not own.any():
            continue
        start = float(points[own, 0].mean())
        places = start + settings.step_m * np.arange(1, settings.k_max + 1)
        rows = np.array([reach(float(x), y) for x in places], dtype=bool)
        counts = rows.sum(axis=1)
        ties = np.flatnonzero(counts == counts.max())
        k = int(ties[(len(ties) - 1) // 2 if settings.middle_of_ties else 0])
        found.append(
            RadialStation(start, float(places[k]), y, k + 1, counts.astype(np.int64), rows[k], own)
        )
    return tuple(found)
