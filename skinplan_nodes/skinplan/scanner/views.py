"""Which samples lie in the field of which view (M2.1), and the rays that must be free.

For many views at once; `skinplan.scanner.coverage` says what the field of a view is.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import ScanPathInvalidError
from skinplan.scanner.model import CONE, ScannerModel, SurfaceSamples
from skinplan.transforms import Array

Indices = NDArray[np.int64]
LIFT_M = 0.002
_RAYS_AT_ONCE = 500_000
_PAIRS_AT_ONCE = 4_000_000
_CELL_RATIO = 0.25
# Slack of the gates for the last digits of double precision: a pose on a limit counts as inside.
_SLACK = 1e-12


@dataclass(frozen=True, eq=False)
class Looks:
    """Samples in the field and range of some views.

    Attributes:
        views: View numbers of the samples that face the view, shape (k,), ascending.
        samples: Their sample numbers, shape (k,).
        oblique: Numbers of samples that are too oblique for one of the views, shape (m,).
    """

    views: Indices
    samples: Indices
    oblique: Indices


def checked_views(positions: Array, directions: Array) -> tuple[Array, Array]:
    """Returns positions and unit directions as arrays of shape (n, 3).

    Raises:
        ScanPathInvalidError: Another shape, values that are not finite, no unit vectors.
    """
    places, views = np.asarray(positions, dtype=float), np.asarray(directions, dtype=float)
    if places.ndim != 2 or places.shape[1] != 3 or places.shape != views.shape:
        raise ScanPathInvalidError(
            f"positions and directions of one shape (n, 3) are accepted, found {places.shape} "
            f"and {views.shape}"
        )
    if not (np.isfinite(places).all() and np.isfinite(views).all()):
        raise ScanPathInvalidError(
            "finite positions and directions are accepted, found NaN or infinite values"
        )
    lengths = np.linalg.norm(views, axis=1)
    if len(lengths) and np.abs(lengths - 1.0).max() > 1e-3:
        raise ScanPathInvalidError(
            "unit view directions are accepted, found one of length "
            f"{lengths[np.abs(lengths - 1.0).argmax()]:.4g}"
        )
    return places, views


def looks(
    samples: SurfaceSamples,
    positions: Array,
    directions: Array,
    scanner: ScannerModel,
    chosen: Indices | None = None,
) -> Iterator[Looks]:
    """Lists which samples are in the field of which view, some views at a time.

    Args:
        samples: The surface samples.
        positions: Scanner origins, shape (n, 3) [m].
        directions: Unit view directions, shape (n, 3).
        scanner: Field of view, range and incidence limit.
        chosen: Numbers of the samples to look at; None = all.

    Yields:
        The samples and views; whether something hides them is not yet tested.
    """
    # Sorted along the part's longest side, every view looks at one slice only.
    axis = int(np.argmax(np.ptp(samples.points, axis=0))) if len(samples.points) else 0
    among = np.arange(len(samples.points)) if chosen is None else chosen
    order = among[np.argsort(samples.points[among, axis], kind="stable")]
    points = samples.points[order]
    middles = positions + directions * (scanner.range_min_m + scanner.range_max_m) / 2
    reach = np.hypot(
        scanner.field_radius(scanner.range_max_m), (scanner.range_max_m - scanner.range_min_m) / 2
    )
    begins = np.searchsorted(points[:, axis], middles[:, axis] - reach)
    ends = np.searchsorted(points[:, axis], middles[:, axis] + reach)
    found: list[Indices] = []
    oblique: list[Indices] = []
    first = size = 0
    for view in range(len(positions)):
        part = slice(begins[view], ends[view])
        inside = _in_field(points[part], positions[view], directions[view], scanner)
        within = order[part][inside]
        facing = _faces(samples, within, positions[view], directions[view], scanner)
        found.append(within[facing])
        oblique.append(within[~facing])
        size += len(inside)
        if size >= _RAYS_AT_ONCE or view == len(positions) - 1:
            numbers = np.repeat(np.arange(first, view + 1), [len(each) for each in found])
            yield Looks(numbers, np.concatenate(found), np.concatenate(oblique))
            found, oblique, first, size = [], [], view + 1, 0


def sight_rays(
    samples: SurfaceSamples,
    which: Indices,
    positions: Array,
    directions: Array,
    scanner: ScannerModel,
) -> tuple[Array, Array, Array]:
    """Returns the rays that must be free for samples to be seen.

    Args:
        samples: The surface samples.
        which: Sample numbers, shape (k,).
        positions: Scanner origin for each, shape (k, 3) [m].
        directions: View direction for each, shape (k, 3).
        scanner: Field of view.

    Returns:
        Starts, shape (k, 3) [m], unit directions, shape (k, 3), and lengths, shape (k,) [m].
    """
    points = samples.points[which]
    starts = points + LIFT_M * samples.normals[which]
    if scanner.field == CONE:
        toward = positions - starts
        lengths = np.linalg.norm(toward, axis=1)
        return starts, toward / np.maximum(lengths, 1e-12)[:, None], lengths
    depth = np.einsum("ij,ij->i", points - positions, directions)
    return starts, -directions, depth


def in_field_sideways(
    points: Array, positions: Array, directions: Array, scanner: ScannerModel
) -> NDArray[np.bool_]:
    """Says which points lie in the field of any view, whatever their distance in front of it.

    Args:
        points: shape (p, 3) [m].
        positions: Scanner origins, shape (n, 3) [m].
        directions: Unit view directions, shape (n, 3).
        scanner: Field of view.

    Returns:
        shape (p,).
    """
    if len(points) == 0 or len(positions) == 0:
        return np.zeros(len(points), dtype=bool)
    # Most places are far inside or far outside all fields: whole cells are tested first.
    owners, middles, radii = _cells(points, _CELL_RATIO * scanner.field_radius_m)
    margins = _sideways_margins(middles, positions, directions, scanner, radii)
    result = (margins > 0.0)[owners]
    doubtful = np.flatnonzero(((margins <= 0.0) & (margins > -np.inf))[owners])
    exact = _sideways_margins(points[doubtful], positions, directions, scanner, None)
    result[doubtful] = exact > 0.0
    return result


def _cells(points: Array, size_m: float) -> tuple[Indices, Array, Array]:
    """Puts points into cubes: cube of each, shape (p,), and mean and radius of what is in each."""
    places = np.floor((points - points.min(axis=0)) / size_m).astype(np.int64)
    numbers = np.ravel_multi_index(tuple(places.T), tuple(places.max(axis=0) + 1))
    _, owners = np.unique(numbers, return_inverse=True)
    counts = np.bincount(owners)
    middles = np.stack(
        [np.bincount(owners, weights=points[:, axis]) / counts for axis in range(3)], axis=1
    )
    radii = np.zeros(len(counts))
    np.maximum.at(radii, owners, np.linalg.norm(points - middles[owners], axis=1))
    return owners, middles, radii


def _sideways_margins(
    points: Array,
    positions: Array,
    directions: Array,
    scanner: ScannerModel,
    radii: Array | None,
) -> Array:
    """Says how points, or balls about them, lie to the fields of all views.

    Returns:
        1 where a field holds all of it, 0 where one may hold some, -inf where none does; points
        are held or not. Shape (p,).
    """
    result = np.full(len(points), -np.inf)
    middle = points.mean(axis=0) if len(points) else np.zeros(3)
    places = positions - middle
    along = np.einsum("ij,ij->i", places, directions)
    squares = np.einsum("ij,ij->i", places, places)
    step = max(1, _PAIRS_AT_ONCE // len(positions))
    for begin in range(0, len(points), step):
        part = points[begin : begin + step] - middle
        size = np.zeros((len(part), 1)) if radii is None else radii[begin : begin + step, None]
        depth = part @ directions.T - along
        aside = np.einsum("ij,ij->i", part, part)[:, None] - 2.0 * (part @ places.T) + squares
        aside = np.sqrt(np.maximum(aside - depth**2, 0.0))
        whole = (depth > size) & (aside + size <= scanner.field_radius(depth - size) + _SLACK)
        some = (depth + size > 0.0) & (aside - size <= scanner.field_radius(depth + size) + _SLACK)
        result[begin : begin + step][some.any(axis=1)] = 0.0
        result[begin : begin + step][whole.any(axis=1)] = 1.0
    return result


def _in_field(points: Array, position: Array, direction: Array, scanner: ScannerModel) -> Indices:
    """Returns the points in the field and the range of a view."""
    offset = points - position
    depth = offset @ direction
    deep = np.flatnonzero(
        (depth >= scanner.range_min_m - _SLACK) & (depth <= scanner.range_max_m + _SLACK)
    )
    near, depth = offset[deep], depth[deep]
    aside = np.einsum("ij,ij->i", near, near) - depth**2
    return deep[aside <= np.square(scanner.field_radius(depth)) + _SLACK]


def _faces(
    samples: SurfaceSamples,
    which: Indices,
    position: Array,
    direction: Array,
    scanner: ScannerModel,
) -> NDArray[np.bool_]:
    """Says which samples are not too oblique for a view."""
    normals = samples.normals[which]
    facing = -(normals @ direction) >= np.cos(scanner.incidence_max_rad) - _SLACK
    if scanner.field == CONE:
        # Rays from one point can meet the back of what faces the axis.
        rays = samples.points[which] - position
        facing &= np.einsum("ij,ij->i", normals, rays) < 0.0
    return np.asarray(facing)
