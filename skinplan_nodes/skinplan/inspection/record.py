"""``inspection.json``: what was measured, as a document. All numbers in SI, workpiece frame."""

import math
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import CloudInvalidError
from skinplan.inspection.characteristics import Result, evaluate
from skinplan.inspection.model import Alignment, Inspection
from skinplan.inspection.surface import SurfaceFigures
from skinplan.json_file import write_json
from skinplan.part.inspection_plan import InspectionPlan
from skinplan.part.inspection_points import InspectionPoints
from skinplan.transforms import quaternion
from skinplan.whole_file import whole_file

#: Version of the documents ``inspection.json`` and ``summary.json``: the first number changes when
#: a reader of the old ones would go wrong.
VERSION = "1.0"
NAME, CSV_NAME = "inspection.json", "deviation.csv"
_MOST_AREAS = 50
PASS, FAIL, NOT_JUDGED = "pass", "fail", "not_judged"
_CSV = "x_m,y_m,z_m,nx,ny,nz,area_m2,region,measured,points,deviation_m,sigma_m,min_m,max_m"


def inspection_document(
    inspection: Inspection,
    measured: NDArray[np.bool_],
    plan: InspectionPlan,
    points: InspectionPoints | None = None,
) -> dict[str, Any]:
    """Returns what was measured and how it stands against the part file.

    Args:
        inspection: With its surface figures.
        measured: Which samples count as measured, shape (s,).
        plan: Tolerances and characteristics.
        points: Measuring points; None = the part has none.
    """
    figures = inspection.surface
    assert figures is not None
    results = evaluate(plan.characteristics, figures, points)
    regions = [asdict(region) for region in figures.regions(measured, plan.deviation_max_m)]
    missing = figures.missing(measured)
    area = float(sum(each.area_m2 for each in missing))
    return {
        "version": VERSION,
        "made_at": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "frame": "workpiece",
        "verdict": verdict_document(regions[0], plan, results),
        "tolerance": {
            "deviation_max_m": plan.deviation_max_m,
            "area_ratio_min": plan.area_ratio_min,
        },
        "alignment": alignment_document(inspection.alignment),
        "points": inspection.points,
        "points_on_part": int(np.count_nonzero(np.isfinite(inspection.deviation))),
        "deviation_rms_m": inspection.deviation_rms_m,
        "whole": regions[0],
        "regions": regions[1:],
        "missing": {
            "area_m2": area,
            "count": len(missing),
            "areas": [asdict(each) for each in missing[:_MOST_AREAS]],
        },
        "characteristics": [asdict(result) for result in results],
    }


def verdict_document(
    whole: dict[str, Any], plan: InspectionPlan, results: tuple[Result, ...]
) -> dict[str, Any]:
    """Returns ``pass``, ``fail`` or ``not_judged`` with the reasons."""
    reasons, judged = [], False
    worst, ratio = float(whole["worst_m"]), float(whole["area_ratio"])
    if math.isfinite(plan.deviation_max_m):
        judged = True
        if not abs(worst) <= plan.deviation_max_m:
            reasons.append(
                f"The worst deviation is {worst * 1e3:+.3f} mm; up to "
                f"{plan.deviation_max_m * 1e3:.3f} mm are accepted."
            )
    for result in results:
        judged = True
        if result.state == FAIL:
            reasons.append(f"{result.id} is out of tolerance.")
        elif result.state != PASS:
            reasons.append(f"{result.id} was not measured: {result.reason}.")
    if judged and not ratio >= plan.area_ratio_min:
        reasons.append(
            f"{100 * ratio:.1f} % of the area was measured; at least "
            f"{100 * plan.area_ratio_min:.1f} % are accepted."
        )
    state = NOT_JUDGED if not judged else FAIL if reasons else PASS
    if not judged:
        reasons.append("The part file states no tolerance.")
    return {"state": state, "reasons": reasons}


def alignment_document(alignment: Alignment) -> dict[str, Any]:
    """Returns where the part stands in the tracker frame, and how well that is known."""
    T = alignment.T_tracker_workpiece
    return {
        "position_m": T[:3, 3],
        "quaternion_xyzw": quaternion(T),
        "rms_m": alignment.rms_m,
        "used_ratio": alignment.used_ratio,
        "iterations": alignment.iterations,
        "converged": alignment.converged,
        "position_sigma_m": alignment.position_sigma_m,
        "angle_sigma_rad": alignment.angle_sigma_rad,
        "covariance": alignment.covariance,
        "middle_m": alignment.middle,
        "condition": alignment.condition,
        "by_border": alignment.by_border,
        "undetermined": [
            {"motion": each.text, "turn_rad_per_m": each.turn, "shift": each.shift}
            for each in alignment.undetermined
        ],
    }


def write_inspection(folder: Path, document: dict[str, Any]) -> None:
    """Writes ``inspection.json`` in one step.

    Raises:
        CloudInvalidError: It can't be written.
    """
    try:
        write_json(folder / NAME, document)
    except OSError as error:
        raise CloudInvalidError(
            f"{folder / NAME}: it can't be written ({error.strerror or error})"
        ) from error


def write_deviation_csv(path: Path, figures: SurfaceFigures, measured: NDArray[np.bool_]) -> None:
    """Writes one line for each piece of the surface: place, normal, area, figures; SI.

    Raises:
        CloudInvalidError: It can't be written.
    """
    samples = figures.samples
    columns = np.column_stack(
        [
            samples.points,
            samples.normals,
            samples.weights,
            figures.region,
            measured,
            figures.count,
            figures.local,
            figures.sigma,
            figures.low,
            figures.high,
        ]
    )
    form = ["%.6f"] * 6 + ["%.9f", "%d", "%d", "%d"] + ["%.7f"] * 4
    try:
        with whole_file(path) as temporary, temporary.open("w", encoding="ascii") as stream:
            np.savetxt(stream, columns, form, ",", header=_CSV, comments="")
    except OSError as error:
        raise CloudInvalidError(
            f"{path}: it can't be written ({error.strerror or error})"
        ) from error
