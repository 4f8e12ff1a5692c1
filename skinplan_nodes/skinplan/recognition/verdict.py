"""How well a cloud lies on a model, and what that is worth: good, ambiguous or failed."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from skinplan.inspection.model import Alignment
from skinplan.inspection.points import evenly
from skinplan.recognition.fit_model import FitModel
from skinplan.recognition.part_cloud import PartCloud
from skinplan.transforms import Array, apply, inverse, rotate

GOOD, AMBIGUOUS, FAILED = "good", "ambiguous", "failed"
_POINTS = 4000
# Steeper surface is not asked for: from above it is hardly seen (cosine).
_SEEN = 0.3
# Rays start so far outside the surface [m].
_OFF_M = 1e-4


@dataclass(frozen=True)
class VerdictSettings:
    """What makes a registration good.

    Attributes:
        rmse_max_m: Root mean square distance of all points to the surface, eq (3) [m].
        gate_m: Points this near lie on the part [m].
        on_part_min: At least this share of the points does [1].
        complete_min: At least this share of what is seen from above has points near it [1].
        near_m: How near [m].
        ambiguous_ratio: A different pose whose cost is at most this many times the best one's is as
            good [1].
        cost_floor_m: Costs below this can't be told apart [m].
        position_sigma_max_m: Standard deviation of the position [m].
        angle_sigma_max_rad: Of the orientation [rad].
    """

    rmse_max_m: float = 0.001
    gate_m: float = 0.001
    on_part_min: float = 0.9
    complete_min: float = 0.9
    near_m: float = 0.005
    ambiguous_ratio: float = 1.3
    cost_floor_m: float = 5e-5
    position_sigma_max_m: float = 0.0003
    angle_sigma_max_rad: float = 0.002


@dataclass(frozen=True)
class Verdict:
    """What a registration is worth.

    Attributes:
        grade: `GOOD`, `AMBIGUOUS` or `FAILED`.
        rmse_m: Eq (3) [m].
        on_part_ratio: Share of the points on the part [1].
        complete_ratio: Share of what is seen from above with points near it [1].
        reason: In one sentence.
    """

    grade: str
    rmse_m: float
    on_part_ratio: float
    complete_ratio: float
    reason: str


def judge(
    cloud: PartCloud,
    model: FitModel,
    T_tray_part: Array,
    costs_m: tuple[float, float] = (0.0, float("inf")),
    alignment: Alignment | None = None,
    settings: VerdictSettings | None = None,
) -> Verdict:
    """Judges a pose.

    Args:
        cloud: Of the part.
        model: The part.
        T_tray_part: shape (4, 4) [m].
        costs_m: Of this pose and of the best different one [m].
        alignment: Of the last registration, if it was made.
        settings: What makes it good.
    """
    settings = settings or VerdictSettings()
    T_part_tray = inverse(T_tray_part)
    chosen = evenly(len(cloud.points), _POINTS)
    distance = model.index.closest(apply(T_part_tray, cloud.points[chosen])).distance
    rmse = float(np.sqrt(np.mean(distance**2)))
    on_part = float(np.mean(distance < settings.gate_m))
    complete = complete_ratio(cloud, model, T_tray_part, settings.near_m)
    grade, reason = GOOD, f"residual {rmse * 1e3:.3f} mm"
    if why := _failure(rmse, on_part, complete, settings):
        grade, reason = FAILED, why
    elif why := _doubt(costs_m, alignment, settings):
        grade, reason = AMBIGUOUS, why
    return Verdict(grade, rmse, on_part, complete, reason)


def complete_ratio(cloud: PartCloud, model: FitModel, T_tray_part: Array, near_m: float) -> float:
    """Share of the model's surface seen from above that has points of the cloud near it [1]."""
    T_part_tray = inverse(T_tray_part)
    points, normals = model.samples.points, model.samples.normals
    toward = apply(T_part_tray, cloud.above[None])[0] - points
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    seen = np.flatnonzero(np.einsum("ij,ij->i", normals, toward) > _SEEN)
    seen = seen[evenly(len(seen), _POINTS)]
    hidden = model.rays.occluded(points[seen] + _OFF_M * normals[seen], toward[seen], 10.0)
    seen = seen[~hidden]
    if len(seen) == 0:
        return 0.0
    facing = rotate(T_part_tray, cloud.normals)
    # Points of the other side of a sheet do not cover this one.
    near, which = cKDTree(apply(T_part_tray, cloud.points)).query(
        points[seen], distance_upper_bound=near_m
    )
    found = np.isfinite(near)
    same = np.zeros(len(seen), dtype=bool)
    same[found] = np.einsum("ij,ij->i", facing[which[found]], normals[seen[found]]) > 0.0
    return float(np.mean(same))


def _failure(rmse: float, on_part: float, complete: float, settings: VerdictSettings) -> str:
    if on_part < settings.on_part_min:
        return (
            f"{100 * on_part:.0f} % of the points lie on the part, at least "
            f"{100 * settings.on_part_min:.0f} % are accepted"
        )
    if complete < settings.complete_min:
        return (
            f"{100 * complete:.0f} % of the part's upper side were seen, at least "
            f"{100 * settings.complete_min:.0f} % are accepted"
        )
    if rmse > settings.rmse_max_m:
        return (
            f"residual {rmse * 1e3:.2f} mm, at most {settings.rmse_max_m * 1e3:.2f} mm is accepted"
        )
    return ""


def _doubt(
    costs_m: tuple[float, float], alignment: Alignment | None, settings: VerdictSettings
) -> str:
    cost, other = costs_m
    if other <= max(settings.ambiguous_ratio * cost, settings.cost_floor_m):
        return (
            f"another pose fits about as well: {other * 1e3:.3f} mm beside {cost * 1e3:.3f} mm; it "
            f"has to be {settings.ambiguous_ratio:g} times worse"
        )
    if alignment is None:
        return ""
    if alignment.undetermined:
        open_motions = ", ".join(motion.text for motion in alignment.undetermined)
        return f"the cloud leaves open: {open_motions}"
    if (
        alignment.position_sigma_m > settings.position_sigma_max_m
        or alignment.angle_sigma_rad > settings.angle_sigma_max_rad
    ):
        return (
            f"the pose is known to {alignment.position_sigma_m * 1e3:.2f} mm and "
            f"{alignment.angle_sigma_rad * 1e3:.2f} mrad, at most "
            f"{settings.position_sigma_max_m * 1e3:.2f} mm and "
            f"{settings.angle_sigma_max_rad * 1e3:.2f} mrad are accepted"
        )
    return ""
