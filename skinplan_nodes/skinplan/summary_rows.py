"""Plans and runs as tables for a person; what the document does not have is left out."""

from collections.abc import Mapping
from typing import Any

Rows = list[tuple[Any, ...]]


def plan_rows(summary: Mapping[str, Any]) -> Rows:
    """Returns name and value of what a person asks of a plan's summary."""
    path = summary["scan_path"]
    rows: Rows = [("points", _points(path))]
    if path["left_out"]:
        rows.append(("poses left out", path["left_out"]))
    if passes := path.get("passes"):
        rows.append(
            (
                "passes improved",
                f"{passes['improved']} of {passes['count']}, mean error "
                f"{passes['error_before']:.4f} to {passes['error_after']:.4f}",
            )
        )
    if coverage := summary.get("coverage"):
        rows += _coverage_rows(coverage)
    if stations := summary.get("stations"):
        rows += [
            ("stations", _stations(stations)),
            ("points reached", _percent(stations["reached_ratio"])),
        ]
        if stations.get("robust_ratio") is not None:
            rows.append(("… beside the goal, too", _percent(stations["robust_ratio"])))
        if stations.get("tracker"):
            place = ", ".join(f"{value:.2f}" for value in stations["tracker"]["position_m"])
            rows.append(("tracker at", f"{place} m"))
    if motion := summary.get("trajectory"):
        rows += [
            ("cycle time", f"{motion['cycle_s']:.0f} s (scan {motion['scan_s']:.0f} s)"),
            ("breaks of the scan", motion["breaks"]),
            ("points skipped", len(motion["skipped"])),
        ]
        if timed := motion.get("coverage"):
            rows += [
                ("certified on the motion", _percent(timed["area_ratio"])),
                ("… of the features", _percent(timed["feature_area_ratio"])),
            ]
    rows.append(("planned in", f"{summary['planning_s']['total']:.1f} s"))
    rows.append(("plan hash", summary.get("plan_hash", path["hash"])[:16]))
    return rows


def run_rows(document: Mapping[str, Any]) -> Rows:
    """Returns name and value of what a person asks of a run's summary."""
    measured = document.get("measured") or {}
    localization = document.get("localization") or []
    return [
        ("job", f"{document['job']['id']}: {document['job']['state']}"),
        ("stations", (document.get("stations") or {}).get("count", "none")),
        ("quality E", ", ".join(f"{entry['E']:.2f}" for entry in localization if entry.get("E"))),
        ("area measured", _percent(measured.get("area_ratio"))),
        ("… of the features", _percent(measured.get("feature_area_ratio"))),
        ("deviation (rms)", _millimetres(measured.get("deviation_rms_m"))),
        ("folder", document.get("folder") or "none"),
    ]


def _points(path: Mapping[str, Any]) -> str:
    text = (
        f"{path['points']} ({path['row_points']} on rows, {path['feature_points']} single views)"
        if path["strategy"] != "published"
        else f"{path['points']} ({path['row_points']} on rows, "
        f"{path['feature_points']} on features)"
    )
    bound = path["lower_bound"]
    return f"{text}, at least {bound} are needed" if bound else text


def _coverage_rows(coverage: Mapping[str, Any]) -> Rows:
    rows: Rows = [
        ("predicted coverage", _percent(coverage["area_ratio"])),
        ("… of the features", _percent(coverage["feature_area_ratio"])),
    ]
    if coverage.get("least_views"):
        often = _percent(coverage["often_seen_area_ratio"])
        rows.append((f"… seen {coverage['least_views']} times", often))
        rows.append(("can be seen at all", _percent(coverage["seeable_area_ratio"])))
    return rows


def _stations(stations: Mapping[str, Any]) -> str:
    text = f"{stations['count']} of {stations['candidates']} candidates"
    if stations["proven_optimal"]:
        return f"{text}, proven minimal"
    bound = stations["lower_bound"]
    return f"{text}, at least {bound} are needed" if bound else text


def _percent(ratio: float | None) -> str:
    return "none" if ratio is None else f"{100 * ratio:.2f} %"


def _millimetres(length_m: float | None) -> str:
    return "none" if length_m is None else f"{1000 * length_m:.3f} mm"
