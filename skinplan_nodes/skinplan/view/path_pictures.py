"""The scan path: points with their view directions, and rows with their numbers."""

from collections.abc import Iterator

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from skinplan.errors import InputError
from skinplan.scan_path.model import FEATURE, ROW, ScanPath
from skinplan.view import palette
from skinplan.view.raster import Raster
from skinplan.view.sheet import Page, Panel, draw_page, outlined, show_image
from skinplan.view.stage import IMAGE_PX, Stage

_ARROW_OF_STANDOFF = 0.3
_PALE = (0.90, 0.91, 0.92)
_SPARE_M = 0.05
_LABEL_GAP_PX = 26.0


def points_figure(stage: Stage) -> Figure:
    """Draws the points from the front and from above, where tilts show as leaning arrows.

    Args:
        stage: The part and its views; the subject has a path.
    """
    subject = stage.subject
    path = _path(stage)
    panels = (
        Panel(
            "from the front: places of the scanner, arrows along the view directions",
            stage.extent_with(stage.front, path.positions, _SPARE_M),
            lambda axes: _draw_points(axes, stage, stage.front),
        ),
        Panel(
            "from above the front: straight views point up, tilted views lean",
            stage.extent_with(stage.raised, path.positions, _SPARE_M),
            lambda axes: _draw_points(axes, stage, stage.raised),
            ("along the part [m]", "in the picture [m]"),
        ),
    )
    title = (
        f"{subject.part_id}: {len(path)} points, {path.row_points} on rows, "
        f"{path.feature_points} on features (strategy {path.strategy})"
    )
    return draw_page(Page(title, panels, _point_handles(path), _tilt_sentence(stage)))


def rows_figure(stage: Stage) -> Figure:
    """Draws the rows with their numbers and directions.

    Args:
        stage: The part and its views; the subject has a path.
    """
    path, raster = _path(stage), stage.front
    image = stage.plain(raster, _PALE)
    rows = list(rows_of(path))
    extent = stage.extent_with(raster, path.positions, _SPARE_M)
    gap = _LABEL_GAP_PX * (extent[1] - extent[0]) / IMAGE_PX

    def draw(axes: Axes) -> None:
        show_image(axes, image, raster.view.extent)
        features = raster.view.plane(path.positions[path.kinds == FEATURE])
        axes.plot(*features.T, "^", color=palette.FEATURE_POINT, alpha=0.45, markersize=4, zorder=3)
        lines = [raster.view.plane(path.positions[members]) for _, members in rows]
        for number, line in enumerate(lines):
            _draw_row(axes, line, palette.series(2 * (number % 2)))
        for (group, _), place in _apart(rows, [_before(line, 0.8 * gap) for line in lines], gap):
            outlined(axes, place[0], place[1], str(group), fontsize=10)

    count = len(rows)
    length = sum(_length(path.positions[members]) for _, members in rows)
    title = f"{stage.subject.part_id}: {count} row{'' if count == 1 else 's'}, {length:.1f} m"
    caption = (
        "Numbers stand before the first point of a row, arrows point along it. Behind a hole a row "
        "goes on with a new number."
    )
    panel = Panel("from the front: the scanner's way", extent, draw)
    return draw_page(Page(title, (panel,), _row_handles(path), caption))


def rows_of(path: ScanPath) -> Iterator[tuple[int, NDArray[np.int64]]]:
    """Yields the number of each row and its points in the order along it, shape (m,)."""
    rows = np.flatnonzero(path.kinds == ROW)
    for group in np.unique(path.groups[rows]):
        yield int(group), rows[path.groups[rows] == group]


def _path(stage: Stage) -> ScanPath:
    if stage.subject.path is None:
        raise InputError("a picture of the points needs a scan path")
    return stage.subject.path


