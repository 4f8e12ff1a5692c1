"""The shop from above: candidates, stations, rectangles, points by station (Fig. 13, 14, 20c)."""

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from skinplan.errors import InputError
from skinplan.robot.arm import ArmModel
from skinplan.stations.candidate_map import CandidateMap
from skinplan.stations.model import StationPlan
from skinplan.stations.rectangle import Rectangle
from skinplan.transforms import Array, apply
from skinplan.view import palette
from skinplan.view.candidate_marks import (
    candidate_handles,
    candidate_places,
    draw_candidate_rectangles,
    draw_candidates,
)
from skinplan.view.floor_marks import (
    draw_part,
    draw_points,
    draw_rectangle,
    draw_station,
    floor_places,
    footprint,
    rectangle_corners,
    rectangle_handle,
    station_handles,
)
from skinplan.view.reasons import skipped_sentence
from skinplan.view.sheet import Page, Panel, draw_page
from skinplan.view.subject import Subject
from skinplan.view.tracker_marks import draw_tracker, tracker_handles

_MARGIN_M = 0.30
_SHOP_MARGIN_M = 0.7
_NARROW = 0.7
_LABELS = ("map x [m]", "map y [m]")

Window = tuple[float, float, float, float]


def stations_figure(subject: Subject) -> Figure:
    """Draws the shop's floor with the stations.

    Args:
        subject: Has a path and a station plan.
    """
    if subject.path is None or subject.station_plan is None:
        raise InputError("a picture of the stations needs a scan path and a station plan")
    plan = subject.station_plan
    reach = float(ArmModel.load(subject.cell).lever_arms()[0])
    panel = Panel(
        "from above: bases with heading and number, points where the scanner stands; grey circles: "
        "the arm gets no farther",
        _window(subject),
        lambda axes: _draw_floor(axes, subject, reach),
        _LABELS,
    )
    title = f"{subject.part_id}: {proof_sentence(plan)} (strategy {plan.strategy})"
    caption = " ".join([reach_sentence(subject), skipped_sentence(subject.skipped)])
    small, handles = _small_panels(subject), _handles(subject)
    if panel.ratio <= _NARROW:
        return draw_page(Page(title, (panel,), handles, caption, small))
    # Beside each other they leave less of the page empty; the dots are large enough already.
    small = small if _rectangle(subject) is not None else small[:1]
    return draw_page(Page(title, (panel, *small), handles, caption))


def proof_sentence(plan: StationPlan) -> str:
    """Returns how many stations there are and how many there must be."""
    count = len(plan.stations)
    told = f"{count} station{'' if count == 1 else 's'} of {plan.candidates} candidates"
    if count < plan.lower_bound:
        return f"{told}, {plan.lower_bound} were needed: the rest is not free or reaches nothing"
    if plan.proven_optimal:
        return f"{told}, proven minimal"
    if plan.lower_bound > 0:
        return f"{told}, at least {plan.lower_bound} needed"
    return f"{told}, no bound known"


def reach_sentence(subject: Subject) -> str:
    """Returns which share of the points the arm truly reaches, and which robustly."""
    plan, cell = subject.station_plan, subject.cell
    if plan is None:
        return ""
    told = f"The arm truly reaches {_percent(plan.reached_ratio)} of the points"
    beside = f"{1000 * cell.base_error_m:.0f} mm and {np.rad2deg(cell.base_error_rad):.1f}°"
    if np.isnan(plan.robust_ratio):
        return f"{told}; what it reaches with the base beside its goal was not asked."
    return f"{told}, {_percent(plan.robust_ratio)} also with the base up to {beside} off its goal."


def _percent(ratio: float) -> str:
    return f"{np.floor(1e3 * ratio + 1e-6) / 10:.1f} %"


def _extent(places: list[Array], margin_m: float) -> Window:
    together = np.concatenate(places)
    low, high = together.min(axis=0) - margin_m, together.max(axis=0) + margin_m
    return (float(low[0]), float(high[0]), float(low[1]), float(high[1]))


def _shown(subject: Subject) -> list[Array]:
    """Places that every plan of the floor has in its window, each (n, 2) [m]."""
    assert subject.station_plan is not None
    shown = _part_and_points(subject)
    for station in subject.station_plan.stations:
        shown.append(footprint(station.T_map_base_link, subject.cell))
    return shown


def _part_and_points(subject: Subject) -> list[Array]:
    part = apply(subject.T_map_workpiece, subject.mesh.vertices)[:, :2]
    return [part, floor_places(subject)]


