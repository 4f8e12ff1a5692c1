"""Where a part lies, from its cloud alone: no marker, no descriptor, no start (strategy `global`).

Every way to lie on the tray is tried at once with few points; the best are moved by robust steps
whose scale shrinks, and the winner is laid on the exact surface by the inspection's registration,
which also gives the covariance and names what nothing determines.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import AlignmentError
from skinplan.inspection.model import Alignment
from skinplan.inspection.points import enough_points, evenly
from skinplan.inspection.registration import RegistrationSettings, register
from skinplan.recognition.fit_model import FitModel
from skinplan.recognition.part_cloud import PartCloud
from skinplan.recognition.planes import Plane
from skinplan.recognition.search import costs, lying_poses, pairs, plane_frame, stepped
from skinplan.transforms import Array, difference, inverse

# Scales of the steps, largest first [m].
_FIRST = (0.012, 0.012, 0.008, 0.008, 0.005, 0.005)
_NEXT = (0.004, 0.003, 0.002, 0.002, 0.0015, 0.0015, 0.001, 0.001)
# A sheet hardly feels how far it has slid along itself: the winner is tried at places on a grid in
# the tray's plane, so far apart [m], each time followed by steps of these scales.
_SLIDES = (
    (0.004, (0.003, 0.003, 0.002)),
    (0.0013, (0.002, 0.001, 0.001)),
    (0.0004, (0.001, 0.0005, 0.0005, 0.0003, 0.0003)),
    (0.0001, (0.0003, 0.0002, 0.0001, 0.0001)),
)
# Beyond so many of these distances it makes no difference how far off a point is: points in mid-air
# beside an edge must not draw it to themselves.
_CUT = 3.0
_GRID = np.stack(np.meshgrid(np.arange(-2, 3), np.arange(-2, 3)), axis=-1).reshape(-1, 2)
# A place on the rim of a grid may be on the way to a better one: the grid is laid about it again,
# so many times in all.
_ON_RIM = np.abs(_GRID).max(axis=1) == 2
_SLIDES_MOST = 5


@dataclass(frozen=True)
class GlobalSettings:
    """How a pose is searched.

    Attributes:
        headings: Tried in each rest.
        few: Points of the cloud in the first round ...
        more: ... when the best are settled ...
        most: ... and when the winner is chosen.
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
    most: int = 2000
    kept: int = 12
    finalists: int = 3
    cut_m: float = 0.01
    apart_m: float = 0.003
    apart_rad: float = 0.05
    final_points: int = 6000


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
    cloud: PartCloud,
    model: FitModel,
    plane: Plane,
    settings: GlobalSettings | None = None,
    middles: Array | None = None,
) -> Fit:
    """Finds where the model lies.

    Args:
        cloud: Of one part.
        model: The part that it is thought to be.
        plane: The tray.
        settings: How.
        middles: Where the middle of the outline may be, tray frame, shape (k, 3) [m]; None = that
            of the cloud's.

    Returns:
        The best pose. Whether it is good is said by `verdict`.

    Raises:
        NoCloudError: Too few points.
        InputError: Points that are not finite.
    """
    settings = settings or GlobalSettings()
    start = global_start(cloud, model, plane, settings, middles)
    return exact_fit(cloud, model, start, settings)


def global_start(
    cloud: PartCloud,
    model: FitModel,
    plane: Plane,
    settings: GlobalSettings | None = None,
    middles: Array | None = None,
) -> Fit:
    """Finds where the model lies to about a tenth of a millimetre: `global_fit` without its end.

    Whoever tries several models needs the end for the best ones only.

    Raises:
        NoCloudError: Too few points.
        InputError: Points that are not finite.
    """
    settings = settings or GlobalSettings()
    enough_points(cloud.points)
    poses, found = _settled(cloud, model, plane, settings, middles)
    other = float(found[1]) if len(found) > 1 else float("inf")
    most = evenly(len(cloud.points), settings.most)
    start = _slid(cloud, most, model, poses[0], plane, settings)
    return Fit(start, _cost(cloud, model, start, settings), other)


