"""Counts which views see which samples, how obliquely, and what came nearest to seeing the rest."""

import numpy as np
from numpy.typing import NDArray

from skinplan.scanner.model import ScannerModel, SurfaceSamples
from skinplan.scanner.rays import RayCaster
from skinplan.scanner.sight import Sight
from skinplan.scanner.views import Indices, in_field_sideways, looks, sight_rays
from skinplan.transforms import Array

_NO_VIEW = np.iinfo(np.int64).max
# Every eighth view first, then those between: neighbours see the same, so most samples are done
# after the first turn.
_TURNS = ((0, 8), (4, 8), (2, 4), (1, 2))


class Tally:
    """What the views taken in so far see. Views have the numbers of the order they come in.

    Args:
        samples: The surface samples.
        caster: Rays against what may hide them.
        scanner: Field of view, range and incidence limit.
    """

    def __init__(self, samples: SurfaceSamples, caster: RayCaster, scanner: ScannerModel) -> None:
        count = len(samples.points)
        self.views = np.zeros(count, dtype=np.int64)
        self._samples, self._caster, self._scanner = samples, caster, scanner
        self._axis_cosine = np.full(count, -np.inf)
        self._ray_cosine = np.full(count, -np.inf)
        self._oblique = np.zeros(count, dtype=bool)
        self._hidden_view = np.full(count, _NO_VIEW)
        self._positions = np.zeros((0, 3))
        self._directions = np.zeros((0, 3))

    def add(self, positions: Array, directions: Array) -> None:
        """Takes views in; every sample is tested against each.

        Args:
            positions: Scanner origins, shape (n, 3) [m], checked.
            directions: Unit view directions, shape (n, 3), checked.
        """
        first = self._remember(positions, directions)
        self._look(first + np.arange(len(positions)), None)

    def add_until(self, positions: Array, directions: Array, least: int) -> None:
        """Takes views in; a sample seen `least` times or more is not tested any more.

        Counts below `least` are exact, and so is what is not seen and why.

        Args:
            positions: Scanner origins, shape (n, 3) [m], checked.
            directions: Unit view directions, shape (n, 3), checked.
            least: Number of views that is enough, at least 1.
        """
        first = self._remember(positions, directions)
        for begin, step in _TURNS:
            wanting = np.flatnonzero(self.views < least)
            if len(wanting) == 0:
                return
            self._look(first + np.arange(begin, len(positions), step), wanting)

    @property
    def axis_rad(self) -> Array:
        """Smallest angle of a view axis that sees each sample, NaN for none, shape (s,) [rad]."""
        return _angles(self._axis_cosine)

    @property
    def ray_rad(self) -> Array:
        """Smallest angle of a ray from the origin of a view that sees each, shape (s,) [rad]."""
        return _angles(self._ray_cosine)

    def reasons(self) -> NDArray[np.int8]:
        """Returns the `Sight` of each sample, SEEN for all that are seen, shape (s,)."""
        result = np.full(len(self.views), Sight.NOT_REACHED, dtype=np.int8)
        unseen = self.views == 0
        hidden = self._hidden_view != _NO_VIEW
        result[~unseen] = Sight.SEEN
        result[unseen & self._oblique] = Sight.TOO_OBLIQUE
        rest = np.flatnonzero(unseen & ~self._oblique & ~hidden)
        beside = in_field_sideways(
            self._samples.points[rest], self._positions, self._directions, self._scanner
        )
        result[rest[beside]] = Sight.OUT_OF_RANGE
        behind = np.flatnonzero(unseen & hidden)
        result[behind] = self._what_hides(behind)
        return result

    def _what_hides(self, which: Indices) -> NDArray[np.int8]:
        views = self._hidden_view[which]
        starts, toward, _ = sight_rays(
            self._samples, which, self._positions[views], self._directions[views], self._scanner
        )
        _, faces = self._caster.hits(starts, toward)
        by_fixture = faces >= self._caster.part_faces
        return np.where(by_fixture, Sight.HIDDEN_BY_FIXTURE, Sight.HIDDEN_BY_PART).astype(np.int8)

    def _remember(self, positions: Array, directions: Array) -> int:
        first = len(self._positions)
        self._positions = np.concatenate([self._positions, positions])
        self._directions = np.concatenate([self._directions, directions])
        return first

    def _look(self, numbers: Indices, chosen: Indices | None) -> None:
        positions, directions = self._positions[numbers], self._directions[numbers]
        samples = self._samples
        for found in looks(samples, positions, directions, self._scanner, chosen):
            places, axes = positions[found.views], directions[found.views]
            rays = sight_rays(samples, found.samples, places, axes, self._scanner)
            free = ~self._caster.occluded(*rays)
            self._oblique[found.oblique] = True
            hidden = found.samples[~free]
            np.minimum.at(self._hidden_view, hidden, numbers[found.views[~free]])
            seen = found.samples[free]
            self.views += np.bincount(seen, minlength=len(self.views))
            self._nearest_angles(seen, places[free], axes[free])

    def _nearest_angles(self, seen: Indices, places: Array, axes: Array) -> None:
        normals = self._samples.normals[seen]
        rays = self._samples.points[seen] - places
        lengths = np.sqrt(np.einsum("ij,ij->i", rays, rays))
        np.maximum.at(self._axis_cosine, seen, -np.einsum("ij,ij->i", normals, axes))
        np.maximum.at(self._ray_cosine, seen, -np.einsum("ij,ij->i", normals, rays) / lengths)


def _angles(cosines: Array) -> Array:
    seen = np.isfinite(cosines)
    return np.where(seen, np.arccos(np.clip(np.where(seen, cosines, 0.0), -1.0, 1.0)), np.nan)
