"""Where a part lies, from its cloud alone: no marker, no descriptor, no start (strategy `global`).

Every way to lie on the tray is tried at once with few points; the best are moved by robust steps
whose scale shrinks, and the winner is laid on the exact surface by the inspection's registration,
which also gives the covariance and names what nothing determines.
"""

from dataclasses import dataclass

import numpy as np

from skinplan.errors import AlignmentError
from skinplan.inspection.model import Alignment
from skinplan.inspection.points import enough_points, evenly
from skinplan.inspection.registration import RegistrationSettings, register
from skinplan.recognition.fit_model import FitModel
from skinplan.recognition.part_cloud import PartCloud
from skinplan.recognition.planes import Plane
from skinplan.recognition.search import costs, lying_poses, pairs, stepped
from skinplan.transforms import Array, difference, inverse

# Scales of the steps, largest first [m].
_FIRST = (0.012, 0.012, 0.008, 0.008, 0.005, 0.005)
_NEXT = (0.004, 0.003, 0.002, 0.002, 0.0015, 0.0015, 0.001, 0.001)


@dataclass(frozen=True)
class GlobalSettings:
    """How a pose is searched.

    Attributes:
        headings: Tried in each rest.
        few: Points of the cloud in the first round ...
        more: ... and when the best are settled.
        kept: Poses that are settled.
        finalists: Different poses of which the best is chosen.
        cut_m: A point counts no more than this [m].
        apart_m: Poses whose middles differ by less ...
        apart_rad: ... and whose turns differ by less are the same.
        final_points: For the last registration.
    """

    headings: int = 36
    few: int = 150
    more: int = 500
    kept: int = 12
    finalists: int = 3
    cut_m: float = 0.01
    apart_m: float = 0.003
    apart_rad: float = 0.05
    final_points: int = 4000


@dataclass(frozen=True, eq=False)
class Fit:
    """A pose found.

    Attributes:
        T_tray_part: shape (4, 4) [m].
        cost_m: Root mean square distance with the cut [m].
        other_cost_m: The same of the best pose that differs; infinite without any [m].
        alignment: Of the last registration: covariance, what is open; None = not made.
    """

    T_tray_part: Array
    cost_m: float
    other_cost_m: float
    alignment: Alignment | None = None


def global_fit(
    cloud: PartCloud, model: FitModel, plane: Plane, settings: GlobalSettings | None = None
) -> Fit:
    """Finds where the model lies.

    Args:
        cloud: Of one part.
        model: The part that it is thought to be.
        plane: The tray.
        settings: How.

    Returns:
        The best pose. Whether it is good is said by `verdict`.

    Raises:
        NoCloudError: Too few points.
        AlignmentError: The cloud can't be laid on the model.
        InputError: Points that are not finite.
    """
    settings = settings or GlobalSettings()
    enough_points(cloud.points)
    poses, found = _settled(cloud, model, plane, settings)
    chosen = _different(poses, found, model, settings)
    best = poses[chosen[0]]
    other = float(found[chosen[1]]) if len(chosen) > 1 else float("inf")
    return _registered(cloud, model, best, other, settings)


def _settled(
    cloud: PartCloud, model: FitModel, plane: Plane, settings: GlobalSettings
) -> tuple[Array, Array]:
    """Best poses ``T_tray_part`` (k, 4, 4) and costs (k,) [m], the best first."""
    T_part_tray = inverse(lying_poses(model, cloud.points, plane, settings.headings))
    few = evenly(len(cloud.points), settings.few)
    first = pairs(model, cloud.points[few], cloud.normals[few], T_part_tray)
    best = np.argsort(costs(first, settings.cut_m), kind="stable")[: settings.kept]
    T_part_tray = _walked(cloud, few, model, T_part_tray[best], _FIRST)
    more = evenly(len(cloud.points), settings.more)
    found = costs(pairs(model, cloud.points[more], cloud.normals[more], T_part_tray), settings.cut_m)
    order = np.argsort(found, kind="stable")
    poses = inverse(T_part_tray[order])
    kept = _different(poses, found[order], model, settings)
    T_part_tray = _walked(cloud, more, model, inverse(poses[kept]), _NEXT)
    found = costs(pairs(model, cloud.points[more], cloud.normals[more], T_part_tray), settings.cut_m)
    order = np.argsort(found, kind="stable")
    return inverse(T_part_tray[order]), found[order]


def _walked(
    cloud: PartCloud, chosen: Array, model: FitModel, T_part_tray: Array, scales: tuple[float, ...]
) -> Array:
    points, normals = cloud.points[chosen], cloud.normals[chosen]
    for scale in scales:
        T_part_tray = stepped(pairs(model, points, normals, T_part_tray), T_part_tray, scale)
    return T_part_tray


def _different(
    poses: Array, found: Array, model: FitModel, settings: GlobalSettings
) -> list[int]:
    """Numbers of poses that differ from each other, the best first."""
    middles = poses[:, :3, :3] @ model.middle + poses[:, :3, 3]
    kept: list[int] = []
    for k in np.argsort(found, kind="stable").tolist():
        same = [
            np.linalg.norm(middles[k] - middles[other]) < settings.apart_m
            and difference(poses[k], poses[other])[1] < settings.apart_rad
            for other in kept
        ]
        if not any(same):
            kept.append(k)
        if len(kept) == settings.finalists:
            break
    return kept


def _registered(
    cloud: PartCloud, model: FitModel, start: Array, other: float, settings: GlobalSettings
) -> Fit:
    exact = RegistrationSettings(
        points=settings.final_points // 2,
        final_points=settings.final_points,
        gate_m=0.002,
        noise_min_m=5e-6,
    )
    try:
        alignment = register(cloud.points, model.index, start, exact)
    except AlignmentError:
        alignment = None
    pose = start if alignment is None else alignment.T_tracker_workpiece
    more = evenly(len(cloud.points), settings.more)
    found = pairs(model, cloud.points[more], cloud.normals[more], inverse(pose)[None])
    return Fit(pose, float(costs(found, settings.cut_m)[0]), other, alignment)
