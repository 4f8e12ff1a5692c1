"""By how many views each place of a part is seen, for pictures: coarser than the certificate."""

import numpy as np
from numpy.typing import NDArray

from skinplan.mesh.model import SurfaceMesh
from skinplan.part.model import ScanSettings
from skinplan.scan_path.model import ScanPath
from skinplan.scanner.model import ScannerModel
from skinplan.scanner.rays import RayCaster
from skinplan.scanner.samples import sample_surface
from skinplan.scanner.tally import Tally
from skinplan.scanner.views import checked_views
from skinplan.transforms import Array


def seen_places(
    mesh: SurfaceMesh, path: ScanPath, settings: ScanSettings, spacing_m: float
) -> tuple[Array, NDArray[np.int64]]:
    """Returns places of the surface and how many points of the path see each.

    Args:
        mesh: The part.
        path: The scan path, in the frame of the mesh.
        settings: Scan settings of the part.
        spacing_m: Distance between the places [m].

    Returns:
        Places, shape (s, 3) [m], and views, shape (s,).

    Raises:
        ScanPathInvalidError: The path is not finite, or a direction is no unit vector.
    """
    samples = sample_surface(mesh, spacing_m)
    tally = Tally(samples, RayCaster(mesh), ScannerModel.from_settings(settings))
    tally.add(*checked_views(path.positions, path.directions))
    return samples.points, tally.views
