"""Writes what an inspection found beside each other: the cloud, and which samples were measured."""

from pathlib import Path

from skinplan.inspection.cloud import write_ply
from skinplan.inspection.coverage import CoverageSoFar
from skinplan.inspection.model import Inspection
from skinplan.transforms import Array, apply, inverse

COVERAGE_NAME = "coverage.ply"


def write_results(
    cloud_path: Path,
    points: Array,
    inspection: Inspection,
    coverage: CoverageSoFar | None = None,
    intensity: Array | None = None,
) -> None:
    """Writes the cloud in the workpiece frame with its deviations, and ``coverage.ply`` beside it.

    Args:
        cloud_path: The PLY file of the cloud.
        points: The inspected points, tracker frame, shape (n, 3) [m].
        inspection: Their inspection.
        coverage: Filled by the inspection; None = no ``coverage.ply``.
        intensity: shape (n,); None = not known.

    Raises:
        CloudInvalidError: Shapes that do not fit, or a file that can't be written.
    """
    local = apply(inverse(inspection.alignment.T_tracker_workpiece), points)
    values = {"deviation": inspection.deviation}
    if intensity is not None:
        values["intensity"] = intensity
    write_ply(cloud_path, local, "workpiece", values)
    if coverage is not None:
        measured = {"measured": coverage.measured.astype(float)}
        write_ply(
            cloud_path.with_name(COVERAGE_NAME), coverage.samples.points, "workpiece", measured
        )
