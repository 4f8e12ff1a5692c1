"""What a cloud says about each small piece of the surface, about regions, and what it leaves out.

Pieces are the samples of the surface, some millimetres apart. The mean deviation of the points of a
piece, its local deviation, is what tolerances are held against: noise of single points averages
out, a dent does not.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from skinplan.scanner.model import SurfaceSamples
from skinplan.transforms import Array

# Fewer points make no local deviation.
FEWEST_POINTS = 3
# Pieces beside one, itself included, and how many spacings away they may be.
_BESIDE, _NEIGHBOURS = 7, 1.6
# Missing pieces so many times their spacing apart are one area.
_TOGETHER = 2.0


@dataclass(frozen=True, eq=False)
class RegionFigures:
    """One region, or the whole part.

    Attributes:
        region: Number; 0 = the surface beside the complex regions, -1 = the whole part.
        area_m2: Its area [m^2].
        area_ratio: Share of it measured [1].
        points: Points on it.
        mean_m: Mean deviation of the points [m]; NaN without any, as all below.
        sigma_m: Standard deviation [m].
        min_m: Smallest deviation of a point [m].
        max_m: Largest [m].
        worst_m: Local deviation that is farthest from zero [m].
        worst_at: Where that is, shape (3,) [m].
        within_ratio: Share of the measured area whose local deviation is within tolerance [1]; NaN
            without a tolerance.
        density_per_m2: Median number of points on a square metre.
    """

    region: int
    area_m2: float
    area_ratio: float
    points: int
    mean_m: float
    sigma_m: float
    min_m: float
    max_m: float
    worst_m: float
    worst_at: Array
    within_ratio: float
    density_per_m2: float


@dataclass(frozen=True, eq=False)
class MissingArea:
    """A connected piece of surface that was not measured.

    Attributes:
        area_m2: Its area [m^2].
        centre: Its middle, shape (3,) [m].
        size: Extent along x, y, z, shape (3,) [m].
        region: Region of most of it.
    """

    area_m2: float
    centre: Array
    size: Array
    region: int


@dataclass(eq=False)
class SurfaceFigures:
    """Sums of the deviations of each sample's points; grows with every batch.

    Attributes:
        samples: The pieces of the surface, workpiece frame.
        region: Their regions, shape (s,).
        count: Points of each, shape (s,).
    """

    samples: SurfaceSamples
    region: NDArray[np.int64]
    count: NDArray[np.int64] = field(init=False)

    def __post_init__(self) -> None:
        """Begins with nothing."""
        number = len(self.samples.points)
        self.count = np.zeros(number, dtype=np.int64)
        self._sum, self._squares = np.zeros(number), np.zeros(number)
        self._low, self._high = np.full(number, np.inf), np.full(number, -np.inf)

    def add(self, sample: NDArray[np.int64], deviation: Array) -> None:
        """Takes points in.

        Args:
            sample: Nearest sample of each point, shape (n,).
            deviation: shape (n,) [m]; NaN = left out.
        """
        known = np.isfinite(deviation)
        sample, deviation = sample[known], deviation[known]
        number = len(self.count)
        self.count += np.bincount(sample, minlength=number)
        self._sum += np.bincount(sample, deviation, number)
        self._squares += np.bincount(sample, deviation**2, number)
        np.minimum.at(self._low, sample, deviation)
        np.maximum.at(self._high, sample, deviation)

    @property
    def local(self) -> Array:
        """Local deviations, shape (s,) [m]; NaN with too few points.

        A piece with too few points of its own takes those of the pieces beside it, too.
        """
        count, total = self.count.copy(), self._sum.copy()
        few = np.flatnonzero(count < FEWEST_POINTS)
        if len(few) and len(count) >= _BESIDE:
            reach = _NEIGHBOURS * float(np.sqrt(self.samples.weights.max()))
            _, near = cKDTree(self.samples.points).query(
                self.samples.points[few], k=_BESIDE, distance_upper_bound=reach
            )
            padded = np.append(self.count, 0), np.append(self._sum, 0.0)
            count[few], total[few] = (values[near].sum(axis=1) for values in padded)
        return np.where(count >= FEWEST_POINTS, total / np.maximum(count, 1), np.nan)

    @property
    def sigma(self) -> Array:
        """Standard deviation of each sample's points, shape (s,) [m]; NaN with too few points."""
        mean = self._sum / np.maximum(self.count, 1)
        variance = self._squares / np.maximum(self.count, 1) - mean**2
        return np.where(self.count >= FEWEST_POINTS, np.sqrt(np.maximum(variance, 0.0)), np.nan)

    @property
    def low(self) -> Array:
        """Smallest deviation of each sample's points, shape (s,) [m]; NaN without any."""
        return np.where(self.count > 0, self._low, np.nan)

    @property
    def high(self) -> Array:
        """Largest deviation, as `low`."""
        return np.where(self.count > 0, self._high, np.nan)

    def regions(
        self, measured: NDArray[np.bool_], deviation_max_m: float
    ) -> tuple[RegionFigures, ...]:
        """Returns the figures of the whole part, then of each region.

        Args:
            measured: Which samples count as measured, shape (s,).
            deviation_max_m: Tolerance of the local deviation [m]; NaN = none.
        """
        whole = np.ones(len(self.count), dtype=bool)
        chosen = [(-1, whole)]
        chosen += [(int(k), self.region == k) for k in np.unique(self.region)]
        return tuple(self._figures(k, part, measured, deviation_max_m) for k, part in chosen)

    def _figures(
        self,
        region: int,
        part: NDArray[np.bool_],
        measured: NDArray[np.bool_],
        deviation_max_m: float,
    ) -> RegionFigures:
        weights, local = self.samples.weights, self.local
        area, seen = float(weights[part].sum()), part & measured
        points = int(self.count[part].sum())
        mean = float(self._sum[part].sum() / points) if points else np.nan
        variance = float(self._squares[part].sum() / points) - mean**2 if points else np.nan
        known = np.flatnonzero(part & np.isfinite(local))
        worst = known[np.argmax(np.abs(local[known]))] if len(known) else -1
        within = np.nan
        if np.isfinite(deviation_max_m) and len(known):
            good = np.abs(local[known]) <= deviation_max_m
            within = float(weights[known][good].sum() / weights[known].sum())
        return RegionFigures(
            region=region,
            area_m2=area,
            area_ratio=float(weights[seen].sum()) / area if area > 0.0 else np.nan,
            points=points,
            mean_m=mean,
            sigma_m=float(np.sqrt(max(variance, 0.0))) if points else np.nan,
            min_m=float(self._low[part].min()) if points else np.nan,
            max_m=float(self._high[part].max()) if points else np.nan,
            worst_m=float(local[worst]) if worst >= 0 else np.nan,
            worst_at=self.samples.points[worst] if worst >= 0 else np.full(3, np.nan),
            within_ratio=within,
            density_per_m2=float(np.median(self.count[seen] / weights[seen]))
            if seen.any()
            else np.nan,
        )

    def missing(self, measured: NDArray[np.bool_]) -> tuple[MissingArea, ...]:
        """Returns the connected areas that were not measured, the largest first."""
        left = np.flatnonzero(~measured)
        if len(left) == 0:
            return ()
        points, weights = self.samples.points[left], self.samples.weights[left]
        reach = _TOGETHER * float(np.sqrt(weights.max()))
        pairs = cKDTree(points).query_pairs(reach, output_type="ndarray")
        ones = np.ones(len(pairs), dtype=np.int8)
        graph = coo_array((ones, (pairs[:, 0], pairs[:, 1])), shape=(len(left), len(left)))
        count, number = connected_components(graph, directed=False)
        found = [self._area(left[number == k]) for k in range(count)]
        return tuple(sorted(found, key=lambda area: -area.area_m2))

    def _area(self, chosen: NDArray[np.int64]) -> MissingArea:
        points, weights = self.samples.points[chosen], self.samples.weights[chosen]
        return MissingArea(
            float(weights.sum()),
            np.average(points, axis=0, weights=weights),
            np.ptp(points, axis=0),
            int(np.bincount(self.region[chosen]).argmax()),
        )
