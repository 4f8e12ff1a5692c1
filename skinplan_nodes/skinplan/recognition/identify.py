"""Which of several parts a cloud is (R2.3, R2.4 in a first form).

Size, then robust registration, then completeness.

A cloud counts as a part when its size fits, its points lie on the part, and the part lies below
its points. Two parts that fit about equally well are said to be alike; none is guessed.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skinplan.errors import AlignmentError, InputError, NoCloudError
from skinplan.inspection.closest import SurfaceIndex
from skinplan.inspection.measure import deviations
from skinplan.inspection.points import checked_points, evenly
from skinplan.mesh.model import SurfaceMesh
from skinplan.recognition.align import AlignSettings, align
from skinplan.recognition.box import Box, box_poses
from skinplan.scanner.samples import sample_surface
from skinplan.transforms import Array, apply, difference, inverse

_FEWEST = 200
_COARSE_POINTS, _COARSE_STEPS, _FINE_STEPS = 800, 15, 40


@dataclass(frozen=True)
class IdentifySettings:
    """When a cloud counts as a part.

    Attributes:
        extent_ratio: Length and width may differ by this share [1] ...
        extent_m: ... plus this [m].
        residual_m: Largest residual: of the points within the gate, the root mean square [m].
        inlier_ratio_min: At least this share of the points lies on the part [1].
        complete_ratio_min: At least this share of the part lies below points [1].
        alike_ratio: A second part whose residual is at most this many times the first one's fits
            as well [1].
        alike_m: Residuals below this can't be told apart [m].
        gate_m: Points farther from the part than this are not on it [m].
        points: Points used for the choice of the pose.
    """

    extent_ratio: float = 0.03
    extent_m: float = 0.015
    residual_m: float = 0.0015
    inlier_ratio_min: float = 0.9
    complete_ratio_min: float = 0.85
    alike_ratio: float = 1.5
    alike_m: float = 0.0001
    gate_m: float = 0.01
    points: int = 3000


@dataclass(frozen=True, eq=False)
class Fit:
    """How a cloud fits one candidate.

    Attributes:
        residual_m: Root mean square distance of the points on the part [m]; NaN = could not be
            registered.
        inlier_ratio: Share of the points on the part [1].
        complete_ratio: Share of the part below points [1].
        T_cloud_workpiece: Best pose, shape (4, 4) [m]; None = could not be registered.
        other_pose: A second, different pose fits about as well: the part looks the same when
            turned.
        reason: Why it is not this part; empty = it fits.
    """

    residual_m: float = float("nan")
    inlier_ratio: float = 0.0
    complete_ratio: float = 0.0
    T_cloud_workpiece: Array | None = None
    other_pose: bool = False
    reason: str = ""


@dataclass(frozen=True, eq=False)
class Identification:
    """Which part a cloud is.

    Attributes:
        name: The candidate; None = none of them, or several that are alike.
        T_cloud_workpiece: Its pose in the cloud's frame, shape (4, 4) [m]; None without a name.
        alike: Candidates that fit about equally well; empty = none or one fits.
        fits: How each candidate fits, by name.
        reason: The answer as a sentence.
    """

    name: str | None
    T_cloud_workpiece: Array | None
    alike: tuple[str, ...]
    fits: dict[str, Fit] = field(default_factory=dict)
    reason: str = ""

    @property
    def residuals_m(self) -> dict[str, float]:
        """Residual of each candidate [m]; NaN = could not be registered."""
        return {name: fit.residual_m for name, fit in self.fits.items()}


def identify(
    points: Array,
    candidates: Mapping[str, SurfaceMesh],
    settings: IdentifySettings | None = None,
    outside: Array | None = None,
) -> Identification:
    """Says which candidate a nearly complete cloud of one part is, and where.

    Args:
        points: Any frame, shape (n, 3) [m].
        candidates: Meshes by name, each in its workpiece frame.
        settings: When a cloud counts as a part.
        outside: A point on the scanned side of the part, e.g. the scanner's mean position, frame
            of the points,
            shape (3,) [m]. Without it a flat part may come out back to front. None = unknown.

    Returns:
        The answer; no candidate is no error.

    Raises:
        NoCloudError: Too few points.
        InputError: No candidates, or values that can't be used.
    """
    settings = settings or IdentifySettings()
    cloud = checked_question(points, candidates)
    seen_from = (
        None
        if outside is None
        else checked_points(np.asarray(outside, dtype=float).reshape(1, -1))[0]
    )
    fits = {name: _fit(cloud, mesh, settings, seen_from) for name, mesh in candidates.items()}
    return _answer(fits, settings)


def checked_question(points: Array, candidates: Collection[str]) -> Array:
    """Returns the points by which a part is to be identified, shape (n, 3) [m].

    Raises:
        NoCloudError: Too few points.
        InputError: No candidates, or values that can't be used.
    """
    if not candidates:
        raise InputError(
            "a part was to be identified; at least one candidate is accepted, found none"
        )
    cloud = checked_points(points)
    if len(cloud) < _FEWEST:
        raise NoCloudError(
            f"a part was to be identified; at least {_FEWEST} points are accepted, found "
            f"{len(cloud)}"
        )
    return cloud


def _answer(fits: dict[str, Fit], settings: IdentifySettings) -> Identification:
    good = sorted(
        (name for name, fit in fits.items() if not fit.reason), key=lambda n: fits[n].residual_m
    )
    if not good:
        tried = "; ".join(f"{name}: {fit.reason}" for name, fit in fits.items())
        return Identification(None, None, (), fits, f"unknown part ({tried})")
    best = fits[good[0]]
    limit = max(settings.alike_m, settings.alike_ratio * best.residual_m)
    alike = tuple(name for name in good if fits[name].residual_m <= limit)
    if len(alike) > 1:
        shown = ", ".join(f"{name} ({fits[name].residual_m * 1e3:.3f} mm)" for name in alike)
        return Identification(
            None, None, alike, fits, f"{' and '.join(alike)} can't be told apart: {shown}"
        )
    turned = (
        "; it looks the same when turned, so the pose may be another one" if best.other_pose else ""
    )
    sentence = f"{good[0]}, residual {best.residual_m * 1e3:.3f} mm{turned}"
    return Identification(good[0], best.T_cloud_workpiece, (), fits, sentence)


def _fit(cloud: Array, mesh: SurfaceMesh, settings: IdentifySettings, outside: Array | None) -> Fit:
    # Coarse samples are enough for registration; the distance to the faces found is exact.
    spacing = max(0.005, float(np.sqrt(mesh.area / 40_000)))
    samples = sample_surface(mesh, spacing)
    if len(samples.points) < _FEWEST:
        return Fit(reason="the candidate is too small")
    box_cloud, box_part = Box.around(cloud), Box.around(samples.points)
    if misfit := _size_misfit(box_cloud, box_part, settings):
        return Fit(reason=misfit)
    index = SurfaceIndex(mesh, samples)
    poses = [
        pose
        for pose in box_poses(box_cloud, box_part)
        if outside is None or _faces(pose, mesh, outside)
    ]
    tried = _registered(
        cloud[evenly(len(cloud), _COARSE_POINTS)], index, poses, _COARSE_STEPS, settings
    )
    if tried:
        # A pose that is far behind after a few steps does not catch up.
        near = [pose for cost, pose in tried if cost <= 3.0 * tried[0][0] + settings.alike_m]
        tried = _registered(
            cloud[evenly(len(cloud), settings.points)], index, near, _FINE_STEPS, settings
        )
    if not tried:
        return Fit(reason="it can't be laid on the part")
    _, T_cloud_workpiece = tried[0]
    return _judged(
        cloud, index, samples.points, T_cloud_workpiece, _has_twin(tried, settings), settings
    )


def _judged(
    cloud: Array,
    index: SurfaceIndex,
    samples: Array,
    pose: Array,
    twin: bool,
    settings: IdentifySettings,
) -> Fit:
    local = apply(inverse(pose), cloud[evenly(len(cloud), 20 * settings.points)])
    distance = deviations(local, index, settings.gate_m)
    on_part = np.isfinite(distance)
    if not on_part.any():
        return Fit(reason="no point lies on it")
    residual = float(np.sqrt(np.mean(distance[on_part] ** 2)))
    # Points this near below a sample cover it; a thin cloud must not make holes.
    reach = max(settings.gate_m, 3.0 * float(np.sqrt(index.mesh.area / len(local))))
    near, _ = cKDTree(local).query(samples, distance_upper_bound=reach)
    inliers, complete = float(on_part.mean()), float(np.isfinite(near).mean())
    reason = ""
    if residual > settings.residual_m:
        reason = (
            f"residual {residual * 1e3:.2f} mm, at most {settings.residual_m * 1e3:.2f} mm "
            "is accepted"
        )
    elif inliers < settings.inlier_ratio_min:
        reason = (
            f"{100 * inliers:.0f} % of the points lie on it, at least "
            f"{100 * settings.inlier_ratio_min:.0f} % are accepted"
        )
    elif complete < settings.complete_ratio_min:
        reason = (
            f"{100 * complete:.0f} % of it were seen, at least "
            f"{100 * settings.complete_ratio_min:.0f} % are accepted"
        )
    return Fit(residual, inliers, complete, pose, twin, reason)


def _size_misfit(cloud: "Box", part: "Box", settings: IdentifySettings) -> str:
    allowed = settings.extent_m + settings.extent_ratio * part.size[:2]
    if np.all(np.abs(cloud.size[:2] - part.size[:2]) <= allowed):
        return ""
    return (
        f"the cloud measures {cloud.size[0]:.3f} x {cloud.size[1]:.3f} m, "
        f"the part {part.size[0]:.3f} x {part.size[1]:.3f} m"
    )


def _faces(T_cloud_workpiece: Array, mesh: SurfaceMesh, outside: Array) -> bool:
    local = apply(inverse(T_cloud_workpiece), outside[None])[0]
    # The part's mean normal, weighted by area (R eq (1)).
    mean_normal = mesh.face_areas @ mesh.face_normals
    return bool(mean_normal @ (local - mesh.face_areas @ mesh.centroids / mesh.area) > 0.0)


def _registered(
    few: Array, index: SurfaceIndex, poses: list[Array], steps: int, settings: IdentifySettings
) -> list[tuple[float, Array]]:
    """Registers from each pose; returns cost [m] and pose of those that succeed, the best first."""
    wide = AlignSettings(
        points=len(few),
        gate_m=0.1,
        gate_min_m=settings.gate_m / 2.0,
        prior_position_m=0.05,
        prior_angle_rad=0.05,
        iterations=steps,
    )
    found = []
    for pose in poses:
        try:
            fitted = align(few, index, pose, wide).T_tracker_workpiece
        except AlignmentError:
            continue
        distance = index.closest(apply(inverse(fitted), few)).distance
        # Truncated, so that a pose with few but good pairs does not win.
        found.append((float(np.sqrt(np.mean(np.minimum(distance, settings.gate_m) ** 2))), fitted))
    return sorted(found, key=lambda entry: entry[0])


def _has_twin(tried: list[tuple[float, Array]], settings: IdentifySettings) -> bool:
    best, pose = tried[0]
    limit = max(settings.alike_m, settings.alike_ratio * best)
    others: list[NDArray[np.float64]] = [other for cost, other in tried[1:] if cost <= limit]
    return any(difference(pose, other)[1] > 0.2 for other in others)
