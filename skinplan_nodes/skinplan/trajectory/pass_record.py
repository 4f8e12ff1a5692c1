"""What the optimisation of the passes did, as it stands in a plan's documents."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from skinplan.scan_path.model import FEATURE, PassReport


def passes_summary(reports: Sequence[PassReport]) -> dict[str, Any]:
    """Returns key ``passes`` of a summary, errors as means over all points; {} without reports."""
    if not reports:
        return {}
    points = [report.points for report in reports]
    before = [report.error_before for report in reports]
    after = [report.error_after for report in reports]
    return {
        "passes": {
            "count": len(reports),
            "improved": sum(report.improved for report in reports),
            "error_before": float(np.average(before, weights=points)),
            "error_after": float(np.average(after, weights=points)),
        }
    }


def passes_document(reports: Sequence[PassReport]) -> dict[str, Any]:
    """Returns key ``passes`` of the path document, pass by pass; {} without reports."""
    if not reports:
        return {}
    return {
        "passes": [
            {**asdict(report), "kind": "feature" if report.kind == FEATURE else "row"}
            for report in reports
        ]
    }