def _window(subject: Subject) -> Window:
    seen = _candidates(subject)
    shown = _shown(subject)
    if seen is not None and len(seen):
        shown.append(candidate_places(seen, subject.cell)[seen.tried])
    return _extent(shown, _MARGIN_M)


def _shop_window(subject: Subject) -> Window:
    tracker = subject.T_map_tracker[None, :2, 3]
    return _extent([*_shown(subject), tracker], _SHOP_MARGIN_M)


def _candidates(subject: Subject) -> CandidateMap | None:
    return None if subject.station_plan is None else subject.station_plan.candidates_seen


def _rectangle(subject: Subject) -> Rectangle | None:
    seen = _candidates(subject)
    return None if seen is None else seen.rectangle


def _small_panels(subject: Subject) -> tuple[Panel, ...]:
    height = float(np.mean(_heights(subject)))
    window = _shop_window(subject)
    panels = [
        Panel(
            f"the shop: where the tracker can see a scanner {height:.2f} m above the floor, if "
            "nothing hides it",
            window,
            lambda axes: _draw_shop(axes, subject, window, height),
            _LABELS,
        )
    ]
    seen = _candidates(subject)
    if seen is not None and len(seen):
        panels.append(_candidate_panel(subject, seen))
    return tuple(panels)


def _candidate_panel(subject: Subject, seen: CandidateMap) -> Panel:
    rectangle = seen.rectangle
    if rectangle is None:
        title = "the candidates: where the axis of the arm would stand"
        shown = [candidate_places(seen, subject.cell)]
    else:
        size = f"{rectangle.length_m:.2f} × {rectangle.depth_m:.2f} m"
        title = f"the {len(seen)} candidate rectangles, {size}; dark: covers many points"
        shown = [rectangle_corners(pose, subject.cell, rectangle) for pose in seen.poses]
    window = _extent([*_part_and_points(subject), *shown], 0.1)
    return Panel(title, window, lambda axes: _draw_candidates(axes, subject, seen), _LABELS)


def _heights(subject: Subject) -> Array:
    assert subject.path is not None
    return apply(subject.T_map_workpiece, subject.path.positions)[:, 2]


def _grid(axes: Axes) -> None:
    axes.grid(color=(0.92, 0.92, 0.93), zorder=0)
    axes.set_axisbelow(True)


def _draw_floor(axes: Axes, subject: Subject, reach_m: float) -> None:
    assert subject.station_plan is not None
    _grid(axes)
    draw_part(axes, subject)
    seen, rectangle = _candidates(subject), _rectangle(subject)
    if seen is not None:
        draw_candidates(axes, seen, subject.cell)
    stations = subject.station_plan.stations
    middles = np.array([s.T_map_base_link[:2, 3] for s in stations]).reshape(-1, 2)
    axes.plot(*middles.T, "--", color=palette.FAINT, linewidth=1.0, zorder=2)
    for number, station in enumerate(stations):
        draw_station(axes, subject.cell, station, number, reach_m)
        if rectangle is not None:
            corners = rectangle_corners(station.T_map_base_link, subject.cell, rectangle)
            draw_rectangle(axes, corners, number)
    draw_points(axes, subject, floor_places(subject))


def _draw_shop(axes: Axes, subject: Subject, window: Window, height_m: float) -> None:
    assert subject.station_plan is not None
    _grid(axes)
    draw_tracker(axes, subject, window, height_m)
    draw_part(axes, subject)
    for number, station in enumerate(subject.station_plan.stations):
        draw_station(axes, subject.cell, station, number)
    draw_points(axes, subject, floor_places(subject), 2.0)


def _draw_candidates(axes: Axes, subject: Subject, seen: CandidateMap) -> None:
    _grid(axes)
    draw_part(axes, subject)
    if seen.rectangle is None:
        draw_candidates(axes, seen, subject.cell, 2.2)
    else:
        draw_candidate_rectangles(axes, seen, subject.cell, seen.rectangle)
    axes.plot(*floor_places(subject).T, ".", color=palette.INK, markersize=2.0, zorder=6)


def _handles(subject: Subject) -> list[Artist]:
    handles: list[Artist] = [Patch(color=palette.OUTLINE, label="part")]
    handles += station_handles(subject)
    handles.append(
        Line2D(
            [], [], linestyle="none", marker="o", color="white", markeredgecolor=palette.INK,
            label="axis of the arm",
        )
    )  # fmt: skip
    seen = _candidates(subject)
    if seen is not None:
        handles += candidate_handles(seen)
    if _rectangle(subject) is not None:
        handles.append(rectangle_handle())
    return [*handles, *tracker_handles()]
