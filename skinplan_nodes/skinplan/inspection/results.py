"""Writes what an inspection found beside each other: clouds, table, document."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from skinplan.inspection.cloud import write_ply
from skinplan.inspection.coverage import CoverageSoFar
from skinplan.inspection.laz import write_laz
from skinplan.inspection.model import Inspection
from skinplan.inspection.record import (
    CSV_NAME,
    inspection_document,
    write_deviation_csv,
    write_inspection,
)
from skinplan.part.inspection_plan import InspectionPlan
from skinplan.part.inspection_points import InspectionPoints
from skinplan.transforms import Array, apply, inverse

COVERAGE_NAME = "coverage.ply"


def write_results(
    cloud_path: Path,
    points: Array,
    inspection: Inspection,
    coverage: CoverageSoFar | None = None,
    values: Mapping[str, Array] | None = None,
    plan: InspectionPlan | None = None,
    asked_points: InspectionPoints | None = None,
    final: bool = True,
) -> None:
    """Writes the cloud in the workpiece frame with its deviations, and what is known beside it.

    Beside the PLY file of the cloud: the same as LAZ; ``coverage.ply`` (surface samples with
    ``measured`` and local ``deviation``), ``deviation.csv`` and ``inspection.json``.

    Args:
        cloud_path: The PLY file of the cloud.
        points: The inspected points, tracker frame, shape (n, 3) [m].
        inspection: Their inspection.
        coverage: Filled by the inspection; None = only the cloud is written.
        values: Further values of the points (``intensity``), each shape (n,); None = none.
        plan: What the part is judged by; None = nothing.
        asked_points: The part's measuring points; None = it has none.
        final: Also write the LAZ file.

    Raises:
        CloudInvalidError: Shapes that do not fit, or a file that can't be written.
    """
    local = apply(inverse(inspection.alignment.T_tracker_workpiece), points)
    named = {"deviation": inspection.deviation, **(values or {})}
    write_ply(cloud_path, local, "workpiece", named)
    if final:
        write_laz(cloud_path.with_suffix(".laz"), local, named)
    if coverage is None:
        return
    folder, figures = cloud_path.parent, inspection.surface
    surface = {"measured": coverage.measured.astype(float)}
    if figures is not None:
        surface |= {"deviation": figures.local, "points": figures.count.astype(float)}
    write_ply(folder / COVERAGE_NAME, coverage.samples.points, "workpiece", surface)
    if figures is not None:
        write_deviation_csv(folder / CSV_NAME, figures, np.asarray(coverage.measured))
        document = inspection_document(
            inspection, coverage.measured, plan or InspectionPlan(), asked_points
        )
        write_inspection(folder, document)
