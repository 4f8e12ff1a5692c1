"""A contact plan on record: its document, its hash, its table."""

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from skinplan.contact.model import ContactPlan, ContactStation, TrackerStation
from skinplan.part.model import Part
from skinplan.plan_record import plain
from skinplan.transforms import Array, apply, heading

_DECIMALS = 6


def contact_document(plan: ContactPlan, part: Part) -> dict[str, Any]:
    """Returns ``contact.json``: figures, stations, poses, motions; its hash is over the rest.

    Lengths are in metres, angles in radians, both rounded to six decimals. Points are numbered as
    in the part's file, from 0.

    Args:
        plan: The plan.
        part: What it was made for.
    """
    document = {
        **contact_summary(plan, part),
        "points": [
            {
                "station": int(station),
                "target_m": _rounded(target),
                "joints_rad": _rounded(q),
                "probe_m": _rounded(probe[:3, 3]),
            }
            for station, target, q, probe in zip(
                plan.station_of, _targets(part), plan.q, plan.T_axial_probe, strict=True
            )
        ],
        "motions": [
            {
                "station": motion.station,
                "start": motion.start,
                "end": motion.end,
                "problem": motion.problem,
                "corners_rad": _rounded(motion.corners),
            }
            for motion in plan.motions
        ],
    }
    document = plain(document)
    text = json.dumps(document, sort_keys=True, separators=(",", ":"))
    return {**document, "hash": hashlib.sha256(text.encode()).hexdigest()}


def contact_summary(plan: ContactPlan, part: Part) -> dict[str, Any]:
    """Returns the figures of a plan: what ``skinplan contact --json`` prints."""
    measured = plan.station_of >= 0
    broken = [motion for motion in plan.motions if motion.problem]
    return {
        "part": part.id,
        "mesh_sha256": part.mesh_sha256,
        "frame": "axial: y along the part's axis, x toward the stations, z = 0 at the arm's base",
        "T_map_axial": _rounded(plan.T_map_axial),
        "complete": plan.complete,
        "count": len(plan.q),
        "covered": int(plan.covered.sum()),
        "measured": int(measured.sum()),
        "reached_sum": plan.reached_sum,
        "history": [
            {"stations": count, "reached_sum": total, "covered": covered}
            for count, total, covered in plan.history
        ],
        "stations": [_station(station, plan.T_map_axial) for station in plan.stations],
        "tracker": None if plan.tracker is None else _tracker(plan.tracker, plan.T_map_axial),
        "motion_count": len(plan.motions),
        "motions_not_held": [
            {"station": m.station, "start": m.start, "end": m.end, "problem": m.problem}
            for m in broken
        ],
        "missed": [{"point": entry.point, "reason": entry.reason} for entry in plan.missed],
    }


def station_rows(document: Mapping[str, Any]) -> list[tuple[Any, ...]]:
    """Rows of the table of stations: number, x, y, k, reached, measured."""
    return [
        (
            number,
            f"{station['x_m']:.3f}",
            f"{station['y_m']:.3f}",
            station["k"],
            station["reached"],
            len(station["points"]),
        )
        for number, station in enumerate(document["stations"], 1)
    ]


def figure_rows(document: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Names and values of what a person asks of a plan."""
    count, held = document["count"], document["motion_count"] - len(document["motions_not_held"])
    rows: list[tuple[str, Any]] = [
        ("reachable sum", f"{document['reached_sum']}, of {count} points"),
        ("covered", f"{document['covered']} of {count}"),
        ("measured", f"{document['measured']} of {count}"),
        ("step (9) fulfilled", "yes" if document["complete"] else "no"),
    ]
    if tracker := document["tracker"]:
        place = ", ".join(f"{value:.3f}" for value in tracker["position_m"])
        least, most = tracker["range_m"] or (None, None)
        rows.append(("tracker at (m)", f"{place}; sees {tracker['sees']}"))
        if least is not None:
            rows.append(("beam", f"{least:.2f} to {most:.2f} m"))
            rows.append(("largest emission angle", _degrees(tracker["emission_max_rad"])))
            rows.append(("largest incidence angle", _degrees(tracker["incidence_max_rad"])))
    rows.append(("motions held", f"{held} of {document['motion_count']}"))
    rows += [
        (f"not held, {m['start']} to {m['end']}", m["problem"])
        for m in document["motions_not_held"]
    ]
    rows += [(f"not measured, {m['point']}", m["reason"]) for m in document["missed"]]
    return rows


def _station(station: ContactStation, T_map_axial: Array) -> dict[str, Any]:
    T_map_arm = T_map_axial @ station.T_axial_arm
    return {
        "x_m": _rounded(station.x_m),
        "y_m": _rounded(station.y_m),
        "start_x_m": _rounded(station.start_x_m),
        "k": station.k,
        "reached": int(station.reached.sum()),
        "counts": station.counts,
        "arm_in_map": {
            "position_m": _rounded(T_map_arm[:3, 3]),
            "heading_rad": _rounded(heading(T_map_arm)),
        },
        "points": station.points,
    }


def _tracker(tracker: TrackerStation, T_map_axial: Array) -> dict[str, Any]:
    seen = tracker.sees
    any_seen = bool(seen.any())
    return {
        "position_m": _rounded(tracker.position),
        "position_in_map_m": _rounded(apply(T_map_axial, tracker.position[None])[0]),
        "sees": int(seen.sum()),
        "emission_max_rad": _rounded(tracker.emission_rad[seen].max()) if any_seen else None,
        "incidence_max_rad": _rounded(tracker.incidence_rad[seen].max()) if any_seen else None,
        "range_m": [_rounded(f(tracker.range_m[seen])) for f in (np.min, np.max)]
        if any_seen
        else None,
    }


def _targets(part: Part) -> Array:
    assert part.points is not None
    return part.points.targets


def _rounded(value: Any) -> Any:
    return np.round(value, _DECIMALS) + 0.0


def _degrees(angle_rad: float) -> str:
    return f"{np.degrees(angle_rad):.1f}°"
