"""Results of a measurement, as the rooms exchange them."""

from dataclasses import dataclass

import numpy as np

from skinplan.inspection.surface import SurfaceFigures
from skinplan.transforms import Array


@dataclass(frozen=True, eq=False)
class Motion:
    """A small rigid motion about the middle of the cloud, workpiece frame.

    Attributes:
        turn: Rotation vector for each metre of motion, shape (3,) [rad/m]; zero = a pure shift.
        shift: Translation for each metre of motion, shape (3,) [1].
    """

    turn: Array
    shift: Array

    @property
    def text(self) -> str:
        """What moves, in words."""
        axis = self.turn if np.any(self.turn) else self.shift
        unit = axis / max(float(np.linalg.norm(axis)), 1e-12)
        unit = unit * (1.0 if unit[np.argmax(np.abs(unit))] >= 0.0 else -1.0)
        named = ", ".join(f"{round(float(value), 2) + 0.0:.2f}" for value in unit)
        return f"turn about ({named})" if np.any(self.turn) else f"shift along ({named})"


@dataclass(frozen=True, eq=False)
class Alignment:
    """The measured cloud laid on the part.

    Attributes:
        T_tracker_workpiece: shape (4, 4) [m].
        rms_m: Root mean square of the point-to-plane residual of the points used [m].
        iterations: Iterations made.
        converged: Whether the last step was below the bound.
        used_ratio: Share of the points that lie on the surface [1].
        covariance: Of the pose by the scatter of the residual: rotation vector [rad] and position
            [m] about the middle of the cloud, workpiece frame, shape (6, 6); directions that are
            undetermined have none. None = not known.
        middle: That point, workpiece frame, shape (3,) [m]; None = not known.
        undetermined: Motions that nothing measured speaks about: there the coarse pose was kept.
        by_border: The border of the part was used, because its surface leaves a motion open.
        condition: Information about the best over that about the worst known motion [1].
    """

    T_tracker_workpiece: Array
    rms_m: float
    iterations: int
    converged: bool
    used_ratio: float = float("nan")
    covariance: Array | None = None
    middle: Array | None = None
    undetermined: tuple[Motion, ...] = ()
    by_border: bool = False
    condition: float = float("nan")

    @property
    def position_sigma_m(self) -> float:
        """Standard deviation of the position of the middle [m]; NaN = not known."""
        return self._sigma(3)

    @property
    def angle_sigma_rad(self) -> float:
        """Standard deviation of the orientation; NaN = not known."""
        return self._sigma(0)

    def _sigma(self, first: int) -> float:
        if self.covariance is None:
            return float("nan")
        block = self.covariance[first : first + 3, first : first + 3]
        return float(np.sqrt(max(float(np.trace(block)), 0.0)))


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
        surface: Deviations of each small piece of the surface; None = not known.
    """

    alignment: Alignment
    points: int
    deviation: Array
    deviation_rms_m: float
    area_ratio: float
    feature_area_ratio: float
    surface: SurfaceFigures | None = None
