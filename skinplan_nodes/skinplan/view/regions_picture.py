"""The mesh with its complex regions, its edges and what the mesh doctor found."""

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy import ndimage

from skinplan.mesh.model import Finding, SurfaceMesh
from skinplan.mesh.topology import components, edge_table
from skinplan.transforms import Array
from skinplan.view import palette
from skinplan.view.face_classes import FaceClasses, region_classes
from skinplan.view.sheet import Page, Panel, class_handles, draw_page, outlined, show_image
from skinplan.view.stage import Stage

# Labels are placed on every fourth pixel.
_COARSE = 4
_FINDING_MARK = {
    "linestyle": "none",
    "marker": "D",
    "markersize": 9,
    "markerfacecolor": "none",
    "markeredgecolor": palette.INK,
    "markeredgewidth": 1.6,
}


def regions_figure(stage: Stage) -> Figure:
    """Draws the mesh from the front, complex regions coloured and numbered.

    Args:
        stage: The part and its views.
    """
    subject, raster = stage.subject, stage.front
    classes = region_classes(subject.mesh, subject.segmentation)
    image = stage.image(raster, classes.of(stage.display).face_colours)
    outline, inner = boundary_edges(subject.mesh)
    places = np.array([place for found in subject.findings for place in found.where]).reshape(-1, 3)

    def draw(axes: Axes) -> None:
        show_image(axes, image, raster.view.extent)
        for edges, colour, width in (
            (outline, palette.OUTLINE, 1.2),
            (inner, palette.HOLE_EDGE, 2.0),
        ):
            flat = raster.view.plane(edges.reshape(-1, 3)).reshape(-1, 2, 2)
            axes.add_collection(
                LineCollection(list(flat), colors=[colour], linewidths=width, zorder=4)
            )
        if len(places):
            flat = raster.view.plane(places)
            axes.plot(*flat.T, **_FINDING_MARK, zorder=8)  # type: ignore[arg-type]
        for number, place in region_labels(stage, classes):
            outlined(axes, *place, str(number), fontsize=15)

    legend = class_handles(classes, range(len(classes.names)))
    legend += _edge_handles(bool(len(outline)), bool(len(inner)))
    if len(places):
        legend.append(Line2D([], [], **_FINDING_MARK, label="place of a finding"))  # type: ignore[arg-type]
    size = f"{len(subject.mesh.faces)} triangles, {subject.mesh.area:.3f} m²"
    count = subject.segmentation.regions
    title = f"{subject.part_id}: {count} complex region{'' if count == 1 else 's'}"
    panel = Panel(f"from the front; {size}", raster.view.extent, draw)
    return draw_page(Page(title, (panel,), legend, findings_sentence(subject.findings)))


def boundary_edges(mesh: SurfaceMesh) -> tuple[Array, Array]:
    """Splits the edges with one face into the outline and the edges of holes.

    Of each piece of the mesh that hangs together, the longest closed run of such edges counts as
    its outline.

    Args:
        mesh: The part.

    Returns:
        Ends of the edges of the outlines, shape (a, 2, 3), and of the holes, shape (b, 2, 3) [m].
    """
    edges = edge_table(mesh.faces).boundary
    if not len(edges):
        return np.zeros((0, 2, 3)), np.zeros((0, 2, 3))
    _, run = components(len(mesh.vertices), edges)
    _, piece = components(len(mesh.vertices), mesh.faces[:, [0, 1, 1, 2]].reshape(-1, 2))
    ends = mesh.vertices[edges]
    runs, number = np.unique(run[edges[:, 0]], return_inverse=True)
    lengths = np.bincount(number, weights=np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1))
    owner = np.zeros(len(runs), dtype=np.int64)
    owner[number] = piece[edges[:, 0]]
    order = np.lexsort((np.arange(len(runs)), -lengths, owner))
    longest = np.zeros(len(runs), dtype=bool)
    longest[order[np.flatnonzero(np.diff(owner[order], prepend=-1))]] = True
    outer = longest[number]
    return ends[outer], ends[~outer]


def region_labels(stage: Stage, classes: FaceClasses) -> list[tuple[int, tuple[float, float]]]:
    """Returns the numbers of the regions that can be seen, and where to write them [m].

    A number stands where its region is widest, as seen.

    Args:
        stage: The part and its views.
        classes: Classes of the part's faces; class 0 gets no number.
    """
    view = stage.front.view
    faces = stage.front.faces[::_COARSE, ::_COARSE]
    shown = np.where(faces >= 0, classes.codes[stage.display.parents[faces]], 0)
    labels = []
    for number in range(1, len(classes.names)):
        inside = np.pad(shown == number, 1)
        if inside.any():
            depth = ndimage.distance_transform_edt(inside)[1:-1, 1:-1]
            row, column = _COARSE * np.array(np.unravel_index(depth.argmax(), depth.shape))
            u = view.left + (column + 0.5) * view.pixel_m
            v = view.bottom + (view.rows - row - 0.5) * view.pixel_m
            labels.append((number, (float(u), float(v))))
    return labels


def findings_sentence(findings: tuple[Finding, ...]) -> str:
    """Returns what the mesh doctor found, one sentence."""
    if not findings:
        return "Mesh doctor: no findings."
    told = "; ".join(f"{finding.name} {finding.count} ({finding.action})" for finding in findings)
    return f"Mesh doctor: {told}."


def _edge_handles(outline: bool, inner: bool) -> list[Artist]:
    handles: list[Artist] = []
    if outline:
        handles.append(Line2D([], [], color=palette.OUTLINE, label="outline of the mesh"))
    if inner:
        handles.append(
            Line2D([], [], color=palette.HOLE_EDGE, linewidth=2, label="edge of a hole in the mesh")
        )
    return handles
