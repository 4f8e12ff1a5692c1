"""Whether a pose by the shape is good enough to plan by, in the place of eq (3) for markers.

The bound is what poses by markers with E >= T_E keep: 2 mm and 0.1 degrees (M1.1). At the end of a
panel of 3 m that is 4.6 mm, well within the collision margin of the arm (20 mm), and the alignment
of the scan starts from ten times as much.
"""

from dataclasses import dataclass

import numpy as np

from skinplan.localization.chain import LocatedPart
from skinplan.localization.model import CameraModel
from skinplan.mesh.model import SurfaceMesh
from skinplan.recognition.shape_pose import ShapePose
from skinplan.recognition.verdict import AMBIGUOUS, FAILED, GOOD
from skinplan.recognition.view import Candidate, ViewSettings, fit_view
from skinplan.transforms import Array, rotate


@dataclass(frozen=True)
class GateSettings:
    """What a pose has to be good to.

    Attributes:
        position_max_m: Largest error of the part's middle [m] ...
        angle_max_rad: ... and of its orientation.
        sigmas: So many standard deviations count as the error [1].
    """

    position_max_m: float = 0.002
    angle_max_rad: float = float(np.radians(0.1))
    sigmas: float = 3.0


@dataclass(frozen=True)
class ShapeVerdict:
    """What a pose by the shape is worth.

    Attributes:
        grade: `GOOD`, `AMBIGUOUS` or `FAILED`.
        seen_ratio: Share of the part's area that the images show [1]; NaN = not looked at.
        is_judged: Enough of the part should be seen to say anything.
        reason: In one sentence.
    """

    grade: str
    seen_ratio: float
    is_judged: bool
    reason: str


def judge_shape(
    points: Array,
    camera: CameraModel,
    mesh: SurfaceMesh,
    found: ShapePose,
    settings: ViewSettings,
) -> ShapeVerdict:
    """Judges a pose: whether what is there looks like the part, and whether the place is told.

    Args:
        points: The depth images, optical frame, shape (n, 3) [m].
        camera: Whose images they are.
        mesh: The part.
        found: The pose.
        settings: When a view counts as a part.

    Raises:
        NoCloudError: Too few points.
        InputError: Values that can't be used.
    """
    if found.undetermined:
        # Such a pose may have run away along what is open: how it fits says nothing.
        return ShapeVerdict(AMBIGUOUS, float("nan"), True, found.doubt)
    fit = fit_view(points, camera, {"part": Candidate(mesh, found.T_camera_workpiece)}, settings)[
        "part"
    ]
    if not fit.is_judged or fit.reason:
        return ShapeVerdict(FAILED, fit.seen_ratio, fit.is_judged, fit.reason)
    if found.doubt:
        return ShapeVerdict(AMBIGUOUS, fit.seen_ratio, True, found.doubt)
    return ShapeVerdict(GOOD, fit.seen_ratio, True, f"residual {found.residual_m * 1e3:.2f} mm")


def predicted_error_m(located: LocatedPart, mesh: SurfaceMesh, sigmas: float) -> float:
    """Returns the error of the part's farthest point: that of its box that is known worst [m].

    Args:
        located: Pose and covariance.
        mesh: The part.
        sigmas: So many standard deviations [1].
    """
    low, high = mesh.bounds
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    levers = rotate(located.T_arm_base_workpiece, low + corners * (high - low))
    return sigmas * max(_sigma_m(located.covariance, lever) for lever in levers)


def accepted_error_m(mesh: SurfaceMesh, settings: GateSettings) -> float:
    """Returns the largest error that the farthest point of a part may have [m]."""
    reach = 0.5 * float(np.linalg.norm(np.diff(mesh.bounds, axis=0)))
    return settings.position_max_m + settings.angle_max_rad * reach


def shape_quality(located: LocatedPart, mesh: SurfaceMesh, settings: GateSettings) -> float:
    """Returns the accepted error over the predicted one, at most 1: 1 passes the gate [1]."""
    predicted = predicted_error_m(located, mesh, settings.sigmas)
    return min(1.0, accepted_error_m(mesh, settings) / max(predicted, 1e-9))


def _sigma_m(covariance: Array, lever: Array) -> float:
    """Standard deviation of a point's place in the direction that is known worst [m]."""
    x, y, z = lever
    turned = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
    rows = np.hstack([np.eye(3), turned])
    return float(np.sqrt(max(np.linalg.eigvalsh(rows @ covariance @ rows.T)[-1], 0.0)))
