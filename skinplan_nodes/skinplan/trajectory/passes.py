"""Optimisation of depth and angles of the scan passes (T S2, S3).

A pass is a row of the scan path, which moves as a whole so that its motion stays as even as it was:
depth, in-plane and out-of-plane angle of all its points change by the same amount. A feature
viewpoint has no motion of its own and moves alone; the viewpoints of a region are reported
together. The variables are moved one at a time, depth first, toward where the evaluation function E
(`pass_error`) is least, as far as the constraints allow:

(a) the motion is one that the robot can make: the caller says so, else `clear_of` the part;
(b) the effective scan width of each point is greater than the distance to the neighbouring pass;
(c), (d) out-of-plane and in-plane angle are within the incidence limit less its margin, the depth
within the range less its margin, and no view is tilted beyond the settings' tilt that was not
before.

Beyond the patent no move may make the coverage certificate worse, neither that of the scanner nor
that of the scanner narrowed by the settings' margins (`pass_guard`). A pass that nothing moves is
left untouched, digit for digit. When no pass moves any more the work is done, so doing it again
changes nothing.
"""

import logging
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from skinplan.errors import ScanPathInvalidError
from skinplan.mesh.model import Segmentation, SurfaceMesh
from skinplan.part.model import ScanSettings
from skinplan.part.settings import check_settings
from skinplan.scan_path.model import FEATURE, PassReport, ScanPath
from skinplan.scanner.certifier import Certifier
from skinplan.scanner.motion import row_sequences
from skinplan.scanner.predict import part_certifier
from skinplan.scanner.views import checked_views
from skinplan.trajectory.pass_error import PassSettings, pass_error
from skinplan.trajectory.pass_guard import CoverageGuard, Looked
from skinplan.trajectory.pass_limits import (
    Feasible,
    PassLimits,
    clear_of,
    require_reachable,
)
from skinplan.trajectory.pass_poses import (
    DEPTH,
    IN_PLANE,
    OUT_OF_PLANE,
    PassPoses,
    pass_spacings,
)
from skinplan.transforms import Array

_LOG = logging.getLogger(__name__)

Indices = NDArray[np.int64]

OPTIMAL = "nothing to gain"
MISPLACED = "a pose has no target on its axis that faces it within the scanner's range"
WORSE_SEEN = "the part would be seen less"

_EPS = 1e-9


def optimise_passes(
    path: ScanPath,
    mesh: SurfaceMesh,
    segmentation: Segmentation,
    settings: ScanSettings,
    certifier: Certifier | None = None,
    feasible: Feasible | None = None,
    options: PassSettings | None = None,
) -> tuple[ScanPath, tuple[PassReport, ...]]:
    """Moves depth and angles of the passes to where the evaluation function is least (T S3).

    Args:
        path: The scan path, workpiece frame.
        mesh: The part.
        segmentation: Its complex regions.
        settings: Scanner, limits, clearance and number of views asked for.
        certifier: Of the part with what stands about it, when it is at hand; None = the part alone.
        feasible: Constraint (a): says of positions, shape (n, 3) [m], and unit view directions,
            shape (n, 3), which the robot can take, shape (n,); None = `clear_of` the part.
        options: Of the evaluation function and the search; None = the defaults.

    Returns:
        The path with the same points in the same order, and what became of each pass, rows first;
        the path holds the reports, too.

    Raises:
        ScanPathInvalidError: The path is not finite, or a direction is no unit vector.
        PartInvalidError: A scan setting out of range.
        InputError: Best angles outside the scanner's limits.
    """
    settings, options = check_settings(settings), options or PassSettings()
    checked_views(path.positions, path.directions)
    if not np.isfinite(path.targets).all():
        raise ScanPathInvalidError("finite targets are accepted, found NaN or infinite values")
    require_reachable(options, settings)
    certifier = certifier or part_certifier(mesh, segmentation, settings, with_seeable=False)
    if not len(path):
        return path, ()
    work = _Optimisation(
        path,
        settings,
        options,
        CoverageGuard(
            certifier, settings, segmentation.face_region, (path.positions, path.directions)
        ),
        PassPoses.of(path, certifier.samples, certifier.scanner, 0.5 * settings.row_interval_m),
        feasible or clear_of(mesh, settings, certifier.caster),
    )
    return work.run()


