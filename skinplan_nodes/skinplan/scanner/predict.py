"""The coverage of a scan path beside that of row cutting alone (Fig. 21 of M)."""

from skinplan.mesh.model import Segmentation, SurfaceMesh
from skinplan.part.model import ScanSettings
from skinplan.scan_path.model import ScanPath
from skinplan.scan_path.plan import rows_only_path
from skinplan.scanner.coverage import certify, coverage_figures
from skinplan.scanner.model import CoverageFigures, ScannerModel
from skinplan.scanner.rays import RayCaster


def predict_coverage(
    mesh: SurfaceMesh, segmentation: Segmentation, path: ScanPath, settings: ScanSettings
) -> CoverageFigures:
    """Says what share of the part a scan path will see, and what row cutting alone would see.

    Args:
        mesh: The part.
        segmentation: Its complex regions.
        path: The scan path, in the frame of the mesh.
        settings: Scan settings of the part.

    Returns:
        The shares.

    Raises:
        ScanPathInvalidError: The path is not finite.
    """
    scanner, caster = ScannerModel.from_settings(settings), RayCaster(mesh)
    rows = rows_only_path(mesh, segmentation, settings)
    return coverage_figures(
        certify(mesh, segmentation, path, scanner, caster=caster),
        certify(mesh, segmentation, rows, scanner, caster=caster),
    )
