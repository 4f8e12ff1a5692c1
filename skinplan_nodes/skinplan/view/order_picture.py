"""In which order the arm visits the points: the scanner's real way, coloured by time (Fig. 20e)."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from skinplan.errors import InputError
from skinplan.stations.model import SkippedPoint
from skinplan.trajectory.model import SCAN
from skinplan.transforms import Array
from skinplan.view import palette
from skinplan.view.motion import StationMotion, station_motions
from skinplan.view.reasons import cross_handles, kinds_of_points, skipped_sentence
from skinplan.view.sheet import Page, Panel, draw_page, outlined, show_image
from skinplan.view.stage import IMAGE_PX, Stage

MOST_STATIONS = 6
SCAN_PT, TRANSIT_PT = 3.4, 1.1
_PALE = (0.93, 0.935, 0.94)
_TRANSIT: palette.Colour = (0.40, 0.42, 0.45)
_SPARE_M = 0.06
_MOST_NUMBERS = 14
_NUMBER_GAP_PX = 24.0
_NUMBER_LIFT_PT = 10.0
_BAR_PX = 16.0
_BAR_STEPS = 512
_SHORTEST_S = 1e-6  # a scan of one point may take no time


def order_figure(stage: Stage) -> Figure:
    """Draws the scanner's way at each station, from the front, with the numbers of the visit.

    Args:
        stage: The part and its views; the subject has a path and trajectories.

    Raises:
        InputError: There is no path or no trajectory.
    """
    subject = stage.subject
    motions = station_motions(subject)
    if subject.path is None or not motions:
        raise InputError("a picture of the order of visit needs a scan path and trajectories")
    longest = max(motion.duration_s for motion in motions)
    shown = motions[:MOST_STATIONS]
    left_out = not_passed(motions, subject.skipped)
    extent = stage.extent_with(stage.front, _all_places(stage, shown), _SPARE_M)
    panels = [
        Panel(
            _station_title(motion),
            extent,
            lambda axes, motion=motion: _draw(axes, stage, motion, longest, left_out),  # type: ignore[misc]
        )
        for motion in shown
    ]
    if longest > 0.0:
        panels.append(time_bar(longest))
    passed = sum(len(motion.points) for motion in motions)
    breaks = sum(len(motion.break_s) for motion in motions)
    title = (
        f"{subject.part_id}: order of visit, {_count(passed, 'point')}, {_count(breaks, 'break')} "
        f"(strategy {_strategy(stage)})"
    )
    caption = (
        "The way of the scanner's origin by the timed trajectories. Numbers count the points of a "
        f"station in the order of visit. {skipped_sentence(left_out)}"
    )
    if len(shown) < len(motions):
        caption += f" Stations after the first {len(shown)} are not shown."
    columns = 2 if panels[0].ratio > 0.6 and len(shown) > 1 else 1
    return draw_page(
        Page(title, tuple(panels), _handles(motions, left_out), caption, columns=columns)
    )


def time_bar(longest_s: float) -> Panel:
    """Returns the bar that says which colour is which time.

    Args:
        longest_s: Its length, above 0 [s].
    """

    def draw(axes: Axes) -> None:
        middles = (np.arange(_BAR_STEPS) + 0.5) / _BAR_STEPS
        extent = (0.0, longest_s, 0.0, 1.0)
        axes.imshow(palette.time_colours(middles)[None], extent=extent, aspect="auto")
        axes.set_yticks([])

    label = "time since the arm has left home at the station [s]"
    return Panel("", (0.0, longest_s, 0.0, 1.0), draw, (label, ""), _BAR_PX)


def not_passed(
    motions: Sequence[StationMotion], skipped: Sequence[SkippedPoint]
) -> tuple[SkippedPoint, ...]:
    """Returns those of the skipped points that no station passes: one may scan another's.

    Args:
        motions: Of all stations.
        skipped: Points left out somewhere.
    """
    passed = {int(point) for motion in motions for point in motion.points}
    return tuple(entry for entry in skipped if entry.point not in passed)


def numbered(flat: Array, gap_m: float) -> list[int]:
    """Chooses the points that get their number: first, last and some between, none on another.

    Args:
        flat: Places in the picture in the order of visit, shape (p, 2) [m].
        gap_m: Least distance between two numbers [m].

    Returns:
        Their places in the order, rising.
    """
    if not len(flat):
        return []
    step = max(1, round(len(flat) / _MOST_NUMBERS))
    wanted = [0, len(flat) - 1, *range(step - 1, len(flat) - 1, step)]
    taken: list[int] = []
    for number in wanted:
        if all(np.abs(flat[number] - flat[other]).max() >= gap_m for other in taken):
            taken.append(number)
    return sorted(taken)


def _draw(
    axes: Axes,
    stage: Stage,
    motion: StationMotion,
    longest_s: float,
    left_out: Sequence[SkippedPoint],
) -> None:
    view = stage.front.view
    show_image(axes, stage.plain(stage.front, _PALE), view.extent)
    for segment, kind in enumerate(motion.kinds):
        times, places = motion.way(segment)
        flat = view.plane(places)
        if kind == SCAN:
            _draw_scan(axes, flat, times / max(longest_s, _SHORTEST_S))
        else:
            dashes = (0, (5, 3))
            axes.plot(*flat.T, color=_TRANSIT, linewidth=TRANSIT_PT, linestyle=dashes, zorder=4)
    _draw_points(axes, stage, motion, left_out)
    if not len(motion.times):
        return
    for times, style in (
        (motion.break_s, _BREAK),
        (motion.times[-1:], _END),
        (motion.times[:1], _START),
    ):
        flat = view.plane(motion.scanner(motion.joints(times))[:, :3, 3])
        axes.plot(*flat.T, zorder=7, **style)


def _draw_scan(axes: Axes, flat: Array, shares: Array) -> None:
    """Each piece has the colour of its middle; a light edge keeps it apart from what it crosses."""
    lines = np.stack([flat[:-1], flat[1:]], axis=1)
    axes.plot(*flat.T, color="white", linewidth=SCAN_PT + 1.8, zorder=5, solid_capstyle="round")
    colours = palette.time_colours(0.5 * (shares[:-1] + shares[1:]))
    axes.add_collection(
        LineCollection(list(lines), colors=colours, linewidths=SCAN_PT, zorder=6, capstyle="round")
    )


def _draw_points(
    axes: Axes, stage: Stage, motion: StationMotion, left_out: Sequence[SkippedPoint]
) -> None:
    path, view = stage.subject.path, stage.front.view
    assert path is not None
    own = {entry.point for entry in motion.skipped}
    nobody = own | {entry.point for entry in _of_no_station(stage)}
    for kind, members in kinds_of_points([e for e in left_out if e.point in nobody]).items():
        axes.plot(
            *view.plane(path.positions[members]).T, "x", color=kind.colour, markersize=8,
            markeredgewidth=2, zorder=7,
        )  # fmt: skip
    if not len(motion.points):
        return
    flat = view.plane(motion.scanner(motion.joints(motion.point_s))[:, :3, 3])
    axes.plot(*flat.T, zorder=8, **_POINT)
    left, right, *_ = axes.get_images()[0].get_extent()
    gap = _NUMBER_GAP_PX * (right - left) / IMAGE_PX
    for number in numbered(flat, gap):
        u, v = flat[number]
        outlined(axes, u, v, str(number + 1), _NUMBER_LIFT_PT, fontsize=10)


def _of_no_station(stage: Stage) -> Sequence[SkippedPoint]:
    plan = stage.subject.station_plan
    return () if plan is None else plan.skipped


def _all_places(stage: Stage, motions: Sequence[StationMotion]) -> Array:
    assert stage.subject.path is not None
    ways = [m.way(segment)[1] for m in motions for segment in range(len(m.kinds))]
    return np.concatenate([stage.subject.path.positions, *ways])


def _station_title(motion: StationMotion) -> str:
    if not len(motion.times):
        return f"station {motion.name}: no motion, {_count(len(motion.skipped), 'point')} skipped"
    told = (
        f"station {motion.name}: {_count(len(motion.points), 'point')}, "
        f"{_count(len(motion.break_s), 'break')}, {motion.duration_s:.1f} s"
    )
    return told + (f", {_count(len(motion.skipped), 'point')} skipped" if motion.skipped else "")


def _strategy(stage: Stage) -> str:
    return stage.subject.order_strategy or "not known"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


_POINT: dict[str, Any] = {
    "linestyle": "none", "marker": "o", "color": palette.INK, "markersize": 4.2,
    "markeredgecolor": "white", "markeredgewidth": 0.7,
}  # fmt: skip
_BREAK: dict[str, Any] = {
    "linestyle": "none", "marker": "D", "color": "white", "markersize": 6.5,
    "markeredgecolor": palette.HOLE_FRAME, "markeredgewidth": 1.6,
}  # fmt: skip
_START: dict[str, Any] = {
    "linestyle": "none", "marker": ">", "color": palette.INK, "markersize": 8,
    "markeredgecolor": "white", "markeredgewidth": 0.8,
}  # fmt: skip
_END: dict[str, Any] = {
    "linestyle": "none", "marker": "s", "color": "white", "markersize": 14,
    "markeredgecolor": palette.INK, "markeredgewidth": 1.6,
}  # fmt: skip


def _handles(motions: Sequence[StationMotion], left_out: Sequence[SkippedPoint]) -> list[Artist]:
    handles: list[Artist] = [
        Line2D(
            [], [], color=tuple(palette.time_colours(np.array([0.5]))[0]), linewidth=SCAN_PT,
            label="scan, coloured by time",
        ),
        Line2D(
            [], [], color=_TRANSIT, linewidth=TRANSIT_PT, linestyle=(0, (5, 3)),
            label="transit, not scanning",
        ),
        Line2D([], [], label="point when it is passed", **_POINT),
        Line2D([], [], label="start", **_START),
        Line2D([], [], label="end", **(_END | {"markersize": 10})),
    ]  # fmt: skip
    breaks = sum(len(motion.break_s) for motion in motions)
    if breaks:
        label = f"{_count(breaks, 'break')}: the scan stops here, to go on elsewhere"
        handles.append(Line2D([], [], label=label, **_BREAK))
    return handles + cross_handles(left_out)
