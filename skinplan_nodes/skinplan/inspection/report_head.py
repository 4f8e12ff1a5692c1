"""What a reader of a report looks for first: worst deviation, missing area, calibration facts."""

import math
from typing import Any

from skinplan.inspection.run_files import RunFiles, items, number, section
from skinplan.inspection.wording import count, degrees, millimetres, percent, place, plain

Tile = tuple[str, str, str, str]
_STATES = {"valid": "good", "due": "bad", "missing": "warn"}
_STATE_NAMES = {"valid": "valid", "due": "out of date", "missing": "missing"}


def first_tiles(files: RunFiles) -> list[Tile]:
    """Returns title, value, remark and level (empty = neither good nor bad) of the main figures."""
    measured = section(files.summary, "measured")
    found = section(files.summary, "inspection")
    return [_worst(found), _missing(found), _area(files, measured, found), _alignment(found)]


def calibration(files: RunFiles) -> list[dict[str, str]]:
    """Returns the calibration facts as texts: name, state, level, date, due, residual, file."""
    found = []
    for fact in items(files.summary, "calibration"):
        state = str(fact.get("state"))
        residual = number(fact.get("residual"))
        unit = str(fact.get("unit") or "")
        if unit == "m":
            shown = millimetres(residual)
        elif unit == "rad":
            shown = degrees(residual)
        else:
            shown = f"{plain(fact.get('residual'))} {unit}".strip()
        found.append(
            {
                "name": str(fact.get("name")).replace("_", " "),
                "state": _STATE_NAMES.get(state, state),
                "level": _STATES.get(state, "warn"),
                "date": _day(fact.get("date")),
                "due": _day(fact.get("due")),
                "residual": shown,
                "file": str(fact.get("file") or "").rsplit("/", 1)[-1],
            }
        )
    return found


def identification(files: RunFiles) -> dict[str, str] | None:
    """Returns which part stands on the fixture, as texts; None = that was not asked.

    Keys: the part that was asked for, the answer and its level, the share of the part that was
    seen, and the answer as the recogniser gave it.
    """
    found = section(files.summary, "identification")
    if not found:
        return None
    listed = found.get("alike")
    alike = " or ".join(str(name) for name in listed) if isinstance(listed, list) else ""
    if found.get("fits") is True:
        level = "warn" if alike else "good"
        state = f"fits, but it may be {alike} as well" if alike else "it is this part"
    elif not isinstance(found.get("fits"), bool):
        level, state = "warn", "the answer can't be read"
    else:
        level = "bad"
        state = f"it is another part: {alike}" if alike else "it is another, unknown part"
    return {
        "part": plain(found.get("part")),
        "state": state,
        "level": level,
        "seen": percent(found.get("seen_ratio")),
        "text": str(found.get("text") or ""),
    }


def region_rows(files: RunFiles) -> list[list[str]]:
    """Returns a row of figures for the whole part and each region."""
    found = section(files.summary, "inspection")
    whole = section(found, "whole")
    rows = [("whole part", whole)] if whole else []
    for region in items(found, "regions"):
        number_ = region.get("region")
        name = "beside the regions" if number_ == 0 else f"region {plain(number_)}"
        rows.append((name, region))
    return [[name, *_figures(region)] for name, region in rows]


def characteristic_rows(files: RunFiles) -> list[dict[str, str]]:
    """Returns what the part file asks for, as texts."""
    found = []
    for row in items(section(files.summary, "inspection"), "characteristics"):
        state = str(row.get("state"))
        found.append(
            {
                "id": str(row.get("id")),
                "kind": str(row.get("kind")).replace("_", " "),
                "asked": _asked(row),
                "value": millimetres(row.get("value_m"), 4),
                "state": state.replace("_", " "),
                "level": {"pass": "good", "fail": "bad"}.get(state, "warn"),
                "reason": str(row.get("reason") or ""),
            }
        )
    return found


def missing_rows(files: RunFiles) -> list[list[str]]:
    """Returns the missing areas: size, share of the part, where, extent."""
    found = section(files.summary, "inspection")
    whole = number(section(found, "whole").get("area_m2"))
    rows = []
    for area in items(section(found, "missing"), "areas")[:10]:
        size = number(area.get("area_m2"))
        rows.append(
            [
                _square(size),
                percent(size / whole if whole > 0.0 else None),
                place(area.get("centre")),
                place(area.get("size")),
            ]
        )
    return rows


