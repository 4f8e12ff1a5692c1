"""Plans only what a run did not see."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skinplan.errors import NothingMissingError
from skinplan.mesh.model import Segmentation, SurfaceMesh
from skinplan.mesh.topology import components
from skinplan.part.model import ScanSettings
from skinplan.part.settings import check_settings
from skinplan.scan_path.coverage import CoveragePlanner
from skinplan.scan_path.model import ScanPath
from skinplan.scan_path.view_choice import some_of
from skinplan.scanner.model import ScannerModel, SurfaceSamples
from skinplan.scanner.rays import RayCaster
from skinplan.scanner.seeable import seeable

LEAST_GAP_M2 = 1e-4
# Samples of one gap are at most so many sample spacings apart.
_JOINED_RATIO = 2.0


def rescan_path(
    mesh: SurfaceMesh,
    segmentation: Segmentation,
    settings: ScanSettings,
    missing: SurfaceSamples,
    least_gap_m2: float = LEAST_GAP_M2,
) -> ScanPath:
    """Plans the fewest poses that see what is missing, whatever the strategy of the first path.

    Args:
        mesh: A checked mesh, in the workpiece frame.
        segmentation: Its complex regions.
        settings: Scan settings.
        missing: Samples of the mesh that have not been seen, for example those of a `Coverage`
            with no views, or those that a cloud leaves out
            (`skinplan.inspection.gaps.missing_samples`).
        least_gap_m2: Smaller gaps are left as they are [m^2].

    Returns:
        The path, its strategy named ``rescan``.

    Raises:
        NothingMissingError: No gap is that large, or none can be seen at all.
        MeshError: Nothing that can be planned on.
        PartInvalidError: A setting out of range.
    """
    settings = check_settings(settings)
    wanted = some_of(missing, _in_gaps(missing, least_gap_m2))
    if not len(wanted.points):
        raise NothingMissingError(
            f"a re-scan was asked for; of {missing.weights.sum() * 1e4:.1f} cm2 that were not seen "
            f"no gap has {least_gap_m2 * 1e4:g} cm2: nothing is to be scanned again"
        )
    caster = RayCaster(mesh)
    can = seeable(mesh, wanted, ScannerModel.from_settings(settings), settings.clearance_m, caster)
    if not can.any():
        raise NothingMissingError(
            f"a re-scan was asked for; none of the {wanted.weights.sum() * 1e4:.1f} cm2 that were "
            "not seen can be seen from outside with this scanner"
        )
    wanted = some_of(wanted, can)
    path = CoveragePlanner(mesh, segmentation, settings).path(wanted, wanted)
    return replace(path, strategy="rescan")


def _in_gaps(missing: SurfaceSamples, least_m2: float) -> NDArray[np.bool_]:
    """Says which samples hang together to gaps that are large enough, shape (s,)."""
    if not len(missing.points):
        return np.zeros(0, dtype=bool)
    spacing = float(np.sqrt(missing.weights.max()))
    pairs = cKDTree(missing.points).query_pairs(_JOINED_RATIO * spacing, output_type="ndarray")
    found, labels = components(len(missing.points), pairs)
    areas = np.bincount(labels, weights=missing.weights, minlength=found)
    return (areas >= least_m2)[labels]
