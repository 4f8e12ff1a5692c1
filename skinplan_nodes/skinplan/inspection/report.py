"""Writes ``report.html`` of a run.

One file without external resources, light and dark, for screen, phone and paper.
"""

import json
import math
from collections import Counter
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from skinplan.errors import InputError
from skinplan.inspection.complete import complete_run
from skinplan.inspection.figures import (
    coverage_figure,
    deviation_figure,
    floor_figure,
    front_view,
    histogram_figure,
)
from skinplan.inspection.report_head import (
    alignment_facts,
    calibration,
    characteristic_rows,
    first_tiles,
    identification,
    missing_rows,
    region_rows,
)
from skinplan.inspection.report_times import bars
from skinplan.inspection.run_files import RunFiles, items, number, read_run, section
from skinplan.inspection.verdict import verdict
from skinplan.inspection.wording import count, degrees, millimetres, percent, plain, seconds
from skinplan.whole_file import whole_file

_MOST_ROWS = 500
_SHOWN_APART = {
    "job",
    "measured",
    "localization",
    "planning_s",
    "trajectory",
    "bag",
    "inspection",
    "calibration",
    "identification",
    "files",
    "timeline",
}


def write_report(run_folder: Path | str) -> Path:
    """Writes the report of a run from its files.

    A run that failed half way gets one of what is there.

    Args:
        run_folder: Folder of the run.

    Returns:
        Path of ``report.html``.

    Raises:
        InputError: There is no such folder, or it can't be written to.
    """
    folder = Path(run_folder).absolute()
    if not folder.is_dir():
        raise InputError(
            f"a report of {folder} was asked for; the folder of a run is accepted, there is none"
        )
    complete_run(folder)
    text = render(read_run(folder))
    path = folder / "report.html"
    try:
        with whole_file(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(
            f"{path}: the report can't be written ({error.strerror or error})"
        ) from error
    return path


def render(files: RunFiles) -> str:
    """Returns the report's HTML."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("skinplan.inspection", "."),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    return environment.get_template("report.html.j2").render(**_context(files))


def _context(files: RunFiles) -> dict[str, Any]:
    job = section(files.summary, "job")
    view = front_view(files)
    deviation = files.cloud.values.get("deviation") if files.cloud is not None else None
    return {
        "name": str(job.get("id") or files.folder.name),
        "verdict": verdict(files),
        "remarks": files.remarks,
        "facts_first": _facts_first(job, files),
        "first_tiles": first_tiles(files) if "inspection" in files.summary else [],
        "calibration": calibration(files),
        "identification": identification(files),
        "has_job": bool(job),
        "regions": region_rows(files),
        "characteristics": characteristic_rows(files),
        "missing": missing_rows(files),
        "alignment": alignment_facts(files),
        "tiles": _tiles(files, deviation),
        "deviation": deviation_figure(files, view) if view else None,
        "histogram": histogram_figure(deviation) if deviation is not None else None,
        "coverage": coverage_figure(files, view) if view else None,
        "has_samples": files.coverage is not None,
        "has_cloud": files.cloud is not None,
        "has_path": bool(files.path),
        "floor": floor_figure(files),
        "localization": [_localization(row) for row in items(files.summary, "localization")],
        "bars": bars(files),
        "stations": _stations(files),
        "skipped": _skipped(files),
        "job": _facts(job),
        "facts": _other_facts(files.summary),
        "bag": _bag(files),
        "hashes": _hashes(files),
        "raw": json.dumps(files.summary, indent=1, ensure_ascii=False) if files.summary else "",
        "links": [
            n
            for n in (
                "summary.json",
                "results.qif",
                "deviation.csv",
                "cloud.ply",
                "cloud.laz",
                "plan",
                "bag",
                "log",
            )
            if (files.folder / n).exists()
        ],
    }


def _facts_first(job: dict[str, Any], files: RunFiles) -> list[tuple[str, str]]:
    """Whose measurement it is."""
    found = section(files.summary, "inspection")
    named = (
        ("part", job.get("part")),
        ("serial number", job.get("serial_number")),
        ("order", job.get("order_id")),
        ("operator", job.get("operator_name")),
        ("inspected", str(found.get("made_at") or "").replace("T", " ").replace("Z", " UTC")),
    )
    return [(key, str(value)) for key, value in named if value]


def _hashes(files: RunFiles) -> list[tuple[str, str, str]]:
    """Name, size and hash of the result files."""
    listed = section(files.summary, "files")
    rows = ((name, section(listed, name)) for name in listed)
    return [
        (name, f"{number(facts.get('bytes')) / 1e6:,.2f} MB", str(facts.get("sha256")))
        for name, facts in rows
        if facts
    ]


def _tiles(files: RunFiles, deviation: Any) -> list[tuple[str, str, str]]:
    """The figures that a reader looks for first: title, value, remark."""
    measured, trajectory = section(files.summary, "measured"), section(files.summary, "trajectory")
    stations, predicted = section(files.summary, "stations"), section(files.summary, "coverage")
    known = deviation[np.isfinite(deviation)] if deviation is not None else np.zeros(0)
    qualities = [number(row.get("E")) for row in items(files.summary, "localization")]
    worst = float(known[np.argmax(np.abs(known))]) if len(known) else math.nan
    tail = float(np.percentile(np.abs(known), 99.9)) if len(known) else math.nan
    bound = number(stations.get("lower_bound"))
    return [
        (
            "area measured",
            percent(measured.get("area_ratio")),
            f"planned {percent(predicted.get('area_ratio'))}",
        ),
        (
            "complex regions measured",
            percent(measured.get("feature_area_ratio")),
            f"planned {percent(predicted.get('feature_area_ratio'))}",
        ),
        (
            "deviation RMS",
            millimetres(measured.get("deviation_rms_m")),
            "along the normal, after alignment",
        ),
        (
            "largest deviation",
            millimetres(worst, sign=True),
            f"99.9 % of the points below {millimetres(tail)}",
        ),
        (
            "cycle time",
            seconds(trajectory.get("cycle_s")),
            f"scanning {seconds(trajectory.get('scan_s'))}",
        ),
        (
            "stations",
            count(stations.get("count")),
            f"lower bound {count(bound if bound > 0 else None)}",
        ),
        ("points", count(measured.get("points")), "of the merged cloud"),
        (
            "worst marker view E",
            plain(min(qualities, default=math.nan)),
            f"{len(qualities)} localisations",
        ),
    ]


def _localization(row: dict[str, Any]) -> list[str]:
    return [
        plain(row.get("station")),
        plain(row.get("E")),
        count(row.get("attempts")),
        millimetres(row.get("position_error_m"), 2),
        degrees(row.get("angle_error_rad")),
    ]


def _stations(files: RunFiles) -> list[list[str]]:
    timed = {row.get("station"): row for row in items(files.trajectories, "stations")}
    rows = []
    for station in items(files.stations, "stations"):
        pose, points = section(station, "pose"), station.get("points")
        segments = items(timed.get(station.get("id"), {}), "segments")
        scans = [s for s in segments if s.get("kind") == "scan"]
        rows.append(
            [
                plain(station.get("id")),
                f"{plain(pose.get('x_m'))}, {plain(pose.get('y_m'))}",
                degrees(pose.get("heading_rad"), 1),
                count(len(points) if isinstance(points, list) else None),
                seconds(sum(number(s.get("duration_s")) for s in scans) if scans else None),
                count(len(scans) if segments else None),
            ]
        )
    return rows


def _skipped(files: RunFiles) -> dict[str, Any]:
    listed = items(section(files.summary, "trajectory"), "skipped")
    if not listed:
        listed = items(files.stations, "skipped")
        listed += [
            s for row in items(files.trajectories, "stations") for s in items(row, "skipped")
        ]
    reasons = Counter(str(entry.get("reason") or "no reason given") for entry in listed)
    return {
        "count": len(listed),
        "reasons": reasons.most_common(),
        "rows": [(plain(e.get("point")), str(e.get("reason") or "")) for e in listed[:_MOST_ROWS]],
        "cut": max(0, len(listed) - _MOST_ROWS),
    }


def _bag(files: RunFiles) -> dict[str, Any] | None:
    if files.bag is None:
        return None
    listed = section(files.summary, "bag")
    return {
        "facts": [
            ("messages", count(files.bag.messages)),
            ("size", f"{files.bag.bytes / 1e6:,.1f} MB"),
            ("duration", seconds(files.bag.duration_s)),
            (
                "closed in order",
                "yes" if files.bag.complete else "no: what follows the last complete chunk is lost",
            ),
        ],
        "topics": [(t.name, t.type_name, count(t.messages)) for t in files.bag.topics],
        "differs": "messages" in listed and listed.get("messages") != files.bag.messages,
    }


def _other_facts(summary: dict[str, Any]) -> list[tuple[str, list[tuple[str, str]]]]:
    """All further figures: hashes, versions, and whatever later versions add to the summary."""
    groups = []
    single = [
        (key, plain(value)) for key, value in summary.items() if not isinstance(value, dict | list)
    ]
    if single:
        groups.append(("run", single))
    for key, value in summary.items():
        if isinstance(value, dict) and key not in _SHOWN_APART:
            groups.append((key.replace("_", " "), _facts(value)))
    return groups


def _facts(document: dict[str, Any]) -> list[tuple[str, str]]:
    facts = []
    for key, value in document.items():
        shown = (
            json.dumps(value, ensure_ascii=False)
            if isinstance(value, dict | list)
            else plain(value)
        )
        facts.append((key.replace("_", " "), shown))
    return facts
