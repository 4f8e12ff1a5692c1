"""What a set of views sees (M2.1), and the certificate made of it.

A view sees a point of the surface when all of these hold:

- the point is in the cylinder of radius r_f about the view axis, between d_min and d_max along it;
- the angle between the view axis and the inward normal of the surface is at most the incidence
  limit (the paper's cylinder has parallel rays: the axis counts, not the ray from the scanner's
  origin);
- nothing of the part is on the ray from the point, parallel to the axis, up to the plane of the
  scanner's origin. Rays start 2 mm off the surface, so that the chords of a curved surface do not
  hide their own neighbours.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import ScanPathInvalidError
from skinplan.mesh.model import Segmentation, SurfaceMesh
from skinplan.scan_path.model import ScanPath
from skinplan.scanner.model import Coverage, CoverageFigures, ScannerModel, SurfaceSamples
from skinplan.scanner.rays import RayCaster
from skinplan.scanner.samples import sample_surface
from skinplan.transforms import Array

LIFT_M = 0.002
_RAYS_AT_ONCE = 500_000


def visible(
    samples: SurfaceSamples,
    caster: RayCaster,
    positions: Array,
    directions: Array,
    scanner: ScannerModel,
) -> NDArray[np.int64]:
    """Counts the views that see each sample.

    Args:
        samples: The surface samples.
        caster: Rays against what may hide them.
        positions: Scanner origins in the frame of the mesh, shape (n, 3) [m].
        directions: Unit view directions, shape (n, 3).
        scanner: Field of view, range and incidence limit.

    Returns:
        Number of views per sample, shape (s,).
    """
    counts = np.zeros(len(samples.points), dtype=np.int64)
    for _, seen in visible_pairs(samples, caster, positions, directions, scanner):
        counts += np.bincount(seen, minlength=len(counts))
    return counts


def visible_pairs(
    samples: SurfaceSamples,
    caster: RayCaster,
    positions: Array,
    directions: Array,
    scanner: ScannerModel,
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Lists which view sees which sample, some views at a time.

    Args:
        samples: The surface samples.
        caster: Rays against what may hide them.
        positions: Scanner origins, shape (n, 3) [m].
        directions: Unit view directions, shape (n, 3).
        scanner: Field of view, range and incidence limit.

    Yields:
        View numbers and sample numbers, both of shape (k,).
    """
    places, views = _checked_views(positions, directions)
    # Sorted along the part's longest side, every view looks at one slice only.
    axis = int(np.argmax(np.ptp(samples.points, axis=0))) if len(samples.points) else 0
    order = np.argsort(samples.points[:, axis], kind="stable")
    points, normals = samples.points[order], samples.normals[order]
    middles = places + views * (scanner.range_min_m + scanner.range_max_m) / 2
    reach = np.hypot(scanner.field_radius_m, (scanner.range_max_m - scanner.range_min_m) / 2)
    begins = np.searchsorted(points[:, axis], middles[:, axis] - reach)
    ends = np.searchsorted(points[:, axis], middles[:, axis] + reach)
    waiting: list[tuple[int, NDArray[np.int64], Array]] = []
    size = 0
    for view in range(len(places)):
        part = slice(begins[view], ends[view])
        inside, depth = _in_field(points[part], normals[part], places[view], views[view], scanner)
        waiting.append((view, inside + begins[view], depth))
        size += len(inside)
        if size >= _RAYS_AT_ONCE or view == len(places) - 1:
            yield _unhidden(waiting, points, normals, views, caster, order)
            waiting, size = [], 0


def certify(
    mesh: SurfaceMesh,
    segmentation: Segmentation,
    path: ScanPath,
    scanner: ScannerModel,
    spacing_m: float = 0.005,
    caster: RayCaster | None = None,
) -> Coverage:
    """Says what a scan path will see, before anything moves.

    Args:
        mesh: The part.
        segmentation: Its complex regions.
        path: The scan path, in the frame of the mesh.
        scanner: Field of view, range and incidence limit.
        spacing_m: Distance between the surface samples [m].
        caster: Rays against the mesh, when they are at hand.

    Returns:
        The coverage.

    Raises:
        ScanPathInvalidError: The path is not finite, or a direction is no unit vector.
    """
    samples = sample_surface(mesh, spacing_m)
    rays = caster or RayCaster(mesh)
    views = visible(samples, rays, path.positions, path.directions, scanner)
    feature = segmentation.face_region[samples.faces] > 0
    everywhere = np.ones(len(feature), dtype=bool)
    return Coverage(
        samples=samples,
        views=views,
        area_ratio=seen_ratio(samples, views, everywhere),
        feature_area_ratio=seen_ratio(samples, views, feature),
    )


def seen_ratio(
    samples: SurfaceSamples, views: NDArray[np.int64], where: NDArray[np.bool_], least: int = 1
) -> float:
    """Returns the share of area that is seen.

    Args:
        samples: The surface samples.
        views: Number of views of each, shape (s,).
        where: Which samples count, shape (s,).
        least: Number of views from which on a sample counts as seen.

    Returns:
        Share [1]; NaN when no samples count.
    """
    area = float(samples.weights[where].sum())
    return (
        float(samples.weights[where & (views >= least)].sum()) / area if area > 0 else float("nan")
    )


def coverage_figures(path: Coverage, row_cutting: Coverage) -> CoverageFigures:
    """Puts the figures of a scan path beside those of row cutting over the whole part (Fig. 21).

    Args:
        path: Coverage of the scan path.
        row_cutting: Coverage of `skinplan.scan_path.plan.rows_only_path` on the same mesh.

    Returns:
        The figures.
    """
    return CoverageFigures(
        path.area_ratio,
        path.feature_area_ratio,
        row_cutting.area_ratio,
        row_cutting.feature_area_ratio,
    )


def _checked_views(positions: Array, directions: Array) -> tuple[Array, Array]:
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


def _in_field(
    points: Array, normals: Array, position: Array, direction: Array, scanner: ScannerModel
) -> tuple[NDArray[np.int64], Array]:
    """Returns the samples in the field of view that face it, and their depth on the axis [m]."""
    offset = points - position
    depth = offset @ direction
    aside = np.einsum("ij,ij->i", offset, offset) - depth**2
    inside = np.flatnonzero(
        (depth >= scanner.range_min_m)
        & (depth <= scanner.range_max_m)
        & (aside <= scanner.field_radius_m**2)
    )
    facing = -(normals[inside] @ direction) >= np.cos(scanner.incidence_max_rad) - 1e-12
    inside = inside[facing]
    return inside, depth[inside]


def _unhidden(
    waiting: list[tuple[int, NDArray[np.int64], Array]],
    points: Array,
    normals: Array,
    directions: Array,
    caster: RayCaster,
    order: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    view = np.repeat([entry[0] for entry in waiting], [len(entry[1]) for entry in waiting])
    place = np.concatenate([entry[1] for entry in waiting])
    depth = np.concatenate([entry[2] for entry in waiting])
    starts = points[place] + LIFT_M * normals[place]
    free = ~caster.occluded(starts, -directions[view], depth)
    return view[free], order[place[free]]
