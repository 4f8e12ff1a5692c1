"""Lays the cloud of a measured part on its mesh: robust, and honest about what it can't know.

Point-to-plane steps with Tukey's weights whose scale shrinks from centimetres to the noise, so that
a far start is found and a dent does not pull in the end. What the surface leaves open (a plane
slides along itself) the border of the part decides; what both leave open stays as it was given.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from skinplan.errors import AlignmentError
from skinplan.inspection.border import Border, cloud_ends
from skinplan.inspection.closest import SurfaceIndex
from skinplan.inspection.determined import (
    BORDER_M,
    FORM_M,
    Rows,
    Solution,
    covariance,
    jacobian,
    motions,
    patches,
    solve,
    weak_directions,
)
from skinplan.inspection.model import Alignment
from skinplan.inspection.points import FEWEST, SIGMA_OF_MAD, TUKEY, enough_points, evenly
from skinplan.inspection.stable import Choice, Sample
from skinplan.transforms import Array, apply, inverse, require_transform, transform


@dataclass(frozen=True)
class RegistrationSettings:
    """How a cloud is laid on its part.

    Attributes:
        points: About so many points of the cloud are used, spread evenly over it ...
        final_points: ... and so many in the end, against the noise; each time with those that a
            motion hangs on which these know little of.
        gate_m: Pairs farther apart are left out in the beginning [m].
        gate_min_m: In the end, points within this distance lie on the surface [m].
        noise_min_m: Noise that is assumed at least [m].
        inlier_ratio_min: Less of the points on the surface is no alignment [1].
        known_m: A motion counts as known when it is held to this or better (sigma) [m].
        iterations: At most so many at each scale.
    """

    points: int = 20_000
    final_points: int = 100_000
    gate_m: float = 0.06
    gate_min_m: float = 0.002
    noise_min_m: float = 2e-5
    inlier_ratio_min: float = 0.3
    known_m: float = 0.001
    iterations: int = 12


_FEWEST_ENDS = 5
# Each scale is so much smaller than the one before; the last ones in smaller steps, where it is
# decided what is dent and what is surface [m].
_SCALES = ((0.06, 0.02, 0.007, 0.002), (0.001, 5e-4, 2.5e-4, 1.2e-4))
# Far from the surface fewer points do.
_FEW = 4000
# Converged: the last step is smaller than this share of the scale, or than this [m].
_SHARE, _STEP_M = 0.01, 1e-6
# Which point is the outermost changes with every step: smaller ones than this share of how far they
# lie inside mean nothing.
_SHARE_OF_INSET = 0.05
# Near the border this much of the cloud is looked at in full [m].
_STRIP_M = 0.006
# A gap inside the border may be mere lack of points: it pulls less than points outside [1].
_GAP_WEIGHT = 0.1
# The surface decides alone about motions that it knows this well [m]; in the beginning, this.
_SURFACE_M, _SURFACE_FIRST_M = 1e-4, 5e-6


def register(
    points: Array,
    index: SurfaceIndex,
    T_tracker_workpiece: Array,
    settings: RegistrationSettings | None = None,
) -> Alignment:
    """Finds where the part stands from points measured on it.

    Args:
        points: Merged cloud, tracker frame, shape (n, 3) [m].
        index: The part's surface.
        T_tracker_workpiece: Coarse pose, shape (4, 4) [m], good to about 40 mm and a degree.
        settings: How.

    Returns:
        The pose, its residual, its covariance, and the motions that nothing determines.

    Raises:
        NoCloudError: Too few points.
        AlignmentError: Too few of them lie on the surface.
        InputError: A pose that is none, or points that are not finite.
    """
    settings = settings or RegistrationSettings()
    cloud = enough_points(points)
    initial = require_transform(T_tracker_workpiece, "coarse pose")
    return _Registration(cloud, index, initial, settings).run()


class _Registration:
    """One cloud on its way to one part, in the workpiece frame of the coarse pose."""

    def __init__(
        self, cloud: Array, index: SurfaceIndex, initial: Array, settings: RegistrationSettings
    ) -> None:
        self._cloud, self._index, self._initial = cloud, index, initial
        self._settings = settings
        self._to_part = inverse(initial)
        spacing = float(np.sqrt(index.mesh.area / settings.points))
        self._chosen = Choice(cloud, index, self._to_part, 10 * settings.points, spacing)
        self._points = self._chosen.even
        self._border = Border(index.mesh)
        no_ends = np.zeros((0, 3))
        self._ends = no_ends if self._border.empty else self._points[cloud_ends(self._points)]
        self._strip: Array | None = None
        self._stretch_m = 0.0
        self._centre = np.median(self._points, axis=0)
        self._size = float(
            np.sqrt(np.mean(np.sum((self._points - self._points.mean(axis=0)) ** 2, axis=1)))
        )
        # How far outermost points stay inside the border, and how far that may be off.
        self._inset = self._inset_first = spacing / 3.0
        self._T = np.eye(4)
        self._frozen = np.zeros((6, 0))
        self._iterations = 0
        self._sigma = settings.noise_min_m
        self._by_border = False

    def run(self) -> Alignment:
        """Goes through the scales; a motion that turns out not to be known is taken back."""
        coarse, fine = _SCALES
        for scale in coarse:
            if scale <= self._settings.gate_m:
                few = Sample.all_alike(_few(self._points))
                self._settle(scale, few, _few(self._ends), first=True)
        for attempt in range(2):
            points = self._chosen.fine(self._T)
            for scale in fine if attempt == 0 else ():
                self._settle(scale, points, self._fine_ends())
            final = self._chosen.final(self._T, self._settings.final_points)
            converged, solution, rows = self._settle(0.0, final, self._fine_ends())
            covered = covariance(rows, solution)
            lost = _unknown(covered, solution, self._settings.known_m)
            if lost.shape[1] == 0 or attempt == 1:
                break
            # The pieces of the surface contradict each other more than was assumed.
            self._take_back(lost)
        return self._result(converged, solution, rows, covered)

    def _settle(
        self, scale: float, points: Sample, ends: Array, first: bool = False
    ) -> tuple[bool, Solution, list[tuple[Rows, float]]]:
        """Steps at one scale until nothing moves; scale 0 = that of the noise [m]."""
        for _ in range(self._settings.iterations):
            rows = self._rows(scale, points, ends, first)
            solution = self._solved(rows)
            self._move(solution)
            self._iterations += 1
            least = max(
                _STEP_M, _SHARE * scale, _SHARE_OF_INSET * self._inset_first * (len(rows) > 1)
            )
            if float(np.linalg.norm(solution.step)) < least:
                return True, solution, rows
        return False, solution, rows

    def _rows(
        self, scale: float, points: Sample, ends: Array, first: bool
    ) -> list[tuple[Rows, float]]:
        surface = self._surface_rows(scale, points)
        rows = [(surface, FORM_M)]
        if len(ends) == 0 or self._border.empty:
            return rows
        bound = _SURFACE_FIRST_M if first else _SURFACE_M
        open_motions = weak_directions(surface.information(FORM_M)[:6, :6], bound)
        self._by_border = bool(np.any(open_motions))
        if self._by_border:
            border = self._border_rows(scale, ends, open_motions, first)
            if border is not None:
                rows.append((border, BORDER_M))
        return rows

    def _surface_rows(self, scale: float, points: Sample) -> Rows:
        settings = self._settings
        moved = apply(self._T, points.points)
        found = self._index.closest(moved)
        gate = max(settings.gate_min_m, scale)
        kept = (found.distance < gate) & ~found.on_border
        self._used = float(np.mean(kept))
        if np.count_nonzero(kept) < max(FEWEST, settings.inlier_ratio_min * len(kept)):
            raise AlignmentError(
                f"the cloud was to be laid on the part; {100 * self._used:.0f} % of its points "
                f"lie within {gate * 1e3:.1f} mm of the surface, at least "
                f"{100 * settings.inlier_ratio_min:.0f} % are accepted"
            )
        normals = found.normals[kept]
        residual = np.einsum("ij,ij->i", moved[kept] - found.points[kept], normals)
        self._sigma = max(settings.noise_min_m, SIGMA_OF_MAD * float(np.median(np.abs(residual))))
        weight = _tukey(residual, max(scale, TUKEY * self._sigma) if scale else None, self._sigma)
        return Rows(
            jacobian(moved[kept], normals, self._pivot, self._size),
            residual,
            points.stands_for[kept] * weight,
            patches(found.points[kept]),
        )

    def _border_rows(
        self, scale: float, ends: Array, open_motions: Array, first: bool
    ) -> Rows | None:
        moved = apply(self._T, ends)
        reach = max(scale, _STRIP_M)
        found = (
            self._border.rows(moved, reach)
            if first
            else self._border.outermost(moved, reach, self._stretch_m)
        )
        if len(found.points) < _FEWEST_ENDS:
            return None
        residual = found.beyond + self._inset
        spread = max(SIGMA_OF_MAD * float(np.median(np.abs(residual))), self._inset_first / 3.0)
        weight = _tukey(residual, max(scale, TUKEY * spread), spread)
        if first:
            weight = np.where(residual < 0.0, _GAP_WEIGHT, 1.0) * weight
        rows = jacobian(found.points, found.outward, self._pivot, self._size, inset=1.0)
        rows[:, :6] = rows[:, :6] @ open_motions
        return Rows(rows, residual, weight, patches(found.points))

    def _solved(self, rows: list[tuple[Rows, float]]) -> Solution:
        information = np.zeros((7, 7)) + sum(each.information(sigma) for each, sigma in rows)
        gradient = np.zeros(7) + sum(each.gradients(sigma).sum(axis=0) for each, sigma in rows)
        known = self._inset_first**-2
        information[6, 6] += known
        gradient[6] += known * (self._inset - self._inset_first)
        return solve(information, gradient, self._settings.known_m, self._frozen)

    @property
    def _pivot(self) -> Array:
        return np.asarray(apply(self._T, self._centre[None])[0])

    def _move(self, solution: Solution) -> None:
        turn = Rotation.from_rotvec(solution.step[:3] / self._size).as_matrix()
        pivot = self._pivot
        self._T = transform(pivot + solution.step[3:] - turn @ pivot, turn) @ self._T
        self._inset += solution.inset

    def _take_back(self, lost: Array) -> None:
        so_far = np.concatenate(
            [
                self._size * Rotation.from_matrix(self._T[:3, :3]).as_rotvec(),
                self._pivot - self._centre,
            ]
        )
        self._frozen = lost
        back = -lost @ (lost.T @ so_far)
        self._move(Solution(back, 0.0, np.zeros((6, 7)), lost, float("nan")))

    def _fine_ends(self) -> Array:
        """Points of the whole cloud near the border, found once it is nearly in place."""
        if not self._by_border or self._border.empty:
            return np.zeros((0, 3))
        if self._strip is None:
            pieces = []
            for begin in range(0, len(self._cloud), 500_000):
                local = apply(self._to_part, self._cloud[begin : begin + 500_000])
                near = self._border.near(apply(self._T, local), _STRIP_M)
                pieces.append(local[near])
            self._strip = np.concatenate(pieces)
            # The outermost of the points of a stretch lies, on average, one of them's share inside.
            density = len(self._strip) / max(self._border.length_m * _STRIP_M, 1e-12)
            self._stretch_m = self._border.stretch_m(density)
            self._inset = self._inset_first = 1.0 / max(density * self._stretch_m, 1.0)
        return self._strip

    def _result(
        self,
        converged: bool,
        solution: Solution,
        rows: list[tuple[Rows, float]],
        covered: Array,
    ) -> Alignment:
        surface = rows[0][0]
        rms = float(np.sqrt(np.average(surface.residual**2, weights=surface.weight)))
        to_radians = np.diag([1.0 / self._size] * 3 + [1.0] * 3)
        undetermined = np.hstack([self._frozen, solution.undetermined])
        undetermined = _independent(undetermined)
        return Alignment(
            T_tracker_workpiece=self._initial @ inverse(self._T),
            rms_m=rms,
            iterations=self._iterations,
            converged=converged,
            used_ratio=self._used,
            covariance=to_radians @ covered @ to_radians,
            middle=self._pivot,
            undetermined=motions(undetermined, self._size),
            by_border=len(rows) > 1,
            condition=solution.condition,
        )


def _few(points: Array) -> Array:
    return points[evenly(len(points), _FEW)]


def _tukey(residual: Array, scale: float | None, sigma: float) -> Array:
    bound = TUKEY * sigma if scale is None else scale
    return np.asarray((1.0 - np.minimum(np.abs(residual) / bound, 1.0) ** 2) ** 2)


def _unknown(covered: Array, solution: Solution, known_m: float) -> Array:
    """Returns directions that were solved for, but are held worse than `known_m`, as columns."""
    values, vectors = np.linalg.eigh(covered)
    return np.asarray(vectors[:, values > known_m**2])


def _independent(columns: Array) -> Array:
    if columns.shape[1] == 0:
        return columns
    left, singular, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, singular > 1e-6])
