"""The scanner (M2.1) and what it sees."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.part.model import ScanSettings
from skinplan.transforms import Array


@dataclass(frozen=True)
class ScannerModel:
    """Field of view about the scanner's +x axis: the paper's cylinder.

    Attributes:
        field_radius_m: r_f [m].
        range_min_m: d_min [m].
        range_max_m: d_max [m].
        standoff_m: d_best [m].
        incidence_max_rad: Largest angle between view axis and inward surface normal [rad].
    """

    field_radius_m: float
    range_min_m: float
    range_max_m: float
    standoff_m: float
    incidence_max_rad: float

    @classmethod
    def from_settings(cls, scan: ScanSettings) -> "ScannerModel":
        """Takes the scanner's figures from a part's scan settings."""
        return cls(
            scan.field_radius_m,
            scan.range_min_m,
            scan.range_max_m,
            scan.standoff_m,
            scan.incidence_max_rad,
        )


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
class CoverageFigures:
    """Shares of the area that a scan path sees, beside those of row cutting (Fig. 21 of M).

    Attributes:
        area_ratio: Share of the area seen at least once [1].
        feature_area_ratio: Same, complex regions only; NaN without any.
        rows_only_area_ratio: Same, by row cutting over the whole part alone.
        rows_only_feature_area_ratio: Same, complex regions by row cutting alone; NaN without any.
    """

    area_ratio: float
    feature_area_ratio: float
    rows_only_area_ratio: float
    rows_only_feature_area_ratio: float


@dataclass(frozen=True, eq=False)
class Coverage:
    """What a set of views sees; `skinplan.scanner.coverage` says what counts as seen.

    Attributes:
        samples: The surface samples judged.
        views: Number of views that see each sample, shape (s,).
        area_ratio: Share of the area seen at least once [1].
        feature_area_ratio: Same, complex regions only; NaN without any.
    """

    samples: SurfaceSamples
    views: NDArray[np.int64]
    area_ratio: float
    feature_area_ratio: float
