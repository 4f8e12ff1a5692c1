"""What a set of views sees (M2.1), and the certificate made of it.

A view sees a point of the surface when all of these hold:

- the point is in the field of view, between d_min and d_max along the view axis. The field is the
  paper's cylinder of radius r_f about the axis, or the cone that it simplifies: its apex is the
  scanner's origin, its radius is r_f at d_min and grows with the depth;
- the angle between the view axis and the inward normal of the surface is at most the incidence
  limit. The axis counts, not the ray from the scanner's origin: the paper's cylinder has parallel
  rays. The angle of the ray is reported beside it. In the cone, whose rays come from one point, the
  surface also has to face that point;
- nothing of the part or of what stands about it is on the ray from the point: parallel to the axis
  up to the plane of the scanner's origin (cylinder), or to the origin (cone). Rays start 2 mm off
  the surface, so that the chords of a curved surface do not hide their own neighbours.

`skinplan.scanner.sight` says which reason is given for what is not seen.

Sampling error. Each sample stands for an area of about spacing x spacing, and only samples beside
the boundary of what is seen can be on the wrong side of it. So an area with a boundary of length L
is found within L x spacing; errors along the boundary mostly cancel, and on planes, cylinders and
spheres a tenth of that was not exceeded. A curved surface is judged by its facets: with an
incidence limit the boundary runs along their edges, so half a facet's width comes on top of the
spacing. A hole smaller than a spacing across can be missed.
`skinplan.scanner.figures.sampling_error` gives the figure of a certificate.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from skinplan.mesh.model import Segmentation, SurfaceMesh
from skinplan.scan_path.model import ScanPath
from skinplan.scanner.certifier import Certifier
from skinplan.scanner.figures import all_figures, region_shares, seen_ratio
from skinplan.scanner.model import Coverage, CoverageFigures, ScannerModel, SurfaceSamples
from skinplan.scanner.motion import STEP_M, STEP_RAD
from skinplan.scanner.rays import RayCaster
from skinplan.scanner.views import LIFT_M, checked_views, looks, sight_rays
from skinplan.transforms import Array

__all__ = [
    "LIFT_M",
    "certify",
    "certify_motion",
    "coverage_figures",
    "seen_ratio",
    "visible",
    "visible_pairs",
]


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
    places, views = checked_views(positions, directions)
    for found in looks(samples, places, views, scanner):
        rays = sight_rays(samples, found.samples, places[found.views], views[found.views], scanner)
        free = ~caster.occluded(*rays)
        yield found.views[free], found.samples[free]


def certify(
    mesh: SurfaceMesh,
    segmentation: Segmentation,
    path: ScanPath,
    scanner: ScannerModel,
    spacing_m: float = 0.005,
    caster: RayCaster | None = None,
    occluders: Sequence[SurfaceMesh] = (),
    least_views: int = 3,
    clearance_m: float | None = None,
) -> Coverage:
    """Says what the points of a scan path will see, before anything moves.

    `skinplan.scanner.certifier.Certifier` does it for several paths of one part.

    Args:
        mesh: The part.
        segmentation: Its complex regions.
        path: The scan path, in the frame of the mesh.
        scanner: Field of view, range and incidence limit.
        spacing_m: Distance between the surface samples [m].
        caster: Rays against the mesh and what stands about it, when they are at hand.
        occluders: What else may hide the part, in its frame: the fixture.
        least_views: Number of views that is asked for.
        clearance_m: Least distance of the scanner's origin from the part [m]: also says what can be
            seen at all. None = that is not asked.

    Returns:
        The coverage.

    Raises:
        ScanPathInvalidError: The path is not finite, or a direction is no unit vector.
        InputError: A spacing, a number of views or a clearance that can't be used.
    """
    certifier = Certifier(
        mesh, segmentation, scanner, spacing_m, caster, occluders, least_views, clearance_m
    )
    return certifier.points(path)


def certify_motion(
    mesh: SurfaceMesh,
    segmentation: Segmentation,
    path: ScanPath,
    scanner: ScannerModel,
    spacing_m: float = 0.005,
    caster: RayCaster | None = None,
    occluders: Sequence[SurfaceMesh] = (),
    least_views: int = 3,
    clearance_m: float | None = None,
    sequences: Sequence[NDArray[np.int64]] | None = None,
    step_m: float = STEP_M,
    step_rad: float = STEP_RAD,
) -> Coverage:
    """Says what a scan path will see at its points and along the motion between them.

    Args:
        mesh: As for `certify`; all further ones up to `clearance_m` too.
        segmentation: Its complex regions.
        path: The scan path, in the frame of the mesh.
        scanner: Field of view, range and incidence limit.
        spacing_m: Distance between the surface samples [m].
        caster: Rays, when they are at hand.
        occluders: What else may hide the part.
        least_views: Number of views that is asked for.
        clearance_m: Least distance of the scanner's origin from the part [m], or None.
        sequences: Point numbers in the order of motion, one array for each motion that scans; None
            = the rows, each for itself.
        step_m: Largest distance between views along the motion [m].
        step_rad: Largest angle between them [rad].

    Returns:
        The coverage; `Certifier.motion` says what of it is exact.

    Raises:
        ScanPathInvalidError: The path is not finite, or a direction is no unit vector.
        InputError: A figure that can't be used.
    """
    certifier = Certifier(
        mesh, segmentation, scanner, spacing_m, caster, occluders, least_views, clearance_m
    )
    return certifier.motion(path, sequences, step_m, step_rad)


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
        path.least_views,
        tuple(region_shares(figures) for figures in all_figures(path)),
    )