def exact_fit(
    cloud: PartCloud, model: FitModel, start: Fit, settings: GlobalSettings | None = None
) -> Fit:
    """Lays the model on the cloud by the inspection's registration.

    Args:
        cloud: Of one part.
        model: The part.
        start: Of `global_start`; it is returned where the cloud can't be laid on the model. The
            verdict names what is wrong with such a pose.
        settings: How.
    """
    settings = settings or GlobalSettings()
    exact = RegistrationSettings(
        points=settings.final_points // 2,
        final_points=settings.final_points,
        gate_m=0.0005,
    )
    try:
        alignment = register(cloud.points, model.index, start.T_tray_part, exact)
    except AlignmentError:
        return start
    pose = alignment.T_tracker_workpiece
    return Fit(pose, _cost(cloud, model, pose, settings), start.other_cost_m, alignment)


def _settled(
    cloud: PartCloud,
    model: FitModel,
    plane: Plane,
    settings: GlobalSettings,
    middles: Array | None = None,
) -> tuple[Array, Array]:
    """Different poses ``T_tray_part`` (k, 4, 4) and their costs (k,) [m], the best first."""
    T_part_tray = inverse(lying_poses(model, cloud.points, plane, settings.headings, middles))
    few, more, most = (
        evenly(len(cloud.points), count) for count in (settings.few, settings.more, settings.most)
    )
    found = _costs(cloud, few, model, T_part_tray, settings)
    best = np.argsort(found, kind="stable")[: settings.kept]
    T_part_tray = _walked(cloud, few, model, T_part_tray[best], _FIRST)
    found = _costs(cloud, more, model, T_part_tray, settings)
    T_part_tray = T_part_tray[_different(inverse(T_part_tray), found, model, settings)]
    T_part_tray = _walked(cloud, more, model, T_part_tray, _NEXT)
    found = _costs(cloud, most, model, T_part_tray, settings)
    chosen = _different(inverse(T_part_tray), found, model, settings)
    return inverse(T_part_tray[chosen]), found[chosen]


def _costs(
    cloud: PartCloud,
    chosen: NDArray[np.int64],
    model: FitModel,
    T_part_tray: Array,
    settings: GlobalSettings,
) -> Array:
    points, normals = cloud.points[chosen], cloud.normals[chosen]
    return costs(pairs(model, points, normals, T_part_tray, settings.cut_m), settings.cut_m)


def _walked(
    cloud: PartCloud,
    chosen: NDArray[np.int64],
    model: FitModel,
    T_part_tray: Array,
    scales: tuple[float, ...],
    any_side: bool = False,
) -> Array:
    points, normals = cloud.points[chosen], cloud.normals[chosen]
    for scale in scales:
        found = pairs(model, points, normals, T_part_tray, scale)
        T_part_tray = stepped(found, T_part_tray, scale, any_side)
    return T_part_tray


def _slid(
    cloud: PartCloud,
    chosen: NDArray[np.int64],
    model: FitModel,
    T_tray_part: Array,
    plane: Plane,
    settings: GlobalSettings,
) -> Array:
    """Slides a pose ``T_tray_part`` over the tray to where it fits best, shape (4, 4)."""
    axes = plane_frame(plane)[:3, :2]
    few = chosen[evenly(len(chosen), settings.more)]
    for width, scales in _SLIDES:
        sharp = replace(settings, cut_m=min(settings.cut_m, _CUT * width))
        for _ in range(_SLIDES_MOST):
            tried = np.repeat(T_tray_part[None], len(_GRID), axis=0)
            tried[:, :3, 3] += width * _GRID @ axes.T
            best = int(np.argmin(_costs(cloud, few, model, inverse(tried), sharp)))
            T_part_tray = inverse(tried[best])[None]
            T_part_tray = _walked(cloud, chosen, model, T_part_tray, scales, any_side=True)
            T_tray_part = inverse(T_part_tray[0])
            if not _ON_RIM[best]:
                break
    return T_tray_part


def _different(poses: Array, found: Array, model: FitModel, settings: GlobalSettings) -> list[int]:
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


def _cost(cloud: PartCloud, model: FitModel, T_tray_part: Array, settings: GlobalSettings) -> float:
    most = evenly(len(cloud.points), settings.most)
    return float(_costs(cloud, most, model, inverse(T_tray_part)[None], settings)[0])
