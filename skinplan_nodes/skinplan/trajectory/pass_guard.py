"""Keeps the coverage certificate from getting worse while single poses are moved."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skinplan.part.model import ScanSettings
from skinplan.scan_path.view_choice import some_of
from skinplan.scanner.certifier import Certifier
from skinplan.scanner.coverage import visible
from skinplan.scanner.model import ScannerModel
from skinplan.transforms import Array

Indices = NDArray[np.int64]
Poses = tuple[Array, Array]  # scanner origins [m] and unit view directions, shape (n, 3) each

# Areas are sums of thousands of numbers: what differs by less is equal.
_EQUAL_M2 = 1e-10
_SLACK_M = 1e-6


@dataclass(frozen=True, eq=False)
class _Looked:
    """What some poses, and all others, see about them with one scanner.

    Attributes:
        near: Samples that the poses may see, wherever they are moved, shape (n,).
        near_others: Number of other poses that see each of them, shape (n,).
        samples: Those of them on which the poses matter, shape (k,).
        others: Number of other poses that see each of these, shape (k,).
        own: Number of the poses that do, shape (k,).
    """

    near: Indices
    near_others: Indices
    samples: Indices
    others: Indices
    own: Indices


class _FieldGuard:
    """Counts which poses see what with one scanner."""

    def __init__(
        self,
        certifier: Certifier,
        scanner: ScannerModel,
        feature: NDArray[np.bool_],
        least_views: int,
        poses: Poses,
    ) -> None:
        self._samples, self._caster = certifier.samples, certifier.caster
        self._scanner, self._feature, self._least = scanner, feature, least_views
        self._views = visible(self._samples, self._caster, *poses, scanner)

    def looked_at(self, near: Indices, poses: Poses) -> _Looked:
        own = self._seen(near, poses)
        others = self._views[near] - own
        matters = others < self._least
        return _Looked(near, others, near[matters], others[matters], own[matters])

    def keeps(self, looked: _Looked, poses: Poses) -> _Looked | None:
        own = self._seen(looked.samples, poses)
        weights, feature = self._samples.weights[looked.samples], self._feature[looked.samples]
        for least in (1, self._least):
            seen = (looked.others + own >= least).astype(float)
            gain = weights * (seen - (looked.others + looked.own >= least))
            if gain.sum() < -_EQUAL_M2 or gain[feature].sum() < -_EQUAL_M2:
                return None
        return replace(looked, own=own)

    def moved(self, looked: _Looked, poses: Poses) -> None:
        self._views[looked.near] = looked.near_others + self._seen(looked.near, poses)

    def _seen(self, chosen: Indices, poses: Poses) -> Indices:
        if not len(chosen):
            return np.zeros(0, dtype=np.int64)
        part = some_of(self._samples, chosen)
        return visible(part, self._caster, *poses, self._scanner)


Looked = tuple[_Looked, ...]


class CoverageGuard:
    """Counts which poses see what, and says whether a move of some makes the certificate worse.

    Judged are four areas: of the part and of its complex regions, what is seen at all and what is
    seen as often as asked for. They are judged twice, the second time with the scanner narrowed by
    the margins that planning keeps: else the margins would be the first thing that a move uses up.
    A sample that the other poses see often enough plays no part in the areas, so only the rest is
    looked at: the answer is exact all the same.

    Args:
        certifier: Samples, rays and scanner.
        settings: Number of views asked for, and the margins.
        regions: Complex region of each face of the part, 0 = flat surface, shape (f,).
        poses: All poses.
    """

    def __init__(
        self,
        certifier: Certifier,
        settings: ScanSettings,
        regions: NDArray[np.int64],
        poses: Poses,
    ) -> None:
        scanner = certifier.scanner
        self._tree = cKDTree(certifier.samples.points)
        narrow = scanner.narrowed(settings.field_margin_m, settings.incidence_margin_rad)
        feature = regions[certifier.samples.faces] > 0
        self._guards = [
            _FieldGuard(certifier, each, feature, settings.least_views, poses)
            for each in dict.fromkeys((scanner, narrow))
        ]
        radius = float(scanner.field_radius(scanner.range_max_m))
        # No pose sees farther than this from a target on its axis and in its range [m].
        self.reach_m = float(np.hypot(radius, scanner.range_max_m - scanner.range_min_m))

    def looked_at(self, targets: Array, poses: Poses) -> Looked:
        """Prepares moves of some poses that look at targets within their range.

        Args:
            targets: Where their axes meet the part, before and after, shape (k, 3) [m].
            poses: As they are.
        """
        lists = self._tree.query_ball_point(targets, self.reach_m + _SLACK_M)
        near = np.unique(np.concatenate([np.asarray(each, dtype=np.int64) for each in lists]))
        return tuple(guard.looked_at(near, poses) for guard in self._guards)

    def keeps(self, looked: Looked, poses: Poses) -> Looked | None:
        """Returns how things stand after a move, or None when an area would get smaller.

        Args:
            looked: How things stand.
            poses: The poses of ``looked`` after the move.
        """
        result = []
        for guard, state in zip(self._guards, looked, strict=True):
            after = guard.keeps(state, poses)
            if after is None:
                return None
            result.append(after)
        return tuple(result)

    def moved(self, looked: Looked, poses: Poses) -> None:
        """Takes note of where the poses of ``looked`` stand at last."""
        for guard, state in zip(self._guards, looked, strict=True):
            guard.moved(state, poses)