def alignment_facts(files: RunFiles) -> list[tuple[str, str]]:
    """Returns how the cloud was laid on the part, as key and value."""
    found = section(section(files.summary, "inspection"), "alignment")
    if not found:
        return []
    undetermined = [str(entry.get("motion")) for entry in items(found, "undetermined")]
    angle = degrees(found.get("angle_sigma_rad"), 4)
    return [
        ("residual", millimetres(found.get("rms_m"), 4)),
        ("position known to", f"{millimetres(found.get('position_sigma_m'), 4)} (1 sigma)"),
        ("orientation known to", f"{angle} (1 sigma)"),
        ("undetermined", "; ".join(undetermined) or "nothing"),
        ("by", "surface and border" if found.get("by_border") else "surface"),
        ("points used", percent(found.get("used_ratio"))),
        ("condition", f"{number(found.get('condition')):.3g}"),
        ("converged", f"{plain(found.get('converged'))}, {count(found.get('iterations'))} steps"),
    ]


def _worst(found: dict[str, Any]) -> Tile:
    whole, tolerance = section(found, "whole"), section(found, "tolerance")
    worst, limit = number(whole.get("worst_m")), number(tolerance.get("deviation_max_m"))
    remark = f"at {place(whole.get('worst_at'))}"
    level = ""
    if math.isfinite(limit):
        level = "good" if abs(worst) <= limit else "bad"
        remark = f"tolerance ±{millimetres(limit)}, {remark}"
    return "worst deviation", millimetres(worst, sign=True), remark, level


def _missing(found: dict[str, Any]) -> Tile:
    missing = section(found, "missing")
    areas = items(missing, "areas")
    size = number(missing.get("area_m2"))
    remark = "nothing was left out" if size == 0.0 else ""
    if areas:
        largest = areas[0]
        at = place(largest.get("centre"))
        remark = f"{count(missing.get('count'))} places, the largest at {at}"
        if missing.get("count") == 1:
            remark = f"one place, at {at}"
    return "missing area", _square(size), remark, ""


def _area(files: RunFiles, measured: dict[str, Any], found: dict[str, Any]) -> Tile:
    ratio = number(measured.get("area_ratio"))
    certified = measured.get("certified_area_ratio")
    if certified is None:
        certified = section(files.summary, "coverage").get("area_ratio")
    least = number(section(found, "tolerance").get("area_ratio_min"))
    level = "" if not math.isfinite(least) else "good" if ratio >= least else "bad"
    asked = f", asked {percent(least)}" if math.isfinite(least) else ""
    return "area measured", percent(ratio), f"planned {percent(certified)}{asked}", level


def _alignment(found: dict[str, Any]) -> Tile:
    alignment = section(found, "alignment")
    sigma = millimetres(alignment.get("position_sigma_m"))
    open_motions = len(items(alignment, "undetermined"))
    remark = f"residual {millimetres(alignment.get('rms_m'))}"
    if open_motions:
        remark = f"{open_motions} motions undetermined: the coarse pose was kept there"
    return "alignment known to", sigma, remark, "warn" if open_motions else ""


def _asked(row: dict[str, Any]) -> str:
    tolerance, nominal = number(row.get("tolerance_m")), number(row.get("nominal_m"))
    kind = row.get("kind")
    if kind == "sphere_diameter":
        return f"{millimetres(nominal)} ±{millimetres(tolerance)}"
    return f"±{millimetres(tolerance / 2)}" if kind == "point" else f"≤ {millimetres(tolerance)}"


def _figures(region: dict[str, Any]) -> list[str]:
    return [
        _square(number(region.get("area_m2"))),
        percent(region.get("area_ratio")),
        millimetres(region.get("mean_m"), sign=True),
        millimetres(region.get("sigma_m")),
        millimetres(region.get("min_m"), sign=True),
        millimetres(region.get("max_m"), sign=True),
        millimetres(region.get("worst_m"), sign=True),
        percent(region.get("within_ratio")),
        f"{count(number(region.get('density_per_m2')) / 1e4)} / cm²",
    ]


def _square(area_m2: float) -> str:
    if not math.isfinite(area_m2):
        return "–"
    return f"{area_m2:.3f} m²" if area_m2 >= 0.1 else f"{area_m2 * 1e4:.1f} cm²"


def _day(value: object) -> str:
    return str(value)[:10] if value else "–"
