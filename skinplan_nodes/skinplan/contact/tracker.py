"""One place for the tracker from which it sees the T-Mac at every point (C 4, static check).

Candidates are a grid around the part. A point counts as seen when one of its options (station,
branch, roll) lies within the limits and its beam is free. Candidates that fail by angles alone go
first. Of the rest those come first whose worst incidence angle leaves room for the motion between
the points, the nearest first: a tracker's error grows with the range.
"""

import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.contact.model import TrackerStation
from skinplan.contact.probing_arm import ProbingArm
from skinplan.contact.sight import Sight
from skinplan.robot.shapes import box_distances
from skinplan.transforms import Array

_LOG = logging.getLogger(__name__)
_MARGIN_M = 3.0  # the grid reaches so far beyond the points
_STEP_M = 0.4
_HEIGHTS_M = (1.1, 1.5, 1.9)  # of the tracker's head above the floor
_PART_CLEARANCE_M = 0.5
_COMFORT = 0.6  # share of the incidence limit up to which candidates are ranked by range


@dataclass(frozen=True, eq=False)
class SightOptions:
    """All ways to measure all points, with what the tracker would look at.

    Attributes:
        point: Number of the point, shape (m,).
        station: Number of the station, shape (m,).
        q: Joint positions, shape (m, 6) [rad].
        T_axial_mirror: Mirrors, shape (m, 4, 4) [m].
        count: Number of points n.
    """

    point: NDArray[np.int64]
    station: NDArray[np.int64]
    q: Array
    T_axial_mirror: Array
    count: int

    def chosen(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> "SightOptions":
        """Returns some of the options."""
        return SightOptions(
            self.point[which],
            self.station[which],
            self.q[which],
            self.T_axial_mirror[which],
            self.count,
        )


def tracker_candidates(points: Array, bounds: Array, arms: Array, arm: ProbingArm) -> Array:
    """Returns places for the tracker, shape (c, 3) [m], axial frame.

    They are on a grid about the points, clear of the part's box and outside the arm's reach from
    every station.

    Args:
        points: Measuring points, shape (n, 3) [m].
        bounds: Box of the part, shape (2, 3) [m].
        arms: Places of the arm's base, shape (s, 2) [m].
        arm: The arm.
    """
    low, high = points.min(axis=0) - _MARGIN_M, points.max(axis=0) + _MARGIN_M
    axes = [np.arange(low[k], high[k] + _STEP_M, _STEP_M) for k in range(2)]
    heights = np.array(_HEIGHTS_M) - arm.settings.base_height_m
    grid = np.stack(np.meshgrid(*axes, heights, indexing="ij"), axis=-1).reshape(-1, 3)
    clear = box_distances(grid, bounds[0], bounds[1]) >= _PART_CLEARANCE_M
    reach = float(arm.arm.lever_arms()[0])
    gaps = np.linalg.norm(grid[:, None, :2] - arms[None], axis=2)
    return np.asarray(grid[clear & np.all(gaps >= reach, axis=1)])


def ranked(candidates: Array, options: SightOptions, sight: Sight) -> list[tuple[int, float]]:
    """Candidates whose angles and ranges allow all points, best first.

    Args:
        candidates: shape (c, 3) [m].
        options: All ways to measure the points.
        sight: The limits.

    Returns:
        (number of the candidate, worst over the points of the least incidence angle [rad]).
    """
    found = []
    limit = _COMFORT * sight.incidence_max_rad
    for number, place in enumerate(candidates):
        beams = sight.beams(place, options.T_axial_mirror)
        least = np.full(options.count, np.inf)
        np.minimum.at(least, options.point, np.where(beams.allowed, beams.incidence_rad, np.inf))
        worst = float(least[np.unique(options.point)].max(initial=0.0))
        if np.isfinite(worst):
            easy = worst <= limit
            rank = float(beams.range_m.mean()) if easy else worst
            found.append((not easy, round(rank, 6), number, worst))
    return [(number, worst) for _, _, number, worst in sorted(found)]


def seen_options(
    tracker: Array, options: SightOptions, places: tuple[Array, ...], sight: Sight
) -> NDArray[np.int64]:
    """Returns the numbers of the options at which the tracker holds the T-Mac, rising.

    Args:
        tracker: Its place, shape (3,) [m].
        options: All ways to measure the points.
        places: ``T_axial_arm`` of the stations, each of shape (4, 4) [m].
        sight: Line of sight.
    """
    picked = np.flatnonzero(sight.beams(tracker, options.T_axial_mirror).allowed)
    picked = picked[sight.past_part(tracker, options.T_axial_mirror[picked, :3, 3])]
    kept = []
    for station, place in enumerate(places):
        here = picked[options.station[picked] == station]
        mirrors = options.T_axial_mirror[here, :3, 3]
        kept.append(here[sight.past_arm(tracker, mirrors, options.q[here], place)])
    return np.sort(np.concatenate(kept)) if kept else np.zeros(0, dtype=np.int64)


def find_tracker(
    candidates: Array, options: SightOptions, places: tuple[Array, ...], sight: Sight, most: int
) -> list[tuple[Array, NDArray[np.int64]]]:
    """Returns up to ``most`` places that see all points that have options, best first.

    Args:
        candidates: shape (c, 3) [m].
        options: All ways to measure the points.
        places: ``T_axial_arm`` of the stations.
        sight: Line of sight.
        most: How many places are wanted.

    Returns:
        Each with the numbers of the options that it sees.
    """
    wanted = len(np.unique(options.point))
    found = []
    order = ranked(candidates, options, sight)
    _LOG.debug("%d of %d tracker candidates allowed by angles", len(order), len(candidates))
    for number, _ in order:
        seen = seen_options(candidates[number], options, places, sight)
        if len(np.unique(options.point[seen])) == wanted:
            found.append((candidates[number], seen))
            if len(found) == most:
                break
    return found


def tracker_station(tracker: Array, options: SightOptions, sight: Sight) -> TrackerStation:
    """Measures the beams at the best of the given options of each point.

    Args:
        tracker: Its place, shape (3,) [m].
        options: Options that the tracker sees.
        sight: Line of sight.
    """
    beams = sight.beams(tracker, options.T_axial_mirror)
    figures = np.full((3, options.count), np.nan)
    order = np.lexsort((-beams.incidence_rad,))  # the least incidence is written last
    values = np.stack([beams.emission_rad, beams.incidence_rad, beams.range_m])
    figures[:, options.point[order]] = values[:, order]
    return TrackerStation(np.asarray(tracker, dtype=float), np.isfinite(figures[0]), *figures)
