"""Which of several parts a depth image shows, where the fixture says how the part lies.

Each candidate is put where the fixture holds it. It fits when the points near it lie on it, when
no patch of them lies off it by more than the camera's error explains, and when there are points
wherever the camera should see it. What stands before it hides it, and says nothing.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skinplan.errors import AlignmentError
from skinplan.inspection.closest import SurfaceIndex
from skinplan.inspection.points import evenly
from skinplan.localization.camera import in_view
from skinplan.localization.model import CameraModel
from skinplan.mesh.model import SurfaceMesh
from skinplan.recognition.align import AlignSettings, align
from skinplan.recognition.identify import checked_question
from skinplan.scanner.model import SurfaceSamples
from skinplan.scanner.rays import RayCaster
from skinplan.scanner.samples import sample_surface
from skinplan.transforms import Array, apply, inverse, require_transform

_FEWEST = 200
_SAMPLES = 15_000
_ALIGN_POINTS, _ALIGN_STEPS = 1500, 12
_FEWEST_OF_PATCH = 5
# Rays that differ by less are the same one, in one of so many images at most [rad].
_SAME_RAY, _NEIGHBOURS = 1e-5, 101
# Samples beside the rim of the image, and surfaces more oblique than this, are not counted on.
_RIM_PX = 12.0
_OBLIQUE_COSINE = np.cos(np.deg2rad(70.0))
# A ray that leaves the surface by this much less does not meet it again.
_CLEAR_M = 2e-3


@dataclass(frozen=True)
class ViewSettings:
    """When what a depth camera sees counts as a part.

    Attributes:
        position_sigma_m: Standard deviation of the part's position in the camera frame [m].
        angle_sigma_rad: ... and of its orientation [rad].
        noise_at_1m_m: Standard deviation of a depth of 1 m; grows with its square [m].
        tolerance_m: The camera may be off by this over a whole patch [m].
        patch_m: Side of the patches of surface whose mean deviation is judged [m].
        margin_m: Points within this of the part's box are judged; others are the shop's [m].
        inlier_ratio_min: At least this share of them lies on the part [1].
        complete_ratio_min: At least this share of what should be seen is there [1].
        seen_ratio_min: At least this share of the part's area should be seen [1].
        chi2_behind: Of several that fit, one whose sum of normalised squares is greater than the
            best one's by more than this is none [1].
    """

    position_sigma_m: float = 0.003
    angle_sigma_rad: float = 0.003
    noise_at_1m_m: float = 0.0025
    tolerance_m: float = 0.004
    patch_m: float = 0.04
    margin_m: float = 0.1
    inlier_ratio_min: float = 0.95
    complete_ratio_min: float = 0.97
    seen_ratio_min: float = 0.15
    chi2_behind: float = 100.0


class Candidate(NamedTuple):
    """A part that may be on the fixture.

    Attributes:
        mesh: Its mesh, workpiece frame.
        T_camera_workpiece: Where the fixture holds it, optical frame, shape (4, 4) [m].
    """

    mesh: SurfaceMesh
    T_camera_workpiece: Array


@dataclass(frozen=True, eq=False)
class ViewFit:
    """How a depth image fits one candidate.

    Attributes:
        residual_m: Root mean square distance of the points on it [m]; NaN = none.
        inlier_ratio: Share of the points near it that lie on it [1].
        complete_ratio: Share of what should be seen that is there [1].
        seen_ratio: Share of its area that the answer rests on [1].
        T_camera_workpiece: Where it lies by the points, shape (4, 4) [m]; None = not known.
        is_judged: Enough of it should be seen to say anything.
        reason: Why it is not this part, or can't be said; empty = it fits.
    """

    residual_m: float = float("nan")
    inlier_ratio: float = 0.0
    complete_ratio: float = 0.0
    seen_ratio: float = 0.0
    T_camera_workpiece: Array | None = None
    is_judged: bool = True
    reason: str = ""

    @property
    def fits(self) -> bool:
        """Whether it may be this part."""
        return self.is_judged and not self.reason


def fit_view(
    points: Array,
    camera: CameraModel,
    candidates: Mapping[str, Candidate],
    settings: ViewSettings | None = None,
) -> dict[str, ViewFit]:
    """Says which candidates a depth image may show.

    Args:
        points: Depth image, optical frame, shape (n, 3) [m].
        camera: Whose image it is.
        candidates: Parts by name.
        settings: When a view counts as a part.

    Returns:
        How each fits. Several that fit can't be told apart by this image.

    Raises:
        NoCloudError: Too few points.
        InputError: No candidates, or values that can't be used.
    """
    settings = settings or ViewSettings()
    cloud = checked_question(points, candidates)
    judges = {
        name: _Judge(cloud, camera, candidate, settings) for name, candidate in candidates.items()
    }
    fits = {name: judge.fit() for name, judge in judges.items()}
    good = [name for name, fit in fits.items() if fit.fits]
    if len(good) > 1:
        fits |= _compared(cloud, {name: judges[name] for name in good}, fits, settings)
    return fits


def _compared(
    cloud: Array,
    judges: "Mapping[str, _Judge]",
    fits: Mapping[str, ViewFit],
    settings: ViewSettings,
) -> dict[str, ViewFit]:
    """Refuses those of several that fit which are clearly behind the best one.

    By the sum of normalised squared distances of the points that are near any of them.
    """
    near = np.any([judge.is_near(cloud) for judge in judges.values()], axis=0)
    costs = {name: judge.cost(cloud[near]) for name, judge in judges.items()}
    best = min(costs, key=lambda name: costs[name])
    return {
        name: replace(
            fits[name],
            reason=f"{best} fits better: its sum of normalised squares is less by "
            f"{cost - costs[best]:.0f}",
        )
        for name, cost in costs.items()
        if cost - costs[best] > settings.chi2_behind
    }


class _Judge:
    """Judges one candidate; all in its workpiece frame."""

    def __init__(
        self, cloud: Array, camera: CameraModel, candidate: Candidate, settings: ViewSettings
    ) -> None:
        self._mesh, self._camera, self._settings = candidate.mesh, camera, settings
        self._T_camera_workpiece = require_transform(
            candidate.T_camera_workpiece, "T_camera_workpiece"
        )
        self._cloud = cloud
        spacing = max(0.004, float(np.sqrt(self._mesh.area / _SAMPLES)))
        self._samples: SurfaceSamples = sample_surface(self._mesh, spacing)
        self._index = SurfaceIndex(self._mesh, self._samples)

    def fit(self) -> ViewFit:
        """Returns how the image fits."""
        settings = self._settings
        expected = self._expected()
        seen = float(self._samples.weights[expected].sum() / self._mesh.area)
        if seen < settings.seen_ratio_min:
            return ViewFit(
                seen_ratio=seen,
                is_judged=False,
                reason=f"{100 * seen:.0f} % of it can be seen from here, at least "
                f"{100 * settings.seen_ratio_min:.0f} % are accepted",
            )
        near = self._near()
        if len(near) < _FEWEST:
            return ViewFit(seen_ratio=seen, reason="hardly a point lies where it should be")
        pose = self._aligned(near)
        if pose is None:
            return ViewFit(seen_ratio=seen, reason="less than half of the points lie on it")
        self._T_camera_workpiece = pose
        return self._judged(expected, seen)

    def _expected(self) -> NDArray[np.int64]:
        """Returns the samples that the camera should see, unless something stands before them."""
        eye = inverse(self._T_camera_workpiece)[:3, 3]
        samples = self._samples
        ways = eye - samples.points
        distance = np.linalg.norm(ways, axis=1)
        ways /= distance[:, None]
        facing = np.einsum("ij,ij->i", ways, samples.normals) > _OBLIQUE_COSINE
        inside = in_view(apply(self._T_camera_workpiece, samples.points), self._camera, _RIM_PX)
        chosen = np.flatnonzero(facing & inside)
        starts = samples.points[chosen] + _CLEAR_M * ways[chosen]
        hidden = RayCaster(self._mesh).occluded(starts, ways[chosen], distance[chosen])
        return chosen[~hidden]

    def is_near(self, cloud: Array) -> NDArray[np.bool_]:
        """Tells which points, optical frame, are within the margin of the part's box."""
        local = apply(inverse(self._T_camera_workpiece), cloud)
        low, high = self._mesh.bounds
        margin = self._settings.margin_m
        return np.asarray(np.all((local >= low - margin) & (local <= high + margin), axis=1))

    def cost(self, cloud: Array) -> float:
        """Returns the sum of normalised squared distances of points, optical frame.

        Each counts at most as three standard deviations, those of noise and tolerance together.
        """
        local = apply(inverse(self._T_camera_workpiece), cloud)
        variance = self._sigma(local) ** 2 + self._settings.tolerance_m**2
        squares = self._index.closest(local).distance ** 2 / variance
        return float(np.minimum(squares, 9.0).sum())

    def _near(self) -> Array:
        cloud = self._cloud[self.is_near(self._cloud)]
        return apply(inverse(self._T_camera_workpiece), cloud)

    def _aligned(self, near: Array) -> Array | None:
        settings = self._settings
        how = AlignSettings(
            points=_ALIGN_POINTS,
            gate_m=5.0 * (settings.position_sigma_m + settings.noise_at_1m_m),
            gate_min_m=settings.tolerance_m,
            prior_position_m=settings.position_sigma_m,
            prior_angle_rad=settings.angle_sigma_rad,
            iterations=_ALIGN_STEPS,
            inlier_ratio_min=0.5,
        )
        try:
            found = align(near, self._index, np.eye(4), how)
        except AlignmentError:
            return None
        return np.asarray(self._T_camera_workpiece @ found.T_tracker_workpiece)

    def _judged(self, expected: NDArray[np.int64], seen: float) -> ViewFit:
        near = self._near()
        closest = self._index.closest(near)
        signed = closest.signed(near)
        allowed = self._settings.tolerance_m + 3.0 * self._sigma(near)
        on_it = np.abs(signed) <= allowed
        if not on_it.any():
            return ViewFit(seen_ratio=seen, reason="no point lies on it")
        residual = float(np.sqrt(np.mean(signed[on_it] ** 2)))
        inliers = float(on_it.mean())
        complete = self._complete(expected)
        off_m = self._largest_patch(closest.points, signed, near)
        return ViewFit(
            residual,
            inliers,
            complete,
            seen,
            self._T_camera_workpiece,
            reason=self._misfit(inliers, complete, off_m),
        )

    def _misfit(self, inliers: float, complete: float, off_m: float) -> str:
        settings = self._settings
        if inliers < settings.inlier_ratio_min:
            return (
                f"{100 * inliers:.0f} % of the points near it lie on it, at least "
                f"{100 * settings.inlier_ratio_min:.0f} % are accepted"
            )
        if complete < settings.complete_ratio_min:
            return (
                f"{100 * complete:.0f} % of what should be seen of it are there, at least "
                f"{100 * settings.complete_ratio_min:.0f} % are accepted"
            )
        if off_m > 0.0:
            return (
                f"a patch of its surface lies {off_m * 1e3:.1f} mm off, more than the camera's "
                f"error explains"
            )
        return ""

    def _sigma(self, local: Array) -> Array:
        """Returns the standard deviation of the points' depths, shape (n,) [m]."""
        depth = apply(self._T_camera_workpiece, local)[:, 2]
        return np.asarray(self._settings.noise_at_1m_m * depth**2)

    def _complete(self, expected: NDArray[np.int64]) -> float:
        """Returns the share of the expected samples before which, or at which, there is a point."""
        at = apply(self._T_camera_workpiece, self._samples.points[expected])
        reach = np.linalg.norm(at, axis=1)
        lengths = np.linalg.norm(self._cloud, axis=1)
        directions = self._cloud / lengths[:, None]
        rays = cKDTree(directions)
        # Several images have the same rays: the nearest other one counts.
        beside = rays.query(directions[evenly(len(directions), 500)], _NEIGHBOURS)[0]
        pitch = float(np.median(np.min(np.where(beside > _SAME_RAY, beside, np.inf), axis=1)))
        if not np.isfinite(pitch):
            return 0.0
        apart, which = rays.query(at / reach[:, None], distance_upper_bound=3.0 * pitch)
        found = np.isfinite(apart)
        depth = np.where(found, lengths[np.minimum(which, len(lengths) - 1)], np.inf)
        # Across three pixels an oblique surface is farther away by that much.
        slope = 3.0 * pitch * reach * np.tan(np.arccos(_OBLIQUE_COSINE))
        allowed = self._settings.tolerance_m + 3.0 * self._settings.noise_at_1m_m * reach**2 + slope
        before = depth < reach - allowed
        there = np.abs(depth - reach) <= allowed
        weights = self._samples.weights[expected]
        counted = float(weights[~before].sum())
        return float(weights[there].sum()) / counted if counted > 0.0 else 0.0

    def _largest_patch(self, places: Array, signed: Array, near: Array) -> float:
        """Returns the deviation [m] of the worst patch beyond chance; 0 = all are well.

        A patch's deviation is the median of its points'.

        Args:
            places: Closest points on the surface, shape (n, 3) [m].
            signed: Deviations, shape (n,) [m].
            near: The points, shape (n, 3) [m].
        """
        cells = np.floor(places / self._settings.patch_m).astype(np.int64)
        _, patch, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
        patch = patch.ravel()
        order = np.lexsort((signed, patch))
        middle = signed[order[np.cumsum(count) - count + count // 2]]
        # The median of normally distributed values varies 1.25 times as much as their mean.
        sigma = 1.25 * np.sqrt(np.bincount(patch, self._sigma(near) ** 2)) / count
        off = np.abs(middle) > self._settings.tolerance_m + 4.0 * sigma
        # A patch with a few points of a rim is no proof.
        off &= count >= _FEWEST_OF_PATCH
        return float(np.abs(middle[off]).max()) if np.count_nonzero(off) >= 2 else 0.0


def describe(fits: Mapping[str, ViewFit]) -> str:
    """Returns an answer as a sentence: what it is, what it may be, or why it is none of them."""
    good = [name for name, fit in fits.items() if fit.fits]
    if len(good) == 1:
        return f"{good[0]}, residual {fits[good[0]].residual_m * 1e3:.2f} mm"
    if good:
        return f"{' and '.join(good)} can't be told apart"
    return "unknown part (" + "; ".join(f"{name}: {fit.reason}" for name, fit in fits.items()) + ")"
