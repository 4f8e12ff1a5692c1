"""The scanner (M2.1) and what it sees."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import InputError
from skinplan.mesh.model import SurfaceMesh
from skinplan.part.model import ScanSettings
from skinplan.scanner.facets import facet_codes
from skinplan.scanner.sight import Sight
from skinplan.transforms import Array

CYLINDER = "cylinder"
CONE = "cone"


@dataclass(frozen=True)
class ScannerModel:
    """Field of view about the scanner's +x axis (M2.1): the paper's cylinder, or its cone.

    Attributes:
        field_radius_m: r_f, radius of the cylinder, and of the cone's section at d_min [m].
        range_min_m: d_min, along the axis [m].
        range_max_m: d_max, along the axis [m].
        standoff_m: d_best [m].
        incidence_max_rad: Largest angle between view axis and inward surface normal [rad].
        field: ``cylinder`` or ``cone``.

    Raises:
        InputError: A figure that is not finite or out of order, or another field of view.
    """

    field_radius_m: float
    range_min_m: float
    range_max_m: float
    standoff_m: float
    incidence_max_rad: float
    field: str = CYLINDER

    def __post_init__(self) -> None:
        if self.field not in (CYLINDER, CONE):
            raise InputError(
                f"scanner: a field {CYLINDER} or {CONE} is accepted, found {self.field!r}"
            )
        if not 0.0 < self.field_radius_m < math.inf:
            raise InputError(
                f"scanner: a radius above 0 is accepted, found {self.field_radius_m} m"
            )
        if not 0.0 < self.range_min_m < self.range_max_m < math.inf:
            raise InputError(
                "scanner: a range 0 < d_min < d_max is accepted, found "
                f"{self.range_min_m} to {self.range_max_m} m"
            )
        if not 0.0 < self.standoff_m < math.inf:
            raise InputError(f"scanner: a stand-off above 0 is accepted, found {self.standoff_m} m")
        if not 0.0 < self.incidence_max_rad <= math.pi / 2:
            raise InputError(
                "scanner: an incidence limit above 0 up to pi/2 is accepted, found "
                f"{self.incidence_max_rad} rad"
            )

    @classmethod
    def from_settings(cls, scan: ScanSettings) -> "ScannerModel":
        """Takes the scanner's figures from a part's scan settings."""
        return cls(
            scan.field_radius_m,
            scan.range_min_m,
            scan.range_max_m,
            scan.standoff_m,
            scan.incidence_max_rad,
            scan.field_of_view,
        )

    def narrowed(self, field_margin_m: float, incidence_margin_rad: float) -> "ScannerModel":
        """Returns the scanner so far inside its field of view, range [m] and incidence limit."""
        return replace(
            self,
            field_radius_m=self.field_radius_m - field_margin_m,
            range_min_m=self.range_min_m + field_margin_m,
            range_max_m=self.range_max_m - field_margin_m,
            incidence_max_rad=self.incidence_max_rad - incidence_margin_rad,
        )

    def field_radius(self, depth: Array | float) -> Array | float:
        """Returns the radius of the field [m] at a depth along the axis [m], shape as given."""
        if self.field == CONE:
            return self.field_radius_m / self.range_min_m * depth
        return self.field_radius_m


@dataclass(frozen=True, eq=False)
class SurfaceSamples:
    """Points spread evenly over a mesh, for area-weighted figures.

    Attributes:
        points: shape (s, 3) [m].
        normals: Outward unit normals of their faces, shape (s, 3).
        faces: Number of the face of each, shape (s,).
        weights: Area that each stands for, shape (s,) [m^2].
    """

    points: Array
    normals: Array
    faces: NDArray[np.int64]
    weights: Array


@dataclass(frozen=True)
class RegionShares:
    """Figures of a region of a part in short; NaN = nothing there, or not asked.

    Attributes:
        name: ``whole part``, ``flat surface``, ``complex regions`` (all of them together) or
            ``region <number>``.
        area_m2: Area [m^2].
        seen_ratio: Share of the area seen at least once [1].
        often_seen_ratio: Share of the area seen at least as often as asked for [1].
        seeable_ratio: Share of the area that can be seen at all [1].
        seen_of_seeable_ratio: Share of that area seen at least once [1].
        often_seen_of_seeable_ratio: Share of that area seen at least as often as asked for [1].
        axis_rad: Median, 95 % and largest of the best incidence against the view axis [rad].
        ray_rad: Same against the ray from the scanner's origin.
        ray_within_limit_ratio: Share of the seen area whose best ray is within the limit [1].
        areas_m2: Area in each state of `Sight`, shape (8,) [m^2].
    """

    name: str
    area_m2: float
    seen_ratio: float
    often_seen_ratio: float
    seeable_ratio: float
    seen_of_seeable_ratio: float
    often_seen_of_seeable_ratio: float
    axis_rad: tuple[float, float, float]
    ray_rad: tuple[float, float, float]
    ray_within_limit_ratio: float
    areas_m2: tuple[float, ...]


@dataclass(frozen=True)
class CoverageFigures:
    """Shares of the area that a scan path sees, beside those of row cutting (Fig. 21 of M).

    Attributes:
        area_ratio: Share of the area seen at least once [1].
        feature_area_ratio: Same, complex regions only; NaN without any.
        rows_only_area_ratio: Same, by row cutting over the whole part alone.
        rows_only_feature_area_ratio: Same, complex regions by row cutting alone; NaN without any.
        least_views: Number of views that each place should be seen by.
        regions: The whole part, the flat surface, all complex regions together, then each of them;
            empty = not known.
    """

    area_ratio: float
    feature_area_ratio: float
    rows_only_area_ratio: float
    rows_only_feature_area_ratio: float
    least_views: int = 0
    regions: tuple[RegionShares, ...] = ()


@dataclass(frozen=True, eq=False)
class Coverage:
    """What a set of views sees; `skinplan.scanner.coverage` says what counts as seen.

    Attributes:
        samples: The surface samples judged.
        views: Number of views that see each sample, shape (s,); counts below `least_views` are
            exact, those from there on are exact for points and at least right along motion.
        area_ratio: Share of the area seen at least once [1].
        feature_area_ratio: Same, complex regions only; NaN without any.
        mesh: The part.
        regions: Complex region of each sample, 0 = flat surface, shape (s,).
        scanner: The scanner.
        least_views: Number n of views asked for.
        axis_rad: Smallest angle between the view axis and the inward normal among the views that
            see a sample, shape (s,) [rad]; NaN where none does. Along motion only the views tested
            count.
        ray_rad: Same for the ray from the scanner's origin.
        reasons: `Sight` of what is not seen, by the views alone; SEEN where seen; shape (s,).
        can_be_seen: Whether any admissible pose sees a sample, shape (s,); None = not asked. What a
            view sees can be seen.
        seeable_area_ratio: Share of the area that can be seen at all [1]; NaN when not asked.
        area_ratio_of_seeable: Share of that area seen at least once [1]; NaN when not asked.
        feature_area_ratio_of_seeable: Same, complex regions only.
    """

    samples: SurfaceSamples
    views: NDArray[np.int64]
    area_ratio: float
    feature_area_ratio: float
    mesh: SurfaceMesh
    regions: NDArray[np.int64]
    scanner: ScannerModel
    least_views: int
    axis_rad: Array
    ray_rad: Array
    reasons: NDArray[np.int8]
    can_be_seen: NDArray[np.bool_] | None = None
    seeable_area_ratio: float = math.nan
    area_ratio_of_seeable: float = math.nan
    feature_area_ratio_of_seeable: float = math.nan

    @cached_property
    def sights(self) -> NDArray[np.int8]:
        """`Sight` of each sample, shape (s,)."""
        result = np.where(self.views >= self.least_views, Sight.SEEN_OFTEN, self.reasons)
        if self.can_be_seen is not None:
            result[~self.can_be_seen] = Sight.CANNOT_BE_SEEN
        return result.astype(np.int8)

    @cached_property
    def facet_sights(self) -> NDArray[np.int8]:
        """`Sight` of each facet, shape (f,); `skinplan.scanner.facets` says how it is found."""
        samples = self.samples
        return facet_codes(self.mesh, samples.points, samples.normals, samples.faces, self.sights)

    @cached_property
    def facet_reasons(self) -> NDArray[np.int8]:
        """`Sight` of each facet by the views alone, shape (f,): why, also for CANNOT_BE_SEEN."""
        if self.can_be_seen is None or self.can_be_seen.all():
            return self.facet_sights
        samples = self.samples
        spread = facet_codes(
            self.mesh, samples.points, samples.normals, samples.faces, self.reasons
        )
        lost = self.facet_sights == Sight.CANNOT_BE_SEEN
        return np.where(lost, spread, self.facet_sights).astype(np.int8)
