"""What a scan path sees beside what row cutting alone sees (Fig. 21 of M)."""

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import FancyBboxPatch

from skinplan.scanner.facet_states import facet_states
from skinplan.scanner.model import Coverage
from skinplan.transforms import Array
from skinplan.view import palette
from skinplan.view.camera import ParallelView
from skinplan.view.face_classes import FaceClasses, Hole, coverage_classes, holes
from skinplan.view.sheet import Page, Panel, class_handles, draw_page, outlined, show_image
from skinplan.view.stage import Stage

_RELIEF = 0.25
_MOST_FRAMES = 60
_MOST_LABELS = 6
_FRAME_PX = 9.0
# Room that a label needs, across and up; twice for panels of half width.
_LABEL_PX = (160.0, 44.0)


def coverage_figure(stage: Stage) -> Figure:
    """Draws the coverage of the scan path and that of row cutting, holes marked.

    Args:
        stage: The part and its views; the subject has coverage.
    """
    subject = stage.subject
    own = "scan path" if subject.path is None else f"strategy {subject.path.strategy}"
    named = ((own, subject.coverage), ("row cutting alone", subject.rows_only))
    given = [(name, coverage) for name, coverage in named if coverage is not None]
    classes = [coverage_classes(coverage, stage.display) for _, coverage in given]
    found = [holes(coverage) for _, coverage in given]
    panels = tuple(
        _panel(stage, coverage_title(name, coverage), face_classes, marked)
        for (name, coverage), face_classes, marked in zip(given, classes, found, strict=True)
    )
    present = {number for each in classes for number in each.present}
    legend: list[Artist] = class_handles(classes[0], present)
    if any(found):
        legend.append(_frame_handle(max(len(marked) for marked in found) > _MOST_FRAMES))
    told = [
        holes_sentence(name, coverage, marked)
        for (name, coverage), marked in zip(given, found, strict=True)
    ]
    caption = " ".join([*told, _meaning(stage)])
    return draw_page(Page(f"{subject.part_id}: predicted coverage", panels, legend, caption))


def coverage_title(name: str, coverage: Coverage) -> str:
    """Returns the shares of a coverage as the title of its panel."""
    weights, least = coverage.samples.weights, coverage.least_views
    often = float(weights[coverage.views >= least].sum() / weights.sum())
    feature = coverage.feature_area_ratio
    features = "" if np.isnan(feature) else f", {percent(feature)} of the feature area"
    return (
        f"{name}: {percent(coverage.area_ratio)} of the area{features} seen; "
        f"{percent(often)} seen {least} times or more"
    )


def holes_sentence(name: str, coverage: Coverage, found: tuple[Hole, ...]) -> str:
    """Returns how many holes there are and why, one sentence."""
    if not found:
        return f"{name[0].upper()}{name[1:]}: no holes."
    unseen = coverage.views == 0
    areas = np.bincount(coverage.sights[unseen], weights=coverage.samples.weights[unseen])
    names = facet_states(coverage).names
    reasons = ", ".join(
        f"{names[code]} {1e4 * areas[code]:.1f} cm²" for code in np.flatnonzero(areas)
    )
    count = f"{len(found)} hole{'' if len(found) == 1 else 's'}"
    return f"{name[0].upper()}{name[1:]}: {count} ({reasons})."


def percent(ratio: float) -> str:
    """Returns a share as text; only what is complete reads 100.00 %."""
    return f"{np.floor(1e4 * ratio + 1e-6) / 100:.2f} %"


def _panel(stage: Stage, title: str, classes: FaceClasses, found: tuple[Hole, ...]) -> Panel:
    raster = stage.front
    image = stage.image(raster, classes.face_colours, _RELIEF)

    def draw(axes: Axes) -> None:
        show_image(axes, image, raster.view.extent)
        _mark_holes(axes, stage, found)

    return Panel(title, raster.view.extent, draw)


def _mark_holes(axes: Axes, stage: Stage, found: tuple[Hole, ...]) -> None:
    view = stage.front.view
    # The raster is finer than the picture.
    pixel = 2 * view.pixel_m
    edge = _FRAME_PX * pixel
    labels: list[tuple[float, float]] = []
    for hole in found[:_MOST_FRAMES]:
        flat = view.plane(hole.points)
        low, high = flat.min(axis=0), flat.max(axis=0)
        axes.add_patch(_frame(low, high, edge))
        middle = float(0.5 * (low[0] + high[0]))
        end, lift = _label_place(low[1], high[1], edge, _LABEL_PX[1] * pixel, view)
        apart = all(
            abs(u - middle) > _LABEL_PX[0] * pixel or abs(v - end) > _LABEL_PX[1] * pixel
            for u, v in labels
        )
        if apart and len(labels) < _MOST_LABELS:
            labels.append((middle, float(end)))
            outlined(axes, middle, end, f"{1e4 * hole.area_m2:.1f} cm²", lift, fontsize=10)


def _label_place(
    low: float, high: float, edge: float, room: float, view: ParallelView
) -> tuple[float, float]:
    """Returns the height [m] that a label belongs to and how far above it [pt] it stands."""
    if high + edge + 1.2 * room < view.bottom + view.height_m:
        return high + edge, 11.0
    if low - edge - 1.2 * room > view.bottom:
        return low - edge, -11.0
    return high + edge, -11.0


def _frame(low: Array, high: Array, edge: float) -> FancyBboxPatch:
    return FancyBboxPatch(
        (low[0], low[1]), high[0] - low[0], high[1] - low[1],
        boxstyle=f"round,pad={edge},rounding_size={0.9 * edge}", fill=False,
        edgecolor=palette.HOLE_FRAME, linewidth=1.2, zorder=5,
    )  # fmt: skip


def _meaning(stage: Stage) -> str:
    scanner = stage.subject.scanner
    if scanner is None:
        return ""
    return (
        f"Seen means: in the field of view ({scanner.field}, radius "
        f"{1000 * scanner.field_radius_m:.0f} mm, {1000 * scanner.range_min_m:.0f} to "
        f"{1000 * scanner.range_max_m:.0f} mm), at most "
        f"{np.rad2deg(scanner.incidence_max_rad):.0f}° between view axis and surface normal, "
        "not hidden."
    )


def _frame_handle(too_many: bool) -> Line2D:
    which = f"one of the {_MOST_FRAMES} largest holes" if too_many else "a hole"
    return Line2D(
        [], [], linestyle="none", marker="s", markersize=11, markerfacecolor="none",
        markeredgecolor=palette.HOLE_FRAME, markeredgewidth=1.4,
        label=f"frame around {which}, some with their area",
    )  # fmt: skip
