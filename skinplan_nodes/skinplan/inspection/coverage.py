"""Which part of the surface has been measured.

A sample counts when a measured point lies near it, seen from its outside.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skinplan.errors import InputError
from skinplan.inspection.points import checked_points
from skinplan.scanner.model import SurfaceSamples
from skinplan.transforms import Array

RADIUS_M = 0.008
# A view this oblique or more does not measure a sample; 90 degrees = seen from its edge.
SIDE_ANGLE_RAD = float(np.deg2rad(85.0))
_BATCH = 100_000


class CoverageSoFar:
    """Coverage that grows with every scan frame. Each frame costs a query of its own points only.

    Args:
        samples: Even samples of the part, workpiece frame.
        feature: Which of them lie in a complex region, shape (s,) bool; None = none.
        radius_m: A sample counts as measured when a point lies within this distance [m].
        side_angle_rad: Largest angle between the outward normal and the way back to the scanner.

    Raises:
        InputError: A radius or an angle that is not positive.
    """

    def __init__(
        self,
        samples: SurfaceSamples,
        feature: NDArray[np.bool_] | None = None,
        radius_m: float = RADIUS_M,
        side_angle_rad: float = SIDE_ANGLE_RAD,
    ) -> None:
        if not (radius_m > 0.0 and side_angle_rad > 0.0):
            raise InputError(
                f"coverage: a radius and an angle above 0 are accepted, found {radius_m}, "
                f"{side_angle_rad}"
            )
        self.samples = samples
        self.radius_m = radius_m
        self.measured: NDArray[np.bool_] = np.zeros(len(samples.points), dtype=bool)
        self.points = 0
        self._cosine = float(np.cos(side_angle_rad))
        self._feature = np.zeros(len(samples.points), dtype=bool) if feature is None else feature
        # Samples in the order of their x: a frame looks at a slice of them.
        self._order = np.argsort(samples.points[:, 0], kind="stable")
        self._x = samples.points[self._order, 0]

    def add(self, points: Array, directions: Array | None = None) -> int:
        """Takes measured points in.

        Args:
            points: Workpiece frame, shape (n, 3) [m].
            directions: Unit view directions (away from the scanner), one for all, shape (3,), or
                one for each,
                shape (n, 3); None = the side is not checked.

        Returns:
            Number of samples that were not measured before.

        Raises:
            InputError: Points that are not finite, or directions of another shape.
        """
        cloud = checked_points(points)
        views = None if directions is None else np.asarray(directions, dtype=float)
        if views is not None and views.shape not in ((3,), cloud.shape):
            raise InputError(
                f"directions: shape (3,) or {cloud.shape} is accepted, found {views.shape}"
            )
        before = int(np.count_nonzero(self.measured))
        for begin in range(0, len(cloud), _BATCH):
            part = slice(begin, begin + _BATCH)
            self._add(cloud[part], views if views is None or views.ndim == 1 else views[part])
        self.points += len(cloud)
        return int(np.count_nonzero(self.measured)) - before

    @property
    def area_ratio(self) -> float:
        """Share of the area measured [1]."""
        return self._ratio(np.ones(len(self.measured), dtype=bool))

    @property
    def feature_area_ratio(self) -> float:
        """Share of the area of complex regions measured [1]; NaN without any."""
        return self._ratio(self._feature)

    def _ratio(self, chosen: NDArray[np.bool_]) -> float:
        total = float(self.samples.weights[chosen].sum())
        return (
            float(self.samples.weights[chosen & self.measured].sum()) / total
            if total > 0.0
            else float("nan")
        )

    def _add(self, cloud: Array, views: Array | None) -> None:
        waiting = self._waiting_near(cloud)
        if views is not None and views.ndim == 1:
            waiting = waiting[-(self.samples.normals[waiting] @ views) > self._cosine]
        if len(waiting) == 0:
            return
        tree = cKDTree(cloud)
        if views is None or views.ndim == 1:
            distance, _ = tree.query(
                self.samples.points[waiting], distance_upper_bound=self.radius_m
            )
            self.measured[waiting[np.isfinite(distance)]] = True
            return
        # Points of several views together: the nearest ones may be of the other side.
        count = min(8, len(cloud))
        distance, near = tree.query(
            self.samples.points[waiting], k=count, distance_upper_bound=self.radius_m
        )
        distance, near = distance.reshape(-1, count), near.reshape(-1, count)
        back = np.vstack([-views, np.zeros(3)])[near]
        facing = np.einsum("skj,sj->sk", back, self.samples.normals[waiting]) > self._cosine
        self.measured[waiting[np.any(np.isfinite(distance) & facing, axis=1)]] = True

    def _waiting_near(self, cloud: Array) -> NDArray[np.int64]:
        low, high = cloud.min(axis=0) - self.radius_m, cloud.max(axis=0) + self.radius_m
        begin, end = np.searchsorted(self._x, [low[0], high[0]])
        near = self._order[begin:end]
        near = near[~self.measured[near]]
        points = self.samples.points[near]
        return near[np.all((points[:, 1:] >= low[1:]) & (points[:, 1:] <= high[1:]), axis=1)]
