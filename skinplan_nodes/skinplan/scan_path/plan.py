"""Plans the scan path by a strategy chosen by name."""

from collections.abc import Callable

import numpy as np

from skinplan.errors import InputError, MeshEmptyError, MeshNotFiniteError
from skinplan.mesh.model import Segmentation, SurfaceMesh
from skinplan.part.inspection_points import InspectionPoints
from skinplan.part.model import ScanSettings
from skinplan.part.settings import check_settings
from skinplan.scan_path import published
from skinplan.scan_path.coverage import coverage_path
from skinplan.scan_path.model import ScanPath
from skinplan.scan_path.patches import patches_path
from skinplan.scan_path.points import points_path
from skinplan.strategies import chosen

Strategy = Callable[[SurfaceMesh, Segmentation, ScanSettings, InspectionPoints | None], ScanPath]


def _of_surface(
    plan: Callable[[SurfaceMesh, Segmentation, ScanSettings], ScanPath],
) -> Strategy:
    """A strategy that looks at the whole surface and asks for no points."""
    return lambda mesh, segmentation, settings, _: plan(mesh, segmentation, settings)


STRATEGIES: dict[str, Strategy] = {
    "coverage": _of_surface(coverage_path),
    "published": _of_surface(published.published_path),
    "patches": _of_surface(patches_path),
    "points": points_path,
}


def plan_scan_path(
    mesh: SurfaceMesh,
    segmentation: Segmentation,
    settings: ScanSettings,
    points: InspectionPoints | None = None,
) -> ScanPath:
    """Plans the scan path of a part.

    Args:
        mesh: A checked mesh, in the workpiece frame.
        segmentation: Its complex regions.
        settings: Scan settings; ``strategy`` names one of `STRATEGIES`.
        points: The part's measuring points, which strategy ``points`` looks at; None = it has none.

    Returns:
        The scan path in the workpiece frame.

    Raises:
        StrategyUnknownError: No strategy of that name.
        PartInvalidError: A setting out of range.
        InspectionPointsError: Strategy ``points``, and the part gives none.
        MeshError: Nothing that can be planned on.
    """
    strategy = chosen("scan path", settings.strategy, STRATEGIES)
    _check(mesh, segmentation)
    return strategy(mesh, segmentation, check_settings(settings), points)


def rows_only_path(
    mesh: SurfaceMesh, segmentation: Segmentation, settings: ScanSettings
) -> ScanPath:
    """Plans conventional row cutting over the whole part, to compare with (Fig. 21).

    Args:
        mesh: A checked mesh, in the workpiece frame.
        segmentation: Its complex regions.
        settings: Scan settings.

    Returns:
        Row points with one view direction, the mean inward normal of the part.

    Raises:
        PartInvalidError: A setting out of range.
        MeshError: Nothing that can be planned on.
    """
    _check(mesh, segmentation)
    return published.rows_only_path(mesh, segmentation, check_settings(settings))


def _check(mesh: SurfaceMesh, segmentation: Segmentation) -> None:
    if len(mesh.faces) == 0:
        raise MeshEmptyError("the mesh has no faces; a mesh with at least one face is accepted")
    if not np.isfinite(mesh.vertices).all():
        raise MeshNotFiniteError(
            "the mesh has vertices that are NaN or infinite; finite numbers are accepted"
        )
    if segmentation.face_region.shape != (len(mesh.faces),):
        raise InputError(
            f"a segmentation of the mesh's {len(mesh.faces)} faces is accepted, "
            f"found one of {len(segmentation.face_region)} faces"
        )
