"""What of a part can be seen at all, by any path (M2.1).

A sample can be seen when some admissible pose exists: its view axis within the incidence limit
about the inward normal, the sample in the field and the range, the ray free, and the scanner's
origin at least the clearance from the part. The search is over

- 43 axes: the inward normal, and rings of 6, 12 and 24 axes up to just inside the limit;
- the stand-off, d_max and d_min;
- the sample on the axis, then 0.8 of the field's radius beside it: where the origin is too near to
  the part, away from what it is too near to (cylinder), or to six sides (cone).

So it is a lower bound: what it finds can be seen; what it does not find could still be seen from a
pose between those tried. Whether an arm reaches the pose is not asked.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skinplan.errors import InputError
from skinplan.mesh.model import SurfaceMesh
from skinplan.scanner.model import CONE, ScannerModel, SurfaceSamples
from skinplan.scanner.rays import RayCaster
from skinplan.scanner.views import Indices, sight_rays
from skinplan.transforms import Array

_RINGS = ((1.0 / 3.0, 6), (2.0 / 3.0, 12), (0.999, 24))
_SIDES = 6
_SHIFT_RATIO = 0.8
# For the clearance the samples are thinned to one in a cube of this share of it: a distance as
# large as the clearance is then overestimated by one percent at most, if the samples are dense.
_THIN_RATIO = 1.0 / 12.0


def seeable(
    mesh: SurfaceMesh,
    samples: SurfaceSamples,
    scanner: ScannerModel,
    clearance_m: float,
    caster: RayCaster | None = None,
) -> NDArray[np.bool_]:
    """Says which samples can be seen at all.

    Args:
        mesh: The part.
        samples: Its samples.
        scanner: Field of view, range and incidence limit.
        clearance_m: Least distance of the scanner's origin from the part [m].
        caster: Rays against the part and what stands about it, when they are at hand.

    Returns:
        shape (s,).

    Raises:
        InputError: A clearance that is negative or not finite.
    """
    if not 0.0 <= clearance_m < np.inf:
        raise InputError(f"a clearance from 0 is accepted, found {clearance_m} m")
    search = _Search(mesh, samples, scanner, clearance_m, caster or RayCaster(mesh))
    result = np.zeros(len(samples.points), dtype=bool)
    for first_try in (True, False):
        for polar, azimuth in _axes(scanner.incidence_max_rad):
            left = np.flatnonzero(~result)
            if len(left) == 0:
                return result
            axes = search.axes(left, polar, azimuth)
            tried = search.on_axis if first_try else search.anywhere
            result[left[tried(left, axes)]] = True
    return result


def _axes(limit_rad: float) -> Iterator[tuple[float, float]]:
    """Yields polar angle and azimuth [rad] of the axes about the normal."""
    yield 0.0, 0.0
    for share, count in _RINGS:
        for number in range(count):
            yield share * limit_rad, 2.0 * np.pi * number / count


class _Search:
    """Tries poses for samples; axes point from the sample to the scanner."""

    def __init__(
        self,
        mesh: SurfaceMesh,
        samples: SurfaceSamples,
        scanner: ScannerModel,
        clearance_m: float,
        caster: RayCaster,
    ) -> None:
        self._samples, self._scanner, self._caster = samples, scanner, caster
        # A place as near as the clearance to the last digit is clear.
        self._clearance_m = clearance_m - 1e-9
        self._part = _thinned(samples.points, _THIN_RATIO * clearance_m)
        self._tree = cKDTree(self._part)
        # Tangents that belong to the part, so that the search turns with it.
        edges = (mesh.corners[:, 1] - mesh.corners[:, 0])[samples.faces]
        self._first = edges / np.maximum(np.linalg.norm(edges, axis=1, keepdims=True), 1e-12)
        self._second = np.cross(samples.normals, self._first)
        low, high = scanner.range_min_m, scanner.range_max_m
        self._depths = (float(np.clip(scanner.standoff_m, low, high)), high, low)

    def axes(self, which: Indices, polar: float, azimuth: float) -> Array:
        """Returns the axes of samples at an angle to their normals, shape (k, 3)."""
        side = np.cos(azimuth) * self._first[which] + np.sin(azimuth) * self._second[which]
        return np.cos(polar) * self._samples.normals[which] + np.sin(polar) * side

    def on_axis(self, which: Indices, axes: Array) -> NDArray[np.bool_]:
        """Tries the stand-off, the sample on the axis, shape (k,)."""
        places = self._samples.points[which] + self._depths[0] * axes
        found = self._free(which, axes, places)
        found[found] = self._nearest(places[found]) < 0
        return found

    def anywhere(self, which: Indices, axes: Array) -> NDArray[np.bool_]:
        """Tries all depths, the sample on the axis and beside it, shape (k,)."""
        found = np.zeros(len(which), dtype=bool)
        for depth in self._depths:
            left = np.flatnonzero(~found)
            tried = self._in_cone if self._scanner.field == CONE else self._in_cylinder
            found[left] = tried(which[left], axes[left], depth)
        return found

    def _in_cylinder(self, which: Indices, axes: Array, depth: float) -> NDArray[np.bool_]:
        """Parallel rays: what is beside the axis has the same ray, only the origin moves."""
        places = self._samples.points[which] + depth * axes
        found = self._free(which, axes, places)
        free = np.flatnonzero(found)
        nearest = self._nearest(places[free])
        found[free] = nearest < 0
        tight, nearest = free[nearest >= 0], nearest[nearest >= 0]
        away = places[tight] - self._part[nearest]
        away -= np.sum(away * axes[tight], axis=1, keepdims=True) * axes[tight]
        away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
        shift = _SHIFT_RATIO * self._scanner.field_radius_m
        found[tight] = self._nearest(places[tight] + shift * away) < 0
        return found

    def _in_cone(self, which: Indices, axes: Array, depth: float) -> NDArray[np.bool_]:
        """Rays from the origin: each place of the origin has its own."""
        found = np.zeros(len(which), dtype=bool)
        across = np.cross(axes, self._second[which])
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
        along = np.cross(across, axes)
        aside = _SHIFT_RATIO * float(self._scanner.field_radius(depth))
        angles = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
        for right, up in [(0.0, 0.0), *zip(np.cos(angles), np.sin(angles), strict=True)]:
            left = np.flatnonzero(~found)
            shift = aside * (right * across[left] + up * along[left])
            places = self._samples.points[which[left]] + depth * axes[left] + shift
            free = self._free(which[left], axes[left], places)
            free[free] = self._nearest(places[free]) < 0
            found[left] = free
        return found

    def _free(self, which: Indices, axes: Array, places: Array) -> NDArray[np.bool_]:
        """Says for which samples nothing is on the ray to the origins, shape (k, 3)."""
        rays = sight_rays(self._samples, which, places, -axes, self._scanner)
        free = ~self._caster.occluded(*rays)
        if self._scanner.field == CONE:
            # Rays from one point can meet the back of what faces the axis.
            toward = places - self._samples.points[which]
            free &= np.einsum("ij,ij->i", toward, self._samples.normals[which]) > 0.0
        return free

    def _nearest(self, places: Array) -> Indices:
        """Returns what of the part is too near to each place, -1 = nothing, shape (k,)."""
        if self._clearance_m <= 0.0 or len(places) == 0:
            return np.full(len(places), -1, dtype=np.int64)
        distance, number = self._tree.query(places, distance_upper_bound=self._clearance_m)
        return np.where(np.isfinite(distance), number, -1).astype(np.int64)


def _thinned(points: Array, size_m: float) -> Array:
    """Keeps the first point in each cube of a grid, all for no size."""
    if len(points) == 0 or size_m <= 0.0:
        return points
    cells = np.floor((points - points.min(axis=0)) / size_m).astype(np.int64)
    numbers = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1))
    return points[np.sort(np.unique(numbers, return_index=True)[1])]
