"""Finds the complex regions of a part by region growing on curvature (M2.2 step 2)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from skinplan.errors import MeshEmptyError, MeshNotFiniteError
from skinplan.mesh.axes import own_axes
from skinplan.mesh.curvature import largest_curvature, vertex_curvatures
from skinplan.mesh.model import Segmentation, SurfaceMesh
from skinplan.mesh.smooth import Smoother, smooth_both
from skinplan.mesh.topology import EdgeTable, Mask, components, edge_table, parts_of
from skinplan.transforms import Array

# Points on the outline of a core stand at most this share of the dilation apart.
_OUTLINE_RATIO = 0.2
# Cells along the longest side of the sieve that comes before distances are measured.
_MOST_CELLS = 200


@dataclass(frozen=True)
class SegmentSettings:
    """Figures of the segmentation; all are lengths, areas and curvatures, none counts triangles.

    Attributes:
        smooth_m: Details much smaller than this are smoothed away first [m].
        blur_m: Curvature is averaged over a bell of this standard deviation [m].
        seed_1_m: A region starts where the curvature exceeds this [1/m].
        grow_1_m: ... and grows as long as it exceeds this [1/m].
        dilate_m: Then it is widened by this [m].
        least_area_m2: Smaller regions, before they are widened, are no features [m^2].
        largest_hole_m2: Smaller flat islands inside a region belong to it [m^2].
    """

    smooth_m: float = 0.006
    blur_m: float = 0.0085
    seed_1_m: float = 10.0
    grow_1_m: float = 3.0
    dilate_m: float = 0.030
    least_area_m2: float = 0.0015
    largest_hole_m2: float = 0.12


def segment_mesh(mesh: SurfaceMesh, settings: SegmentSettings = SegmentSettings()) -> Segmentation:
    """Splits a part into the flat continuous surface and the complex regions.

    Args:
        mesh: A checked mesh.
        settings: Figures.

    Returns:
        The region of each face, numbered along the longest axis of the part, and the smoothed mesh.

    Raises:
        MeshEmptyError: No faces.
        MeshNotFiniteError: A vertex is NaN or infinite.
    """
    if len(mesh.faces) == 0:
        raise MeshEmptyError("the mesh has no faces; a mesh with at least one face is accepted")
    if not np.isfinite(mesh.vertices).all():
        raise MeshNotFiniteError(
            "the mesh has vertices that are NaN or infinite; finite numbers are accepted"
        )
    edges = edge_table(mesh.faces)
    smoother = Smoother(mesh, edges)
    smoothed, rounded = smooth_both(mesh, settings.smooth_m, smoother)
    tensors = vertex_curvatures(rounded, settings.blur_m, smoother, edges)
    level = _core_level(largest_curvature(tensors), mesh, edges, settings)
    wide = _dilated(level, mesh, edges, settings.dilate_m)
    filled = _filled(wide, mesh, edges, settings.largest_hole_m2)
    return Segmentation(_numbered(filled, mesh, edges), smoothed)


def _core_level(
    curvature: Array, mesh: SurfaceMesh, edges: EdgeTable, settings: SegmentSettings
) -> Array:
    """Finds the parts above the growing threshold that are large enough and hold a seed.

    Returns:
        Curvature above the threshold, positive in those parts only, shape (v,) [1/m]. Linear over
        the faces, it says where inside a face the outline runs.
    """
    level = curvature - settings.grow_1_m
    inside = np.flatnonzero(level > 0)
    rank = np.cumsum(level > 0) - 1
    joined = edges.vertices[(level[edges.vertices] > 0).all(axis=1)]
    found, labels = components(len(inside), rank[joined])
    label = np.full(len(level), -1)
    label[inside] = labels
    seeds = np.bincount(labels, weights=curvature[inside] > settings.seed_1_m, minlength=found)
    # The vertices of a face that are above the threshold belong to one part.
    touched = np.flatnonzero(_any_corner(level > 0, mesh))
    corners = mesh.faces[touched]
    areas = np.bincount(
        label[corners].max(axis=1),
        weights=mesh.face_areas[touched] * _positive_share(level[corners]),
        minlength=found,
    )
    kept = (seeds > 0) & (areas >= settings.least_area_m2)
    below = np.minimum(level, -1e-12)
    return np.where((label >= 0) & np.append(kept, False)[label], level, below)


def _positive_share(levels: Array) -> Array:
    """Returns the share of each triangle's area where a linear function is positive.

    Args:
        levels: The function at the corners, shape (n, 3).

    Returns:
        Shares, shape (n,).
    """
    low, middle, high = np.sort(levels, axis=1).T
    with np.errstate(divide="ignore", invalid="ignore"):
        top = high**2 / ((high - low) * (high - middle))
        bottom = low**2 / ((high - low) * (middle - low))
    partly = np.where(middle <= 0, top, 1 - bottom)
    return np.where(low > 0, 1.0, np.where(high <= 0, 0.0, partly))


def _outline(level: Array, mesh: SurfaceMesh, step_m: float) -> Array:
    """Returns points on the lines where the level is zero, at most a step apart, shape (n, 3)."""
    above = level > 0
    crossed = mesh.faces[_any_corner(above, mesh) & _any_corner(~above, mesh)]
    starts, ends = crossed, crossed[:, [1, 2, 0]]
    cut = above[starts] != above[ends]
    # Every such face has two cut sides.
    a, b = starts[cut], ends[cut]
    share = (level[a] / (level[a] - level[b]))[:, None]
    points = ((1 - share) * mesh.vertices[a] + share * mesh.vertices[b]).reshape(-1, 2, 3)
    lengths = np.linalg.norm(points[:, 1] - points[:, 0], axis=1)
    counts = np.ceil(lengths / step_m).astype(np.int64) + 1
    number = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    along = (number / np.repeat(np.maximum(counts - 1, 1), counts))[:, None]
    first, last = np.repeat(points[:, 0], counts, axis=0), np.repeat(points[:, 1], counts, axis=0)
    return (1 - along) * first + along * last


def _dilated(level: Array, mesh: SurfaceMesh, edges: EdgeTable, distance_m: float) -> Mask:
    """Adds the faces within a distance of the core, as far as they hang together with it."""
    if not (level > 0).any():
        return np.zeros(len(mesh.faces), dtype=bool)
    core = sum(level[corner] for corner in mesh.faces.T) > 0
    outline = _outline(level, mesh, _OUTLINE_RATIO * distance_m)
    wide = core.copy()
    if len(outline):
        open_ = np.flatnonzero(~core)
        open_ = open_[_in_cells_around(outline, mesh.centroids[open_], distance_m)]
        near, _ = cKDTree(outline).query(mesh.centroids[open_], distance_upper_bound=distance_m)
        wide[open_] = np.isfinite(near)
    found, labels = parts_of(wide, edges.pairs)
    touching = _any_corner(level > 0, mesh)
    held = np.bincount(labels, weights=touching[wide], minlength=found) > 0
    result = np.zeros(len(core), dtype=bool)
    result[wide] = held[labels]
    return result


def _any_corner(vertices: Mask, mesh: SurfaceMesh) -> Mask:
    """Says which faces have a corner among some vertices, shape (f,)."""
    first, second, third = (vertices[corner] for corner in mesh.faces.T)
    return first | second | third


def _in_cells_around(points: Array, places: Array, reach_m: float) -> Mask:
    """Says which places may be within reach of a point: a quick sieve, shape (n,)."""
    low = np.minimum(points.min(axis=0), places.min(axis=0)) - reach_m
    high = np.maximum(points.max(axis=0), places.max(axis=0)) + reach_m
    size = max(reach_m, float(np.max(high - low)) / _MOST_CELLS)
    taken = np.zeros(np.floor((high - low) / size).astype(np.int64) + 1, dtype=bool)
    taken[tuple(((points - low) / size).astype(np.int64).T)] = True
    around = ndimage.binary_dilation(taken, np.ones((3, 3, 3), dtype=bool))
    return around[tuple(((places - low) / size).astype(np.int64).T)]


def _filled(regions: Mask, mesh: SurfaceMesh, edges: EdgeTable, largest_m2: float) -> Mask:
    """Adds flat islands: small, and without an edge of the part."""
    if not regions.any():
        return regions
    flat = ~regions
    found, labels = parts_of(flat, edges.pairs)
    areas = np.bincount(labels, weights=mesh.face_areas[flat], minlength=found)
    outer = np.zeros(len(mesh.vertices), dtype=bool)
    outer[edges.boundary] = True
    touching = np.bincount(labels, weights=_any_corner(outer, mesh)[flat], minlength=found) > 0
    result = regions.copy()
    result[flat] = ((areas < largest_m2) & ~touching)[labels]
    return result


def _numbered(regions: Mask, mesh: SurfaceMesh, edges: EdgeTable) -> NDArray[np.int64]:
    """Numbers the regions from 1 along the part's own longest axis; 0 elsewhere."""
    if not regions.any():
        return np.zeros(len(regions), dtype=np.int64)
    found, labels = parts_of(regions, edges.pairs)
    areas = mesh.face_areas[regions]
    weights = np.maximum(np.bincount(labels, weights=areas, minlength=found), 1e-18)
    axes = own_axes(mesh.centroids, mesh.face_areas)
    along = np.eye(3)[np.argmax(np.ptp(mesh.vertices, axis=0))] if axes is None else axes[0]
    places = mesh.centroids[regions] @ along
    middles = np.bincount(labels, weights=areas * places, minlength=found) / weights
    rank = np.empty(found, dtype=np.int64)
    rank[np.argsort(middles, kind="stable")] = np.arange(1, found + 1)
    numbers = np.zeros(len(regions), dtype=np.int64)
    numbers[regions] = rank[labels]
    return numbers
