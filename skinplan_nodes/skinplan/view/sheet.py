"""The page of a picture: title, panels with axes in metres, legend, caption.

Every block has its own strip of the page, so that no text lies on another. Figures are made without
any global state of matplotlib.
"""

import textwrap
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from io import BytesIO

import numpy as np
from matplotlib import patheffects
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from skinplan.view import palette
from skinplan.view.face_classes import FaceClasses

WIDTH_PX = 1600
_DPI = 100
_FONT_PT = 11.0
_SIDE_PX = 95
_RIGHT_PX = 30
_GAP_PX = 110
_TITLE_PX = 62
_PANEL_TITLE_PX = 38
_LINE_PX = 21
_AXIS_PX = 70
_LEGEND_ROW_PX = 28
_CAPTION_ROW_PX = 23
_BOTTOM_PX = 18
_FOOT_GAP_PX = 12
_MOST_PANEL_PX = 1000
_LETTER_PX = 8.6
_TITLE_LETTER_PX = 9.6
_HANDLE_PX = 62
_MOST_ENTRIES = 14


@dataclass(frozen=True)
class Panel:
    """One pair of axes.

    Attributes:
        title: What it shows.
        extent: Left, right, bottom, top of its window [m].
        draw: Draws into the axes.
        labels: Of the two axes.
        height_px: None = both axes to one scale; else a chart of this height [px] whose window is
            in any units.
    """

    title: str
    extent: tuple[float, float, float, float]
    draw: Callable[[Axes], None]
    labels: tuple[str, str] = ("along the part [m]", "across the part [m]")
    height_px: float | None = None

    @property
    def ratio(self) -> float:
        """Height by width of a panel to scale; 0 for a chart."""
        left, right, bottom, top = self.extent
        return 0.0 if self.height_px is not None else (top - bottom) / (right - left)

    def height(self, width_px: float) -> float:
        """Returns the height of the axes [px] when they are so wide."""
        return self.height_px if self.height_px is not None else width_px * self.ratio


@dataclass(frozen=True)
class Page:
    """A whole picture.

    Attributes:
        title: Headline.
        panels: Wide ones stand one above the other, narrow ones in pairs.
        legend: Handles with labels.
        caption: Sentences below the legend.
        small: Further panels, below, two or three beside each other.
        columns: How many of the panels stand beside each other; None = as their shape suggests.
    """

    title: str
    panels: tuple[Panel, ...]
    legend: Sequence[Artist] = field(default_factory=tuple)
    caption: str = ""
    small: tuple[Panel, ...] = ()
    columns: int | None = None


def draw_page(page: Page) -> Figure:
    """Lays a page out and draws it.

    Args:
        page: What is on it, at least one panel.

    Returns:
        The figure, 1600 px wide.
    """
    rows = _rows(page)
    legend_columns, legend_rows = _legend_shape(page.legend)
    lines = textwrap.wrap(page.caption, 180)
    below = _LEGEND_ROW_PX * legend_rows + _CAPTION_ROW_PX * len(lines) + _BOTTOM_PX + _FOOT_GAP_PX
    total = _TITLE_PX + sum(row.whole for row in rows) + below
    figure = Figure(figsize=(WIDTH_PX / _DPI, total / _DPI), dpi=_DPI, facecolor="white")
    FigureCanvasAgg(figure)
    figure.text(
        _SIDE_PX / WIDTH_PX, 1 - 34 / total, page.title, fontsize=16, weight="bold", va="center",
        color=palette.INK, parse_math=False,
    )  # fmt: skip
    top = total - _TITLE_PX
    for row in rows:
        top -= row.head + row.height
        for column, (panel, title) in enumerate(zip(row.panels, row.titles, strict=True)):
            left = _SIDE_PX + column * (row.width + _GAP_PX)
            box = (left / WIDTH_PX, top / total, row.width / WIDTH_PX, row.height / total)
            _draw_panel(figure, panel, title, box)
        top -= _AXIS_PX
    _draw_foot(figure, page.legend, legend_columns, lines, total)
    return figure


def png(figure: Figure) -> bytes:
    """Returns a figure as the bytes of a PNG file."""
    stream = BytesIO()
    figure.savefig(stream, format="png", dpi=_DPI)
    return stream.getvalue()


def show_image(
    axes: Axes, image: NDArray[np.uint8], extent: tuple[float, float, float, float]
) -> None:
    """Puts an image, shape (rows, columns, 4), into its window [m]."""
    axes.imshow(image, extent=extent, interpolation="antialiased", zorder=1)


