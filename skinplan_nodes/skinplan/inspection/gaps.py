"""What of a part a cloud leaves out."""

from pathlib import Path

from skinplan.errors import CloudInvalidError
from skinplan.inspection.cloud import read_ply
from skinplan.inspection.coverage import CoverageSoFar
from skinplan.mesh.model import SurfaceMesh
from skinplan.scanner.model import SurfaceSamples
from skinplan.scanner.samples import sample_surface
from skinplan.transforms import Array

SPACING_M = 0.005


def seen_points(source: Path) -> Array:
    """Reads what a run has measured.

    Args:
        source: A cloud in the workpiece frame (PLY), or the folder of a run that holds
            ``cloud.ply``.

    Returns:
        The points, workpiece frame, shape (n, 3) [m].

    Raises:
        CloudInvalidError: No such cloud, or one in another frame.
    """
    file = source / "cloud.ply" if source.is_dir() else source
    cloud = read_ply(file)
    if cloud.frame not in ("", "workpiece"):
        raise CloudInvalidError(
            f"{file}: the cloud is in the frame {cloud.frame!r}; one in the frame workpiece is "
            "accepted, as a run that has aligned its data writes it"
        )
    return cloud.points


def missing_samples(
    mesh: SurfaceMesh, cloud: Array, spacing_m: float = SPACING_M
) -> SurfaceSamples:
    """Finds the samples of a part that have no measured point near them.

    Args:
        mesh: The part.
        cloud: Measured points, workpiece frame, shape (n, 3) [m]; none = all is missing.
        spacing_m: Distance between the samples [m].

    Returns:
        The samples left out.

    Raises:
        InputError: Points that are not finite, or not of shape (n, 3).
    """
    seen = CoverageSoFar(sample_surface(mesh, spacing_m))
    seen.add(cloud)
    left, samples = ~seen.measured, seen.samples
    return SurfaceSamples(
        samples.points[left], samples.normals[left], samples.faces[left], samples.weights[left]
    )