def _draw_points(axes: Axes, stage: Stage, raster: Raster) -> None:
    path = _path(stage)
    show_image(axes, stage.plain(raster, _PALE), raster.view.extent)
    for _, members in rows_of(path):
        line = raster.view.plane(path.positions[members])
        axes.plot(*line.T, "-", color=palette.ROW_POINT, linewidth=0.8, alpha=0.6, zorder=3)
    seen = raster.visible(path.targets, 0.004)
    length = _ARROW_OF_STANDOFF * _standoff(path)
    for kind, colour, marker in (
        (ROW, palette.ROW_POINT, "o"),
        (FEATURE, palette.FEATURE_POINT, "^"),
    ):
        chosen = path.kinds == kind
        targets = raster.view.plane(path.targets[chosen & seen])
        axes.plot(*targets.T, "x", color=palette.FAINT, markersize=3, markeredgewidth=0.7, zorder=2)
        start = raster.view.plane(path.positions[chosen])
        along = raster.view.plane(length * path.directions[chosen])
        axes.quiver(
            *start.T, *along.T, color=colour, angles="xy", scale_units="xy", scale=1.0,
            units="dots", width=1.6, headwidth=4.0, headlength=4.5, headaxislength=4.0,
            minlength=0, minshaft=1.0, zorder=5,
        )  # fmt: skip
        axes.plot(*start.T, marker, color=colour, markersize=4.2, linestyle="none", zorder=6)


def _draw_row(axes: Axes, line: NDArray[np.float64], colour: palette.Colour) -> None:
    axes.plot(*line.T, "-o", color=colour, linewidth=1.4, markersize=3.2, zorder=4)
    if len(line) < 2:
        return
    middle = max(1, len(line) // 2)
    axes.annotate(
        "", xy=tuple(0.5 * (line[middle - 1] + line[middle])), xytext=tuple(line[middle - 1]),
        zorder=5,
        arrowprops={"arrowstyle": "-|>", "color": colour, "mutation_scale": 15, "shrinkB": 0},
    )  # fmt: skip


def _before(line: NDArray[np.float64], distance_m: float) -> NDArray[np.float64]:
    """Returns the place before the first point of a line, against its direction."""
    ahead = line[min(1, len(line) - 1)] - line[0]
    length = float(np.linalg.norm(ahead))
    return line[0] - distance_m * (ahead / length if length > 0 else np.array([1.0, 0.0]))


def _apart(
    rows: list[tuple[int, NDArray[np.int64]]], places: list[NDArray[np.float64]], gap_m: float
) -> Iterator[tuple[tuple[int, NDArray[np.int64]], NDArray[np.float64]]]:
    """Yields the rows whose labels would not lie on one that is already there."""
    taken: list[NDArray[np.float64]] = []
    for row, place in zip(rows, places, strict=True):
        if all(np.abs(place - other).max() >= gap_m for other in taken):
            taken.append(place)
            yield row, place


def _standoff(path: ScanPath) -> float:
    return float(np.median(np.linalg.norm(path.targets - path.positions, axis=1)))


def _length(points: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _tilt_sentence(stage: Stage) -> str:
    path = _path(stage)
    angles = np.rad2deg(np.arccos(np.clip(-(path.directions @ stage.front.view.toward), -1.0, 1.0)))
    told = []
    for kind, name in ((ROW, "row points"), (FEATURE, "feature points")):
        tilts = angles[path.kinds == kind]
        if len(tilts):
            told.append(f"{name} {np.median(tilts):.0f}° (at most {tilts.max():.0f}°)")
    return f"Median angle between view direction and the part's mean normal: {', '.join(told)}."


def _point_handles(path: ScanPath) -> list[Artist]:
    handles = [
        *_kind_handles(path),
        Line2D(
            [], [], linestyle="none", marker="x", color=palette.FAINT, markersize=5,
            label="target on the surface",
        ),
    ]  # fmt: skip
    if path.row_points:
        handles.append(
            Line2D([], [], color=palette.ROW_POINT, linewidth=0.8, label="row, in its order")
        )
    return handles


def _kind_handles(path: ScanPath) -> list[Artist]:
    handles: list[Artist] = []
    for count, colour, marker, name in (
        (path.row_points, palette.ROW_POINT, "o", "row point"),
        (path.feature_points, palette.FEATURE_POINT, "^", "feature point"),
    ):
        if count:
            handles.append(
                Line2D([], [], linestyle="none", marker=marker, color=colour, label=name)
            )
    return handles


def _row_handles(path: ScanPath) -> list[Artist]:
    handles: list[Artist] = [
        Line2D([], [], color=palette.series(2 * parity), marker="o", markersize=3.2, label=name)
        for parity, name in enumerate(("row (colours alternate)", "next row"))
    ]
    return handles + _kind_handles(path)[1:]