class _Optimisation:
    """The state of one optimisation; a unit is a row or a single viewpoint."""

    def __init__(
        self,
        path: ScanPath,
        settings: ScanSettings,
        options: PassSettings,
        guard: CoverageGuard,
        poses: PassPoses,
        feasible: Feasible,
    ) -> None:
        self._path, self._settings, self._options = path, settings, options
        self._guard, self._poses, self._feasible = guard, poses, feasible
        self._limits = PassLimits(poses, settings, pass_spacings(path, settings.field_radius_m))
        self._values = poses.values.copy()
        self._positions, self._directions = path.positions.copy(), path.directions.copy()
        single = np.flatnonzero(path.kinds == FEATURE)
        self._units = [*row_sequences(path), *(single[k : k + 1] for k in range(len(single)))]
        self._reasons = [OPTIMAL] * len(self._units)

    def run(self) -> tuple[ScanPath, tuple[PassReport, ...]]:
        """Goes over the units until none moves any more."""
        near = self._neighbours()
        open_ = np.ones(len(self._units), dtype=bool)
        for _ in range(self._options.sweeps):
            for number in np.flatnonzero(open_):
                open_[number] = False
                if self._move(int(number)):
                    open_[near[number]] = True
            if not open_.any():
                break
        else:
            _LOG.warning("passes: %d still move after %d sweeps", open_.sum(), self._options.sweeps)
        reports = self._reports()
        path = replace(
            self._path, positions=self._positions, directions=self._directions, passes=reports
        )
        return path, reports

    def _move(self, number: int) -> bool:
        """Moves the variables of one unit in turn; says whether any moved."""
        unit = self._units[number]
        self._reasons[number] = OPTIMAL
        if not self._poses.placed[unit].all():
            self._reasons[number] = MISPLACED
            return False
        looked: Looked | None = None
        changed = False
        for variable in (DEPTH, IN_PLANE, OUT_OF_PLANE):
            shift = self._shift(unit, variable)
            if not self._gains(unit, self._shifted(unit, variable, shift)):
                continue
            looked = looked or self._guard.looked_at(
                self._path.targets[unit], (self._positions[unit], self._directions[unit])
            )
            values, looked, reason = self._farthest(unit, variable, shift, looked)
            if reason:
                self._reasons[number] = reason
            if values is not None and self._gains(unit, values):
                self._values[:, unit] = values
                self._positions[unit], self._directions[unit] = self._placed(unit, values)
                changed = True
        if changed and looked is not None:
            self._guard.moved(looked, (self._positions[unit], self._directions[unit]))
        return changed

    def _shift(self, unit: Indices, variable: int) -> float:
        """The change of a variable, the same for all points, that makes the unit's E least."""
        values = self._values[variable, unit]
        if variable == DEPTH:
            return max(0.0, self._limits.depths_m[1] - float(values.max()))
        options = self._options
        best = options.best_in_plane_rad if variable == IN_PLANE else options.best_out_of_plane_rad
        # E is piecewise linear in the shift: it is least where a point has its best angle.
        shifts = np.unique(np.concatenate([best - values, -best - values]))
        errors = np.array([self._error(unit, self._shifted(unit, variable, s)) for s in shifts])
        return float(shifts[np.lexsort((np.abs(shifts), np.round(errors, 12)))[0]])

    def _farthest(
        self, unit: Indices, variable: int, shift: float, looked: Looked
    ) -> tuple[Array | None, Looked, str]:
        """The longest share of a shift that is allowed, and why it is not the whole."""
        values = self._shifted(unit, variable, shift)
        state, reason = self._allowed(unit, values, looked)
        if state is not None:
            return values, state, ""
        best, result, low, high = None, looked, 0.0, 1.0
        for _ in range(self._options.halvings):
            middle = 0.5 * (low + high)
            values = self._shifted(unit, variable, middle * shift)
            # What is left to find lies below ``high``: it may be too little to gain anything.
            if not self._gains(unit, self._shifted(unit, variable, high * shift)):
                break
            state, _ = self._allowed(unit, values, looked)
            if state is None:
                high = middle
            else:
                best, result, low = values, state, middle
        if best is not None and not self._gains(unit, best):
            best, result = None, looked
        return best, result, reason

    def _allowed(self, unit: Indices, values: Array, looked: Looked) -> tuple[Looked | None, str]:
        """What the unit sees with other depths and angles, or what forbids them."""
        positions, directions = self._placed(unit, values)
        reason = self._limits.broken(
            unit, values, positions, directions, self._directions[unit], self._feasible
        )
        if reason:
            return None, reason
        return self._guard.keeps(looked, (positions, directions)), WORSE_SEEN

    def _shifted(self, unit: Indices, variable: int, shift: float) -> Array:
        values = self._values[:, unit].copy()
        values[variable] += shift
        return values

    def _placed(self, unit: Indices, values: Array) -> tuple[Array, Array]:
        toward = self._poses.toward(unit, values)
        return self._path.targets[unit] + values[DEPTH][:, None] * toward, -toward

    def _error(self, unit: Indices, values: Array) -> float:
        return float(self._errors(values).mean())

    def _errors(self, values: Array) -> Array:
        limit = self._settings.range_max_m
        return pass_error(
            values[DEPTH], values[OUT_OF_PLANE], values[IN_PLANE], limit, self._options
        )

    def _gains(self, unit: Indices, values: Array) -> bool:
        now = self._error(unit, self._values[:, unit])
        least = max(self._options.least_gain, self._options.least_gain_ratio * now)
        return now - self._error(unit, values) >= least

    def _neighbours(self) -> list[Indices]:
        """The units, itself among them, that see some of what each unit sees."""
        owner = np.repeat(np.arange(len(self._units)), [len(unit) for unit in self._units])
        targets = self._path.targets[np.concatenate(self._units)]
        near = cdist(targets, targets) <= 2.0 * self._guard.reach_m + _EPS
        return [
            np.unique(owner[near[owner == number].any(axis=0)]) for number in range(owner[-1] + 1)
        ]

    def _reports(self) -> tuple[PassReport, ...]:
        """What became of each row and of the viewpoints of each region."""
        path = self._path
        before, after = self._errors(self._poses.values), self._errors(self._values)
        moved = (self._positions != path.positions).any(axis=1)
        moved |= (self._directions != path.directions).any(axis=1)
        reports = []
        for kind, group in sorted(set(zip(path.kinds.tolist(), path.groups.tolist(), strict=True))):
            which = (path.kinds == kind) & (path.groups == group)
            reasons = [
                reason
                for unit, reason in zip(self._units, self._reasons, strict=True)
                if which[unit[0]] and not moved[unit[0]]
            ]
            # The reason that most of the points left have, the first of several.
            reason = max(reasons, key=reasons.count) if reasons else ""
            reports.append(
                PassReport(
                    int(kind), int(group), int(which.sum()), float(before[which].mean()),
                    float(after[which].mean()), int(moved[which].sum()), reason,
                )
            )  # fmt: skip
        return tuple(reports)
