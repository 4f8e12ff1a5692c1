"""The figures of a report as SVG: deviation, coverage, histogram, floor plan.

Text and lines take the page's colours.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from markupsafe import Markup, escape

from skinplan.errors import SkinplanError
from skinplan.inspection.raster import View, diverging, png_uri, value_image
from skinplan.inspection.run_files import RunFiles, items, number, section
from skinplan.transforms import Array, apply, transform

_WIDTH = 1000.0
# Room for the scale bar below a picture.
_BAR = 56.0
# Footprint of a MiR100, for the drawing only.
_BASE_M = (0.89, 0.58)
MISSING = (203, 62, 56)
MEASURED = (58, 124, 165)


def nice_limit(value: float) -> float:
    """Returns the next of 1, 2, 5 x 10^n from a value up."""
    if not (math.isfinite(value) and value > 0):
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(
        step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= value * (1 - 1e-9)
    )


def _tight_limit(value: float) -> float:
    """Returns a round number little above a value, so that the worst place has a strong colour."""
    power = 10.0 ** math.floor(math.log10(value))
    steps = (1.0, 1.2, 1.6, 2.0, 2.4, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
    return next(step * power for step in steps if step * power >= value * (1 - 1e-9))


def deviation_limit(deviation: Array) -> float:
    """Returns the end of the colour scale [m]: 99 % of the points lie inside it."""
    return nice_limit(max(float(np.percentile(np.abs(deviation), 99.0)), 2e-5))


def front_view(files: RunFiles) -> View | None:
    """Returns the window that all front views share; None = nothing to see."""
    clouds = [
        cloud.points
        for cloud in (files.cloud, files.coverage)
        if cloud is not None and len(cloud.points)
    ]
    targets = path_targets(files)
    clouds += [targets] if len(targets) else []
    return View.around(np.concatenate(clouds)) if clouds else None


def path_targets(files: RunFiles) -> Array:
    """Returns the surface points of the scan path, workpiece frame, shape (n, 3) [m]."""
    rows = [point.get("target") for point in items(files.path, "points")]
    good = [
        row
        for row in rows
        if isinstance(row, list) and len(row) == 3 and all(math.isfinite(number(v)) for v in row)
    ]
    return (
        np.array(good, dtype=float).reshape(-1, 3) if len(good) == len(rows) else np.zeros((0, 3))
    )


def deviation_figure(files: RunFiles, view: View) -> Markup | None:
    """Returns the part coloured by deviation with its colour bar; None = none is known.

    Local deviations where they are recorded, else those of the points; the worst place is ringed.
    """
    source, local = files.cloud, False
    if files.coverage is not None and "deviation" in files.coverage.values:
        source, local = files.coverage, True
    deviation = None if source is None else source.values.get("deviation")
    if source is None or deviation is None or not np.isfinite(deviation).any():
        return None
    known = np.isfinite(deviation)
    limit = deviation_limit(deviation[known])
    if local:
        limit = _tight_limit(max(float(np.abs(deviation[known]).max()), 2e-5))
    mean, shown = value_image(source.points[known], deviation[known], view)
    return _picture(
        view,
        png_uri(diverging(mean, limit), shown),
        _worst_ring(files, view) if local else "",
        _colour_bar(limit),
        "Deviation along the normal",
    )


def _worst_ring(files: RunFiles, view: View) -> str:
    at = section(section(files.summary, "inspection"), "whole").get("worst_at")
    if not isinstance(at, list) or len(at) != 3 or not all(math.isfinite(number(v)) for v in at):
        return ""
    scale = _WIDTH / view.width
    x, y = (at[0] - view.left) * scale, (view.bottom + view.height - at[1]) * scale
    side = "end" if x > _WIDTH / 2 else "start"
    beside = -30.0 if side == "end" else 30.0
    return (
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="24" class="ring-back"/>'
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="24" class="worst"/>'
        f'<text class="label worst-label" x="{x + beside:.1f}" y="{y:.1f}" dy="0.35em" '
        f'text-anchor="{side}">worst</text>'
    )


def coverage_figure(files: RunFiles, view: View) -> Markup | None:
    """Returns the part with measured and missing area, and the scan path over it.

    None = nothing to show.
    """
    samples = files.coverage
    image = ""
    if samples is not None and "measured" in samples.values and len(samples.points):
        mean, shown = value_image(samples.points, samples.values["measured"], view)
        image = png_uri(np.where(mean[..., None] >= 0.5, MEASURED, MISSING).astype(np.uint8), shown)
    elif files.cloud is not None and len(files.cloud.points):
        mean, shown = value_image(files.cloud.points, np.ones(len(files.cloud.points)), view)
        image = png_uri(np.broadcast_to(np.array(MEASURED, np.uint8), (*mean.shape, 3)), shown)
    overlay = _path_overlay(files, view)
    if not image and not overlay:
        return None
    return _picture(view, image, overlay, "", "Measured area and scan path")


def histogram_figure(deviation: Array) -> Markup | None:
    """Returns the histogram of deviations; None = there are none."""
    known = deviation[np.isfinite(deviation)]
    if len(known) == 0:
        return None
    limit = deviation_limit(known)
    counts, edges = np.histogram(np.clip(known, -limit, limit), bins=41, range=(-limit, limit))
    colours = diverging((edges[:-1] + edges[1:]) / 2, limit)
    width, height = _WIDTH / len(counts), 180.0
    bars = [
        f'<rect x="{i * width + 1:.1f}" y="{height * (1 - count / counts.max()):.1f}" '
        f'width="{width - 2:.1f}" '
        f'height="{height * count / counts.max():.1f}" '
        f'fill="rgb({",".join(map(str, colours[i]))})">'
        f"<title>{edges[i] * 1e3:.3f} to {edges[i + 1] * 1e3:.3f} mm: {count} points</title></rect>"
        for i, count in enumerate(counts)
    ]
    labels = _ticks(limit, height + 6)
    line = f'<line x1="0" x2="{_WIDTH:.0f}" y1="{height}" y2="{height}" class="axis"/>'
    return _svg(_WIDTH, height + 54, "".join([*bars, line, labels]), "Histogram of the deviation")


def floor_figure(files: RunFiles) -> Markup | None:
    """Returns stations and part from above, map frame; None = no stations."""
    poses = [
        (s.get("id"), section(s, "pose"), s.get("points"))
        for s in items(files.stations, "stations")
    ]
    placed = [
        (
            name,
            np.array([number(p.get("x_m")), number(p.get("y_m")), number(p.get("heading_rad"))]),
            points,
        )
        for name, p, points in poses
    ]
    placed = [entry for entry in placed if np.all(np.isfinite(entry[1]))]
    if not placed:
        return None
    part = _part_on_floor(files)
    places = np.array([pose[:2] for _, pose, _ in placed])
    view = View.around(
        np.vstack([places - 0.6, places + 0.6, *([part] if len(part) else [])]), 0.04
    )
    scale = _WIDTH / view.width
    dots = "".join(
        f'<circle cx="{(x - view.left) * scale:.1f}" '
        f'cy="{(view.bottom + view.height - y) * scale:.1f}" r="3"/>'
        for x, y in part
    )
    height = view.height * scale
    drawn = [f'<g class="part">{dots}</g>', *(_station(entry, view, scale) for entry in placed)]
    return _svg(
        _WIDTH,
        height + _BAR,
        "".join([*drawn, _scale_bar(view, scale, height)]),
        "Stations from above",
    )


def _part_on_floor(files: RunFiles) -> Array:
    place = section(files.stations, "workpiece")
    position, turn = place.get("position_m"), place.get("quaternion")
    targets = path_targets(files)
    try:
        T_map_workpiece = transform(position or (), turn or ())
    except (SkinplanError, TypeError, ValueError):
        return np.zeros((0, 2))
    return apply(T_map_workpiece, targets)[:, :2]


def _station(entry: tuple[Any, Array, Any], view: View, scale: float) -> str:
    name, (x, y, heading), points = entry
    u, v = (x - view.left) * scale, (view.bottom + view.height - y) * scale
    length, width = _BASE_M[0] * scale, _BASE_M[1] * scale
    count = len(points) if isinstance(points, list) else 0
    return (
        f'<g transform="translate({u:.1f} {v:.1f})"><g '
        f'transform="rotate({-math.degrees(heading):.2f})">'
        f'<rect x="{-length / 2:.1f}" y="{-width / 2:.1f}" width="{length:.1f}" '
        f'height="{width:.1f}" rx="8" class="base"/>'
        f'<path d="M {length / 2 - 18:.1f} -9 l 14 9 l -14 9 z" class="nose"/></g>'
        f'<text class="label" text-anchor="middle" dy="-0.15em">station {escape(str(name))}</text>'
        f'<text class="small" text-anchor="middle" dy="1.05em">{count} points</text></g>'
    )


def _path_overlay(files: RunFiles, view: View) -> str:
    targets = path_targets(files)
    kinds = [str(point.get("kind")) for point in items(files.path, "points")]
    skipped = {s.get("point") for s in _skipped(files)}
    scale = _WIDTH / view.width
    marks = []
    for i, target in enumerate(targets):
        x, y = (target[0] - view.left) * scale, (view.bottom + view.height - target[1]) * scale
        if i in skipped:
            marks.append(
                f'<path d="M {x - 6:.1f} {y - 6:.1f} l 12 12 m 0 -12 l -12 12" class="skipped"/>'
            )
        else:
            kind = "feature" if kinds[i] == "feature" else "row"
            marks.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" class="{kind}"/>')
    return "".join(marks)


def _skipped(files: RunFiles) -> list[dict[str, Any]]:
    listed = items(section(files.summary, "trajectory"), "skipped")
    return listed or items(files.stations, "skipped")


def _picture(view: View, image: str, overlay: str, below: str, title: str) -> Markup:
    scale = _WIDTH / view.width
    height = view.height * scale
    parts = [f'<rect width="{_WIDTH:.0f}" height="{height:.1f}" rx="8" class="plot"/>']
    if image:
        parts.append(
            f'<image width="{_WIDTH:.0f}" height="{height:.1f}" preserveAspectRatio="none" '
            f'href="{image}"/>'
        )
    parts += [overlay, _scale_bar(view, scale, height)]
    if below:
        parts.append(f'<g transform="translate(0 {height + _BAR:.1f})">{below}</g>')
    return _svg(_WIDTH, height + _BAR + (68.0 if below else 0.0), "".join(parts), title)


def _colour_bar(limit: float) -> str:
    colours = diverging(np.linspace(-limit, limit, 100), limit)
    cells = "".join(
        f'<rect x="{i * _WIDTH / 100:.1f}" y="0" width="{_WIDTH / 100 + 0.5:.1f}" height="16" '
        f'fill="rgb({",".join(map(str, colour))})"/>'
        for i, colour in enumerate(colours)
    )
    return cells + _ticks(limit, 22)


def _ticks(limit: float, y: float) -> str:
    ends: Sequence[tuple[float, str]] = (
        (-1, "start"),
        (-0.5, "middle"),
        (0, "middle"),
        (0.5, "middle"),
        (1, "end"),
    )
    return "".join(
        f'<text class="label{" half" if abs(share) == 0.5 else ""}" '
        f'x="{(share + 1) / 2 * _WIDTH:.1f}" y="{y:.0f}" '
        f'dy="0.9em" text-anchor="{anchor}">'
        f"{share * limit * 1e3:+.3g}{' mm' if share == 1 else ''}</text>"
        for share, anchor in ends
    ).replace("+0<", "0<")


def _scale_bar(view: View, scale: float, top: float) -> str:
    length = nice_limit(view.width / 8)
    end = 8 + length * scale
    text = f"{length:g} m" if length >= 1 else f"{length * 1e3:g} mm"
    return (
        f'<path d="M 8 {top + 16:.1f} v 12 H {end:.1f} v -12" class="scale"/>'
        f'<text class="small" x="{end + 10:.1f}" y="{top + 8:.1f}" dy="0.85em">{text}</text>'
    )


def _svg(width: float, height: float, content: str, title: str) -> Markup:
    # Everything inside is made of numbers here; texts were escaped where they were put in.
    return Markup(  # noqa: S704
        f'<svg viewBox="0 0 {width:.0f} {height:.1f}" role="img" aria-label="{escape(title)}">'
        f"<title>{escape(title)}</title>{content}</svg>"
    )
