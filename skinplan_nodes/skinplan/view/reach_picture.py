"""What each station reaches of the part, and why it does not reach the rest (Fig. 14, 20d of M)."""

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from skinplan.errors import InputError
from skinplan.robot.records import ReachTable
from skinplan.stations.model import StationPlan
from skinplan.view import palette
from skinplan.view.floor import reach_sentence
from skinplan.view.floor_marks import draw_points, marker, station_handles
from skinplan.view.reasons import KINDS, Kind, kind_of, skipped_sentence
from skinplan.view.sheet import Page, Panel, draw_page, show_image
from skinplan.view.stage import Stage

_PALE = (0.93, 0.935, 0.94)
_SPARE_M = 0.05
_NARROW = 0.6
_MOST_STATIONS = 9


def reach_figure(stage: Stage) -> Figure:
    """Draws the points from the front, by station, and what each station reaches.

    Args:
        stage: The part and its views; the subject has a path and a station plan.
    """
    subject = stage.subject
    if subject.path is None or subject.station_plan is None:
        raise InputError("a picture of the reach needs a scan path and a station plan")
    plan = subject.station_plan
    extent = stage.extent_with(stage.front, subject.path.positions, _SPARE_M)
    main = Panel(
        "from the front: places of the scanner, by the station that scans them",
        extent,
        lambda axes: _draw_all(axes, stage),
    )
    shown = 0 if plan.records is None else min(len(plan.stations), _MOST_STATIONS)
    small = tuple(
        Panel(
            _station_title(plan, number),
            extent,
            lambda axes, number=number: _draw_station(axes, stage, number),  # type: ignore[misc]
        )
        for number in range(shown)
    )
    caption = f"{reach_sentence(subject)} {skipped_sentence(subject.skipped)}"
    if 0 < shown < len(plan.stations):
        caption += f" Stations after the first {shown} have no panel of their own."
    title = f"{subject.part_id}: what the arm reaches from {_stations(plan)}"
    if main.ratio > _NARROW:
        return draw_page(Page(title, (main, *small), _handles(stage), caption))
    return draw_page(Page(title, (main,), _handles(stage), caption, small))


def kinds_of_station(records: ReachTable, station: int) -> dict[Kind, NDArray[np.int64]]:
    """Returns the points that a station does not reach by kind of reason, each shape (m,).

    Args:
        records: Of the stations.
        station: Row.
    """
    codes = records.codes[station]
    found: dict[Kind, list[NDArray[np.int64]]] = {kind: [] for kind in KINDS}
    for code in np.unique(codes[~records.reached[station]]):
        found[kind_of(records.reason(int(code)))].append(np.flatnonzero(codes == code))
    return {kind: np.sort(np.concatenate(parts)) for kind, parts in found.items() if parts}


def _stations(plan: StationPlan) -> str:
    count = len(plan.stations)
    return f"{count} station{'' if count == 1 else 's'} (strategy {plan.strategy})"


def _station_title(plan: StationPlan, number: int) -> str:
    assert plan.records is not None
    reached = plan.records.reached[number]
    told = f"station {plan.stations[number].id} reaches {reached.sum()} of {len(reached)}"
    if plan.robust is None:
        return told
    return f"{told}, {plan.robust[number].sum()} also beside its goal"


def _draw_all(axes: Axes, stage: Stage) -> None:
    subject, view = stage.subject, stage.front.view
    assert subject.path is not None
    show_image(axes, stage.plain(stage.front, _PALE), view.extent)
    draw_points(axes, subject, view.plane(subject.path.positions))


def _draw_station(axes: Axes, stage: Stage, number: int) -> None:
    subject, view = stage.subject, stage.front.view
    assert subject.path is not None and subject.station_plan is not None
    plan, places = subject.station_plan, view.plane(subject.path.positions)
    assert plan.records is not None
    show_image(axes, stage.plain(stage.front, _PALE), view.extent)
    reached, colour = plan.records.reached[number], palette.series(number)
    firm = reached if plan.robust is None else reached & plan.robust[number]
    axes.plot(
        *places[firm].T, marker(number), color=colour, markersize=3.2, markeredgewidth=0, zorder=5
    )
    axes.plot(
        *places[reached & ~firm].T, marker(number), color=colour, markersize=3.0,
        markerfacecolor="white", markeredgewidth=0.9, zorder=5,
    )  # fmt: skip
    for kind, points in kinds_of_station(plan.records, number).items():
        axes.plot(
            *places[points].T,
            "x",
            color=kind.colour,
            markersize=3.0,
            markeredgewidth=0.6,
            alpha=0.6,
            zorder=4,
        )


def _handles(stage: Stage) -> list[Artist]:
    plan = stage.subject.station_plan
    assert plan is not None
    handles = station_handles(stage.subject)
    if plan.records is None:
        return handles
    if plan.robust is not None and np.any(plan.records.reached & ~plan.robust):
        handles.append(
            Line2D(
                [], [], linestyle="none", marker="o", color=palette.FAINT, markerfacecolor="white",
                label="per station, hollow: reached only with the base on its goal",
            )
        )  # fmt: skip
    shown = {k for n in range(len(plan.stations)) for k in kinds_of_station(plan.records, n)}
    handles += [
        Line2D(
            [], [], linestyle="none", marker="x", color=kind.colour, markersize=5,
            label=f"per station: {kind.name}",
        )
        for kind in KINDS
        if kind in shown
    ]  # fmt: skip
    return handles
