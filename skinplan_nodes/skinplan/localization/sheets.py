"""Printable sheets of markers at true scale, each with a ruler to check the print by."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from skinplan.errors import PartInvalidError
from skinplan.localization.detect import dictionary_of
from skinplan.part.model import Fixture, Marker

#: Paper in millimetres, upright, by rising size.
PAPERS_MM = {
    "A4": (210.0, 297.0),
    "A3": (297.0, 420.0),
    "A2": (420.0, 594.0),
    "A1": (594.0, 841.0),
    "A0": (841.0, 1189.0),
}
FORMATS = ("pdf", "svg")
# White border round the black square, in cells, and what the printer leaves white [mm].
_QUIET_CELLS, _RIM_MM = 1.0, 8.0
# Below the marker: text and ruler [mm].
_FOOT_MM = 34.0
_RULER_MM = 100.0
_INCH_MM = 25.4


@dataclass(frozen=True)
class Sheet:
    """One marker on one sheet; millimetres from the top left corner.

    Attributes:
        marker_id: Which marker.
        paper: Name of the paper.
        size_mm: Width and height of the sheet.
        side_mm: Side of the black square.
        black: Black rectangles (x, y, width, height): the cells of the marker.
        lines: Lines (x1, y1, x2, y2): ruler and corner marks.
        texts: Texts (x, y, height, text); x is their middle.
    """

    marker_id: int
    paper: str
    size_mm: tuple[float, float]
    side_mm: float
    black: tuple[tuple[float, float, float, float], ...]
    lines: tuple[tuple[float, float, float, float], ...]
    texts: tuple[tuple[float, float, float, str], ...]


def marker_sheet(fixture: Fixture, marker: Marker, paper: str = "") -> Sheet:
    """Lays out the sheet of one marker.

    Args:
        fixture: Its dictionary counts.
        marker: The marker.
        paper: Name of the paper; empty = the smallest that the marker fits on.

    Raises:
        PartInvalidError: An unknown paper, or one that is too small.
    """
    cells = _cells(fixture.dictionary, marker.id)
    count = len(cells)
    side = 1e3 * marker.size_m
    cell = side / count
    least = side + 2.0 * (_QUIET_CELLS * cell + _RIM_MM)
    paper = paper.upper() or _smallest(least, marker)
    if paper not in PAPERS_MM:
        raise PartInvalidError(
            f"paper {paper!r} was asked for; accepted are {', '.join(PAPERS_MM)}"
        )
    width, height = PAPERS_MM[paper]
    if least > width or least + _FOOT_MM > height:
        raise PartInvalidError(
            f"marker {marker.id} of {side:g} mm needs a sheet of {least:.0f} x "
            f"{least + _FOOT_MM:.0f} mm with its white border, {paper} has {width:g} x {height:g} "
            f"mm; a larger paper is accepted"
        )
    left = 0.5 * (width - side)
    top = 0.5 * (height - _FOOT_MM - side)
    black = tuple(
        (left + column * cell, top + row * cell, cell, cell)
        for row, column in np.argwhere(~cells).tolist()
    )
    foot = top + side + _QUIET_CELLS * cell + 5.0
    ruler_y = foot + 18.0
    return Sheet(
        marker.id,
        paper,
        (width, height),
        side,
        black,
        _ruler(0.5 * (width - _RULER_MM), ruler_y),
        (
            (0.5 * width, foot + 4.0, 4.0, f"{fixture.dictionary}  id {marker.id}  this side down"),
            (0.5 * width, foot + 10.0, 3.0, f"black square {side:g} mm; print at 100 %"),
            (0.5 * width, ruler_y + 8.0, 3.0, f"check: {_RULER_MM:g} mm from end to end"),
        ),
    )


def write_sheets(sheets: list[Sheet], folder: Path, kind: str) -> list[Path]:
    """Writes sheets: one SVG file each, or one PDF with a page each.

    Raises:
        PartInvalidError: The format is unknown, or the files can't be written.
    """
    if kind not in FORMATS:
        raise PartInvalidError(f"format {kind!r} was asked for; accepted are {', '.join(FORMATS)}")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if kind == "pdf":
            return [_write_pdf(sheets, folder / "markers.pdf")]
        paths = [folder / f"marker_{sheet.marker_id}.svg" for sheet in sheets]
        for sheet, path in zip(sheets, paths, strict=True):
            path.write_text(svg(sheet), encoding="utf-8")
    except OSError as error:
        raise PartInvalidError(
            f"marker sheets can't be written to {folder}: {error.strerror}"
        ) from error
    return paths


def svg(sheet: Sheet) -> str:
    """Returns a sheet as SVG; one unit is one millimetre."""
    width, height = sheet.size_mm
    # One path: cells that touch each other have no seam between them.
    cells = " ".join(f"M{x:.6g} {y:.6g}h{w:.6g}v{h:.6g}h{-w:.6g}z" for x, y, w, h in sheet.black)
    lines = " ".join(f"M{a:.6g} {b:.6g}L{c:.6g} {d:.6g}" for a, b, c, d in sheet.lines)
    texts = "".join(
        f'<text x="{x:.6g}" y="{y:.6g}" font-size="{size:.6g}" text-anchor="middle" '
        f'font-family="sans-serif">{text}</text>\n'
        for x, y, size, text in sheet.texts
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm" '
        f'viewBox="0 0 {width:g} {height:g}">\n<rect width="{width:g}" height="{height:g}" '
        f'fill="#fff"/>\n<path d="{cells}" fill="#000"/>\n'
        f'<path d="{lines}" stroke="#000" stroke-width="0.2" fill="none"/>\n{texts}</svg>\n'
    )


def _write_pdf(sheets: list[Sheet], path: Path) -> Path:
    # Loading it takes long, and SVG does not need it.
    from matplotlib.backends.backend_pdf import PdfPages
    from matplotlib.figure import Figure
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    with PdfPages(path) as pages:
        for sheet in sheets:
            width, height = sheet.size_mm
            figure = Figure(figsize=(width / _INCH_MM, height / _INCH_MM))
            axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
            axes.set(xlim=(0.0, width), ylim=(height, 0.0))
            axes.axis("off")
            cells = Outline.make_compound_path(
                *(
                    Outline([(x, y), (x + w, y), (x + w, y + h), (x, y + h), (x, y)], closed=True)
                    for x, y, w, h in sheet.black
                )
            )
            axes.add_patch(PathPatch(cells, facecolor="black", linewidth=0.0))
            for x1, y1, x2, y2 in sheet.lines:
                axes.plot([x1, x2], [y1, y2], color="black", linewidth=0.2 / _INCH_MM * 72.0)
            for x, y, size, text in sheet.texts:
                axes.text(x, y, text, fontsize=size / _INCH_MM * 72.0, ha="center")
            pages.savefig(figure)
    return path


def _cells(dictionary: str, marker_id: int) -> NDArray[np.bool_]:
    """Returns the cells of a marker with its border, True = white."""
    book = dictionary_of(dictionary)
    image = cv2.aruco.generateImageMarker(book, marker_id, book.markerSize + 2, borderBits=1)
    return np.asarray(image > 127)


def _smallest(least_mm: float, marker: Marker) -> str:
    for name, (width, height) in PAPERS_MM.items():
        if least_mm <= width and least_mm + _FOOT_MM <= height:
            return name
    raise PartInvalidError(
        f"marker {marker.id} of {1e3 * marker.size_m:g} mm fits on no paper up to A0; "
        f"{PAPERS_MM['A0'][0] - 40.0:.0f} mm are accepted"
    )


def _ruler(left: float, y: float) -> tuple[tuple[float, float, float, float], ...]:
    ticks = [
        (left + at, y, left + at, y - (4.0 if at % 50 == 0 else 2.5 if at % 10 == 0 else 1.5))
        for at in range(0, int(_RULER_MM) + 1, 5)
    ]
    return ((left, y, left + _RULER_MM, y), *ticks)
