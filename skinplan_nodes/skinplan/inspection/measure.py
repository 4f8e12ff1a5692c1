"""What a merged cloud says about a part: alignment, deviation along the normal, area measured."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from skinplan.errors import AlignmentError
from skinplan.inspection.closest import Closest, SurfaceIndex
from skinplan.inspection.coverage import RADIUS_M, CoverageSoFar
from skinplan.inspection.model import Inspection
from skinplan.inspection.points import checked_points
from skinplan.inspection.registration import RegistrationSettings, register
from skinplan.inspection.surface import SurfaceFigures
from skinplan.mesh.model import Segmentation, SurfaceMesh
from skinplan.scanner.model import SurfaceSamples
from skinplan.scanner.samples import sample_surface
from skinplan.transforms import Array, apply, inverse, rotate

_BATCH, _WORKERS = 100_000, 2


@dataclass(frozen=True)
class InspectionSettings:
    """How a cloud is judged.

    Attributes:
        spacing_m: Spacing of the surface samples [m].
        radius_m: A sample counts as measured when a point lies within this distance [m].
        deviation_max_m: Points farther from the surface are none of the part's [m].
        registration: How the cloud is laid on the part.
    """

    spacing_m: float = 0.005
    radius_m: float = RADIUS_M
    deviation_max_m: float = 0.02
    registration: RegistrationSettings = field(default_factory=RegistrationSettings)


def coverage_so_far(
    samples: SurfaceSamples, segmentation: Segmentation, radius_m: float = RADIUS_M
) -> CoverageSoFar:
    """Returns an empty coverage whose complex regions are those of the segmentation."""
    return CoverageSoFar(samples, segmentation.face_region[samples.faces] > 0, radius_m)


def inspect(
    points: Array,
    mesh: SurfaceMesh,
    segmentation: Segmentation,
    T_tracker_workpiece: Array,
    settings: InspectionSettings | None = None,
    directions: Array | None = None,
    coverage: CoverageSoFar | None = None,
) -> Inspection:
    """Lays a cloud on the part and compares.

    Args:
        points: Merged cloud, tracker frame, shape (n, 3) [m].
        mesh: The part, workpiece frame.
        segmentation: Its complex regions.
        T_tracker_workpiece: Coarse pose of the part, shape (4, 4) [m].
        settings: How.
        directions: Unit view directions of the points, tracker frame, shape (n, 3); None = sides
            are not told apart.
        coverage: An empty coverage to fill, for callers who want to know where; None = made here.

    Returns:
        What was measured; the deviations stand in the order of the points.

    Raises:
        NoCloudError: Too few points.
        AlignmentError: The cloud does not lie on the part.
        InputError: Shapes or values that can't be used.
    """
    settings = settings or InspectionSettings()
    cloud = checked_points(points)
    samples = coverage.samples if coverage is not None else sample_surface(mesh, settings.spacing_m)
    if coverage is None:
        coverage = coverage_so_far(samples, segmentation, settings.radius_m)
    index = SurfaceIndex(mesh, samples)
    alignment = register(cloud, index, T_tracker_workpiece, settings.registration)
    T_workpiece_tracker = inverse(alignment.T_tracker_workpiece)
    deviation = np.empty(len(cloud))
    figures = SurfaceFigures(samples, segmentation.face_region[samples.faces])

    def compared(part: slice) -> tuple[slice, Array, Closest]:
        local = apply(T_workpiece_tracker, cloud[part])
        return part, local, index.closest(local)

    parts = [slice(begin, begin + _BATCH) for begin in range(0, len(cloud), _BATCH)]
    for part, local, found in _two_at_once(compared, parts):
        deviation[part] = _signed(local, found, settings.deviation_max_m)
        figures.add(found.samples, deviation[part])
        coverage.add(
            local, None if directions is None else rotate(T_workpiece_tracker, directions[part])
        )
    on_part = deviation[np.isfinite(deviation)]
    if len(on_part) == 0:
        raise AlignmentError(
            "deviations were asked for; no point lies within "
            f"{settings.deviation_max_m * 1e3:.0f} mm of the surface"
        )
    return Inspection(
        alignment=alignment,
        points=len(cloud),
        deviation=deviation,
        deviation_rms_m=float(np.sqrt(np.mean(on_part**2))),
        area_ratio=coverage.area_ratio,
        feature_area_ratio=coverage.feature_area_ratio,
        surface=figures,
    )


def deviations(points: Array, index: SurfaceIndex, deviation_max_m: float = 0.02) -> Array:
    """Returns signed deviations along the surface normal, positive outside.

    Args:
        points: Workpiece frame, shape (n, 3) [m].
        index: The part's surface.
        deviation_max_m: Points farther away are none of the part's [m].

    Returns:
        shape (n,) [m]; NaN = on no surface: too far, or beyond the open border.
    """
    return _signed(points, index.closest(points), deviation_max_m)


def _signed(points: Array, found: Closest, deviation_max_m: float) -> Array:
    signed = found.signed(points)
    return np.where(found.on_border | (found.distance > deviation_max_m), np.nan, signed)


def _two_at_once(
    work: Callable[[slice], tuple[slice, Array, Closest]], parts: Sequence[slice]
) -> Iterator[tuple[slice, Array, Closest]]:
    """Does the work of two parts at a time and yields the results in order; memory is bounded."""
    with ThreadPoolExecutor(_WORKERS) as pool:
        waiting: deque[Future[tuple[slice, Array, Closest]]] = deque()
        for part in parts:
            waiting.append(pool.submit(work, part))
            if len(waiting) > _WORKERS:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
