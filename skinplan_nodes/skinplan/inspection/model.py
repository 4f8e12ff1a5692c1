"""Results of a measurement, as the rooms exchange them."""

from dataclasses import dataclass

from skinplan.transforms import Array


@dataclass(frozen=True, eq=False)
class Alignment:
    """The measured cloud laid on the part.

    Attributes:
        T_tracker_workpiece: shape (4, 4) [m].
        rms_m: Root mean square of the point-to-plane residual of the points used [m].
        iterations: Iterations made.
        converged: Whether the last step was below the bound.
    """

    T_tracker_workpiece: Array
    rms_m: float
    iterations: int
    converged: bool


@dataclass(frozen=True, eq=False)
class Inspection:
    """What was measured.

    Attributes:
        alignment: Where the part stands in the tracker frame.
        points: Number of points of the merged cloud.
        deviation: Signed deviation along the surface normal of each point, shape (n,) [m]; NaN = on
            no surface.
        deviation_rms_m: Root mean square of it [m].
        area_ratio: Share of the part's area measured.
        feature_area_ratio: Same, complex regions only; NaN without any.
    """

    alignment: Alignment
    points: int
    deviation: Array
    deviation_rms_m: float
    area_ratio: float
    feature_area_ratio: float
