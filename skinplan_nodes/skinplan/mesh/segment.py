"""Finds the complex regions of a part by region growing on curvature (M2.2 step 2)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skinplan.errors import MeshEmptyError
from skinplan.mesh.curvature import largest_curvature, vertex_curvatures
from skinplan.mesh.model import Segmentation, SurfaceMesh
from skinplan.mesh.smooth import Smoother, smooth_both
from skinplan.mesh.topology import EdgeTable, Mask, edge_table, parts_of


@dataclass(frozen=True)
class SegmentSettings:
    """Figures of the segmentation; all are lengths, areas and curvatures, none counts triangles.

    Attributes:
        smooth_m: Details much smaller than this are smoothed away first [m].
        seed_1_m: A region starts where the curvature exceeds this [1/m].
        grow_1_m: ... and grows as long as it exceeds this [1/m].
        dilate_m: Then it is widened by this [m].
        least_area_m2: Smaller regions, before they are widened, are no features [m^2].
        largest_hole_m2: Smaller flat islands inside a region belong to it [m^2].
    """

    smooth_m: float = 0.006
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
    """
    if len(mesh.faces) == 0:
        raise MeshEmptyError("the mesh has no faces; a mesh with at least one face is accepted")
    edges = edge_table(mesh.faces)
    smoother = Smoother(mesh, edges)
    smoothed, rounded = smooth_both(mesh, settings.smooth_m, smoother)
    tensors = smoother.smooth(vertex_curvatures(rounded), settings.smooth_m, fix_boundary=False)
    curvature = largest_curvature(tensors)[mesh.faces].mean(axis=1)
    core = _grown(curvature, mesh, edges, settings)
    wide = _dilated(core, mesh, edges, settings.dilate_m)
    filled = _filled(wide, mesh, edges, settings.largest_hole_m2)
    return Segmentation(_numbered(filled, mesh, edges), smoothed)


def _grown(
    curvature: NDArray[np.float64], mesh: SurfaceMesh, edges: EdgeTable, settings: SegmentSettings
) -> Mask:
    """Finds the parts above the growing threshold that are large enough and hold a seed."""
    curved = curvature > settings.grow_1_m
    found, labels = parts_of(curved, edges.pairs)
    seeds = np.bincount(labels, weights=curvature[curved] > settings.seed_1_m, minlength=found)
    areas = np.bincount(labels, weights=mesh.face_areas[curved], minlength=found)
    kept = np.zeros(len(curvature), dtype=bool)
    kept[curved] = ((seeds > 0) & (areas >= settings.least_area_m2))[labels]
    return kept


def _dilated(core: Mask, mesh: SurfaceMesh, edges: EdgeTable, distance_m: float) -> Mask:
    """Adds the faces within a distance, as far as they hang together with the core."""
    if not core.any():
        return core
    near, _ = cKDTree(mesh.centroids[core]).query(mesh.centroids, distance_upper_bound=distance_m)
    wide = core | np.isfinite(near)
    found, labels = parts_of(wide, edges.pairs)
    held = np.bincount(labels, weights=core[wide], minlength=found) > 0
    result = np.zeros(len(core), dtype=bool)
    result[wide] = held[labels]
    return result


def _filled(regions: Mask, mesh: SurfaceMesh, edges: EdgeTable, largest_m2: float) -> Mask:
    """Adds flat islands: small, and without an edge of the part."""
    if not regions.any():
        return regions
    flat = ~regions
    found, labels = parts_of(flat, edges.pairs)
    areas = np.bincount(labels, weights=mesh.face_areas[flat], minlength=found)
    outer = np.zeros(len(mesh.vertices), dtype=bool)
    outer[edges.boundary] = True
    touching = np.bincount(labels, weights=outer[mesh.faces[flat]].any(axis=1), minlength=found) > 0
    result = regions.copy()
    result[flat] = ((areas < largest_m2) & ~touching)[labels]
    return result


def _numbered(regions: Mask, mesh: SurfaceMesh, edges: EdgeTable) -> NDArray[np.int64]:
    found, labels = parts_of(regions, edges.pairs)
    areas = mesh.face_areas[regions]
    weights = np.maximum(np.bincount(labels, weights=areas, minlength=found), 1e-18)
    axis = int(np.argmax(np.ptp(mesh.vertices, axis=0)))
    middles = (
        np.bincount(labels, weights=areas * mesh.centroids[regions][:, axis], minlength=found)
        / weights
    )
    rank = np.empty(found, dtype=np.int64)
    rank[np.argsort(middles, kind="stable")] = np.arange(1, found + 1)
    numbers = np.zeros(len(regions), dtype=np.int64)
    numbers[regions] = rank[labels]
    return numbers
