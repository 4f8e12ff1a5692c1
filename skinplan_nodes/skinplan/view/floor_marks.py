"""What stands and lies on the plan of the shop's floor: part, bases, rectangles, scan points."""

from collections.abc import Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Polygon
from numpy.typing import NDArray

from skinplan.robot.cell import CellConfig
from skinplan.stations.model import Station
from skinplan.stations.rectangle import Rectangle
from skinplan.transforms import Array, apply
from skinplan.view import palette
from skinplan.view.display_mesh import thinned
from skinplan.view.reasons import cross_handles, kinds_of_points
from skinplan.view.sheet import outlined
from skinplan.view.subject import Subject

_PART_FACES = 15_000
_FEW = 150
_MARKERS = ("o", "s", "D", "v", "P", "h", "^")


def footprint(T_map_base_link: Array, cell: CellConfig) -> Array:
    """Returns the corners of the base on the floor, shape (4, 2) [m], map frame."""
    length, width, _ = cell.base_size_m
    return _corners(T_map_base_link, np.zeros(2), length, width)


def arm_place(T_map_base_link: Array, cell: CellConfig) -> Array:
    """Returns where the arm stands, shape (3,) [m], map frame."""
    return (T_map_base_link @ cell.T_base_link_arm_base)[:3, 3]


def rectangle_corners(T_map_base_link: Array, cell: CellConfig, rectangle: Rectangle) -> Array:
    """Returns the corners of a base's workspace rectangle, shape (4, 2) [m], map frame."""
    middle = cell.T_base_link_arm_base[:2, 3] + [0.0, rectangle.offset_m]
    return _corners(T_map_base_link, middle, rectangle.length_m, rectangle.depth_m)


def marker(number: int) -> str:
    """Returns the marker of the points of station ``number`` in the order of visit."""
    return _MARKERS[number % len(_MARKERS)]


def floor_places(subject: Subject) -> Array:
    """Returns the scan points' places on the floor, shape (n, 2) [m], map frame."""
    assert subject.path is not None
    return apply(subject.T_map_workpiece, subject.path.positions)[:, :2]


def draw_part(axes: Axes, subject: Subject) -> None:
    """Draws the part and the cell's obstacles as their shadows on the floor."""
    small = thinned(subject.mesh, _PART_FACES).mesh
    flat = apply(subject.T_map_workpiece, small.vertices)[:, :2]
    colour = palette.OUTLINE
    axes.add_collection(
        PolyCollection(list(flat[small.faces]), facecolors=[colour], edgecolors=[colour], zorder=3)
    )
    for obstacle in subject.cell.obstacles:
        length, width, _ = obstacle.size_m
        corners = _corners(obstacle.T_map_box, np.zeros(2), length, width)
        axes.add_patch(
            Polygon(corners, facecolor=palette.SURFACE, edgecolor=palette.FAINT, zorder=2)
        )
        middle = corners.mean(axis=0)
        outlined(axes, middle[0], middle[1], obstacle.name, fontsize=9)


def draw_points(axes: Axes, subject: Subject, places: Array, size: float | None = None) -> None:
    """Draws scan points: those of a station in its colour, crosses for the rest by their reason.

    On the floor many points lie above each other: the crosses are larger, and below the others.

    Args:
        axes: Where.
        subject: Has a path and a station plan.
        places: Of the points in the axes, shape (n, 2) [m].
        size: Of a marker [pt]; None = as many points allow.
    """
    size = size or (6.0 if len(places) < _FEW else 4.5 if len(places) < 10 * _FEW else 3.0)
    owner = subject.station_of_points()
    for number in range(owner.max(initial=-1) + 1):
        axes.plot(
            *places[owner == number].T, marker(number), color=palette.series(number),
            markersize=size, markeredgecolor="white", markeredgewidth=0.3, zorder=6,
        )  # fmt: skip
    for kind, points in kinds_of_points(subject.skipped).items():
        axes.plot(
            *places[points].T, "x", color=kind.colour, markersize=1.6 * size,
            markeredgewidth=0.32 * size, zorder=5,
        )  # fmt: skip


def draw_station(
    axes: Axes, cell: CellConfig, station: Station, number: int, reach_m: float | None = None
) -> None:
    """Draws a base with its number and heading.

    Args:
        axes: Where.
        cell: The cell.
        station: The station.
        number: Its place in the order of visit: its colour.
        reach_m: How far the arm gets at most, a circle [m]; None = no circle.
    """
    colour = palette.series(number)
    corners = footprint(station.T_map_base_link, cell)
    axes.add_patch(
        Polygon(corners, facecolor=(*colour, 0.25), edgecolor=colour, linewidth=1.6, zorder=4)
    )
    arm = arm_place(station.T_map_base_link, cell)[:2]
    if reach_m is not None:
        axes.add_patch(
            Circle(
                (float(arm[0]), float(arm[1])), reach_m, fill=False, edgecolor=(0.75, 0.75, 0.75),
                linewidth=0.9, zorder=1,
            )
        )  # fmt: skip
    axes.plot(*arm, "o", color="white", markeredgecolor=palette.INK, markersize=8, zorder=8)
    middle, ahead = station.T_map_base_link[:2, 3], station.T_map_base_link[:2, 0]
    front = middle + 0.5 * cell.base_size_m[0] * ahead
    axes.annotate(
        "", xy=tuple(front + 0.16 * ahead), xytext=tuple(front), zorder=8,
        arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 2, "mutation_scale": 18},
    )  # fmt: skip
    behind = middle - 0.32 * cell.base_size_m[0] * ahead
    outlined(axes, behind[0], behind[1], str(station.id), fontsize=15)


def draw_rectangle(axes: Axes, corners: Array, number: int) -> None:
    """Draws the workspace rectangle of a chosen station, corners (4, 2) [m]."""
    colour = palette.series(number)
    axes.add_patch(
        Polygon(
            corners, facecolor=(*colour, 0.07), edgecolor=colour, linewidth=1.5, linestyle="--",
            zorder=2,
        )
    )  # fmt: skip


def station_handles(subject: Subject, word: str = "points") -> list[Artist]:
    """Returns the legend of the stations' points and of the crosses.

    Args:
        subject: Has a path and a station plan.
        word: What is counted.
    """
    owner = subject.station_of_points()
    stations = subject.station_plan.stations if subject.station_plan else ()
    return [*_marker_handles(stations, owner, word), *cross_handles(subject.skipped)]


def rectangle_handle() -> Artist:
    """Returns the legend of the workspace rectangles."""
    return Patch(
        facecolor="none", edgecolor=palette.FAINT, linestyle="--", label="workspace rectangle"
    )


def _marker_handles(
    stations: Sequence[Station], owner: NDArray[np.int64], word: str
) -> list[Artist]:
    return [
        Line2D(
            [], [], linestyle="none", marker=marker(number), color=palette.series(number),
            label=f"station {station.id}: {np.count_nonzero(owner == number)} {word}",
        )
        for number, station in enumerate(stations)
    ]  # fmt: skip


def _corners(T_map_a: Array, middle: Array, length: float, width: float) -> Array:
    half = 0.5 * np.array([[length, width], [-length, width], [-length, -width], [length, -width]])
    flat = np.concatenate([middle + half, np.zeros((4, 1))], axis=1)
    return apply(T_map_a, flat)[:, :2]