def outlined(
    axes: Axes, u: float, v: float, text: str, lift_pt: float = 0.0, fontsize: float = 12.0
) -> None:
    """Writes text with a white outline, centred on a place [m] or some points above it."""
    written = axes.annotate(
        text, (u, v), (0.0, lift_pt), textcoords="offset points", ha="center", va="center",
        fontsize=fontsize, weight="bold", color=palette.INK, zorder=9, annotation_clip=True,
    )  # fmt: skip
    written.set_path_effects([patheffects.withStroke(linewidth=3, foreground="white")])


def class_handles(classes: FaceClasses, shown: Iterable[int]) -> list[Artist]:
    """Returns the legend of face classes; a long list is cut short.

    Args:
        classes: The classes.
        shown: Numbers of those that the legend explains.
    """
    handles: list[Artist] = [
        Patch(
            facecolor=tuple(classes.colours[number]),
            edgecolor=palette.FAINT,
            linewidth=0.5,
            label=classes.names[number],
        )
        for number in sorted(shown)
    ]
    if len(handles) <= _MOST_ENTRIES:
        return handles
    more = len(handles) - _MOST_ENTRIES
    return [*handles[:_MOST_ENTRIES], Line2D([], [], linestyle="none", label=f"and {more} more")]


@dataclass(frozen=True)
class _Row:
    """Panels beside each other; all sizes in pixels."""

    panels: tuple[Panel, ...]
    titles: tuple[str, ...]
    width: float
    height: float
    head: float

    @property
    def whole(self) -> float:
        return self.head + self.height + _AXIS_PX


def _rows(page: Page) -> list[_Row]:
    wide = page.columns or (2 if len(page.panels) > 1 and page.panels[0].ratio > 0.6 else 1)
    narrow = 2 if len(page.small) in (1, 2, 4) else 3
    result = []
    for panels, columns in ((page.panels, wide), (page.small, narrow)):
        width = (WIDTH_PX - _SIDE_PX - _RIGHT_PX - (columns - 1) * _GAP_PX) / columns
        for start in range(0, len(panels), columns):
            row = panels[start : start + columns]
            titles = tuple(_wrapped(panel.title, width) for panel in row)
            height = min(max(panel.height(width) for panel in row), _MOST_PANEL_PX)
            head = _PANEL_TITLE_PX + _LINE_PX * max(title.count("\n") for title in titles)
            result.append(_Row(row, titles, width, height, head))
    return result


def _draw_panel(
    figure: Figure, panel: Panel, title: str, box: tuple[float, float, float, float]
) -> None:
    axes = figure.add_axes(box, anchor="NW")
    left, right, bottom, top = panel.extent
    axes.set_aspect("equal" if panel.height_px is None else "auto", adjustable="box")
    panel.draw(axes)
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    axes.set_title(title, fontsize=12.5, loc="left", pad=8, color=palette.INK)
    axes.set_xlabel(panel.labels[0], fontsize=_FONT_PT, color=palette.INK)
    axes.set_ylabel(panel.labels[1], fontsize=_FONT_PT, color=palette.INK)
    axes.tick_params(labelsize=10, colors=palette.INK)
    for spine in axes.spines.values():
        spine.set_color(palette.FAINT)


def _wrapped(title: str, width_px: float) -> str:
    return "\n".join(textwrap.wrap(title, int(width_px // _TITLE_LETTER_PX)))


def _draw_foot(
    figure: Figure, legend: Sequence[Artist], columns: int, lines: list[str], total: float
) -> None:
    if legend:
        labels = [str(handle.get_label()) for handle in legend]
        bottom = _BOTTOM_PX + _CAPTION_ROW_PX * len(lines) + _FOOT_GAP_PX
        figure.legend(
            handles=list(legend), labels=labels, loc="lower left", ncols=columns, frameon=False,
            fontsize=_FONT_PT, borderaxespad=0, borderpad=0, handlelength=2.2, columnspacing=1.8,
            labelspacing=0.45, bbox_to_anchor=(_SIDE_PX / WIDTH_PX, bottom / total),
            labelcolor=palette.INK,
        )  # fmt: skip
    for number, line in enumerate(reversed(lines)):
        height = (_BOTTOM_PX + _CAPTION_ROW_PX * number) / total
        figure.text(
            _SIDE_PX / WIDTH_PX, height, line, fontsize=10.5, color=palette.FAINT, va="bottom",
            parse_math=False,
        )  # fmt: skip


def _legend_shape(legend: Sequence[Artist]) -> tuple[int, int]:
    """Returns how many columns of entries fit beside each other, and the rows that they need."""
    if not legend:
        return 1, 0
    longest = max(len(str(handle.get_label())) for handle in legend)
    fit = int((WIDTH_PX - _SIDE_PX - _RIGHT_PX) // (longest * _LETTER_PX + _HANDLE_PX))
    columns = min(max(fit, 1), len(legend))
    return columns, -(-len(legend) // columns)
