"""The shop from above: part, stations, reach of the arm, points by station."""

from collections import Counter

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Polygon

from skinplan.errors import InputError
from skinplan.robot.arm import ArmModel
from skinplan.robot.cell import CellConfig
from skinplan.stations.model import Station
from skinplan.transforms import Array, apply
from skinplan.view import palette
from skinplan.view.display_mesh import thinned
from skinplan.view.sheet import Page, Panel, draw_page, outlined
from skinplan.view.subject import Subject

_PART_FACES = 15_000
_MARGIN_M = 0.45
_MARKERS = ("o", "s", "D", "v", "P", "h", "^")


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
        "from above; grey circles: the arm and the scanner get no farther",
        _window(subject),
        lambda axes: _draw_floor(axes, subject, reach),
        ("map x [m]", "map y [m]"),
    )
    proof = ", proven least number" if plan.proven_optimal else ""
    count = len(plan.stations)
    title = (
        f"{subject.part_id}: {count} station{'' if count == 1 else 's'} of {plan.candidates} "
        f"candidates{proof} (strategy {plan.strategy})"
    )
    return draw_page(Page(title, (panel,), _handles(subject), skipped_sentence(subject)))


def footprint(T_map_base_link: Array, cell: CellConfig) -> Array:
    """Returns the corners of the base on the floor, shape (4, 2) [m], map frame."""
    length, width, _ = cell.base_size_m
    corners = 0.5 * np.array(
        [[length, width, 0], [-length, width, 0], [-length, -width, 0], [length, -width, 0]]
    )
    return apply(T_map_base_link, corners)[:, :2]


def arm_place(T_map_base_link: Array, cell: CellConfig) -> Array:
    """Returns where the arm stands, shape (3,) [m], map frame."""
    return (T_map_base_link @ cell.T_base_link_arm_base)[:3, 3]


def skipped_sentence(subject: Subject) -> str:
    """Returns how many points are not scanned and why, one sentence."""
    if not subject.skipped:
        return "All points are scanned."
    reasons = Counter(entry.reason for entry in subject.skipped)
    points = len({entry.point for entry in subject.skipped})
    told = "; ".join(f"{count} × {reason}" for reason, count in reasons.most_common(3))
    more = f"; and {len(reasons) - 3} other reasons" if len(reasons) > 3 else ""
    return f"{points} point{'' if points == 1 else 's'} not scanned: {told}{more}."


def _window(subject: Subject) -> tuple[float, float, float, float]:
    assert subject.station_plan is not None
    part = apply(subject.T_map_workpiece, subject.mesh.vertices)[:, :2]
    points = [part]
    for station in subject.station_plan.stations:
        points.append(footprint(station.T_map_base_link, subject.cell))
    together = np.concatenate(points)
    low, high = together.min(axis=0) - _MARGIN_M, together.max(axis=0) + _MARGIN_M
    return (float(low[0]), float(high[0]), float(low[1]), float(high[1]))


def _draw_floor(axes: Axes, subject: Subject, reach_m: float) -> None:
    assert subject.station_plan is not None and subject.path is not None
    axes.grid(color=(0.92, 0.92, 0.93), zorder=0)
    _draw_part(axes, subject)
    stations = subject.station_plan.stations
    middles = np.array([s.T_map_base_link[:2, 3] for s in stations]).reshape(-1, 2)
    axes.plot(*middles.T, "--", color=palette.FAINT, linewidth=1.0, zorder=2)
    owner = subject.station_of_points()
    places = apply(subject.T_map_workpiece, subject.path.positions)[:, :2]
    for number, station in enumerate(stations):
        _draw_station(axes, subject.cell, station, number, reach_m)
        axes.plot(
            *places[owner == number].T, _marker(number), color=palette.series(number),
            markersize=4.5, markeredgecolor="white", markeredgewidth=0.3, zorder=6,
        )  # fmt: skip
    axes.plot(
        *places[owner < 0].T, "x", color=palette.SKIPPED, markersize=8, markeredgewidth=2, zorder=7
    )


def _draw_part(axes: Axes, subject: Subject) -> None:
    small = thinned(subject.mesh, _PART_FACES).mesh
    flat = apply(subject.T_map_workpiece, small.vertices)[:, :2]
    colour = palette.OUTLINE
    axes.add_collection(
        PolyCollection(list(flat[small.faces]), facecolors=[colour], edgecolors=[colour], zorder=3)
    )


def _draw_station(
    axes: Axes, cell: CellConfig, station: Station, number: int, reach_m: float
) -> None:
    colour = palette.series(number)
    corners = footprint(station.T_map_base_link, cell)
    axes.add_patch(
        Polygon(corners, facecolor=(*colour, 0.25), edgecolor=colour, linewidth=1.6, zorder=4)
    )
    arm = arm_place(station.T_map_base_link, cell)[:2]
    axes.add_patch(
        Circle(tuple(arm), reach_m, fill=False, edgecolor=(0.6, 0.6, 0.6), linewidth=0.9, zorder=1)
    )
    axes.plot(*arm, "o", color="white", markeredgecolor=palette.INK, markersize=8, zorder=8)
    middle, ahead = station.T_map_base_link[:2, 3], station.T_map_base_link[:2, 0]
    front = middle + 0.5 * cell.base_size_m[0] * ahead
    axes.annotate(
        "", xy=tuple(front + 0.16 * ahead), xytext=tuple(front), zorder=8,
        arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 2, "mutation_scale": 18},
    )  # fmt: skip
    behind = middle - 0.32 * cell.base_size_m[0] * ahead
    outlined(axes, behind[0], behind[1], str(station.id), fontsize=15)


def _marker(number: int) -> str:
    return _MARKERS[number % len(_MARKERS)]


def _handles(subject: Subject) -> list[Artist]:
    assert subject.station_plan is not None
    owner = subject.station_of_points()
    handles: list[Artist] = [Patch(color=palette.OUTLINE, label="part")]
    for number, station in enumerate(subject.station_plan.stations):
        count = int(np.count_nonzero(owner == number))
        handles.append(
            Line2D(
                [], [], linestyle="none", marker=_marker(number), color=palette.series(number),
                label=f"station {station.id}: {count} points",
            )
        )  # fmt: skip
    handles.append(
        Line2D(
            [], [], linestyle="none", marker="o", color="white", markeredgecolor=palette.INK,
            label="axis of the arm",
        )
    )  # fmt: skip
    if np.any(owner < 0):
        handles.append(
            Line2D([], [], linestyle="none", marker="x", color=palette.SKIPPED, markersize=8,
                   markeredgewidth=2, label="point not scanned")
        )  # fmt: skip
    return handles
