"""The coverage of a scan path beside that of row cutting alone (Fig. 21 of M)."""

from dataclasses import dataclass
from functools import cached_property

from skinplan.mesh.model import Segmentation, SurfaceMesh
from skinplan.part.model import Fixture, ScanSettings
from skinplan.scan_path.model import ScanPath
from skinplan.scan_path.plan import rows_only_path
from skinplan.scanner.certifier import Certifier
from skinplan.scanner.coverage import coverage_figures
from skinplan.scanner.model import Coverage, CoverageFigures, ScannerModel
from skinplan.scanner.obstacles import fixture_obstacle


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a scan path will see, beside row cutting alone.

    Attributes:
        path: Certificate of the scan path.
        row_cutting: Certificate of row cutting over the whole part.
        motion: Certificate of the scan path with the motion between the points of each row.
        certifier: What certified them, for further views of the same part.
    """

    path: Coverage
    row_cutting: Coverage
    motion: Coverage
    certifier: Certifier

    @cached_property
    def figures(self) -> CoverageFigures:
        """The shares of both."""
        return coverage_figures(self.path, self.row_cutting)


def predict_coverage(
    mesh: SurfaceMesh,
    segmentation: Segmentation,
    path: ScanPath,
    settings: ScanSettings,
    fixture: Fixture | None = None,
) -> Prediction:
    """Says what of the part a scan path will see, and what row cutting alone would see.

    Args:
        mesh: The part.
        segmentation: Its complex regions.
        path: The scan path, in the frame of the mesh.
        settings: Scan settings of the part.
        fixture: The fixture, which may hide the part; None = the part alone.

    Returns:
        The certificates.

    Raises:
        ScanPathInvalidError: The path is not finite.
    """
    certifier = part_certifier(mesh, segmentation, settings, fixture)
    rows = rows_only_path(mesh, segmentation, settings)
    return Prediction(
        certifier.points(path), certifier.points(rows), certifier.motion(path), certifier
    )


def part_certifier(
    mesh: SurfaceMesh,
    segmentation: Segmentation,
    settings: ScanSettings,
    fixture: Fixture | None = None,
    spacing_m: float = 0.005,
    with_seeable: bool = True,
) -> Certifier:
    """Makes a certifier of a part from its settings.

    Args:
        mesh: The part.
        segmentation: Its complex regions.
        settings: Scanner, clearance and number of views asked for.
        fixture: The fixture, which may hide the part; None = the part alone.
        spacing_m: Distance between the surface samples [m].
        with_seeable: Whether to say what can be seen at all, too.

    Returns:
        The certifier; what can be seen at all is found when first asked for.
    """
    return Certifier(
        mesh,
        segmentation,
        ScannerModel.from_settings(settings),
        spacing_m,
        occluders=() if fixture is None else (fixture_obstacle(fixture),),
        least_views=settings.least_views,
        clearance_m=settings.clearance_m if with_seeable else None,
    )
