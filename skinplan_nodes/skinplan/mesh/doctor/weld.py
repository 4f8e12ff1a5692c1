"""Cracks: vertices that should be one, but differ by the noise of rounded numbers."""

import numpy as np
from scipy.spatial import cKDTree

from skinplan.mesh.doctor.patient import Patient, places
from skinplan.mesh.model import Finding, SurfaceMesh
from skinplan.mesh.topology import Indices, components
from skinplan.transforms import Array

#: Vertices on the boundary within this share of the part's size are one.
WELD_RATIO = 1e-6
# A chain of vertices, each near the next, is no rounding noise.
_LONGEST_CHAIN = 4.0


def weld_cracks(patient: Patient, findings: list[Finding]) -> Patient:
    """Makes one vertex of boundary vertices within `WELD_RATIO` of the part's size.

    The new vertex is their mean: nothing moves by more than four times that tolerance.
    """
    mesh, tolerance = patient.mesh, WELD_RATIO * patient.size
    rim = np.unique(patient.edges.boundary)
    if len(rim) == 0 or tolerance == 0:
        return patient
    labels = _clusters(mesh.vertices[rim], tolerance)
    sizes = np.bincount(labels)
    if sizes.max() == 1:
        return patient
    target = np.arange(len(mesh.vertices))
    heads = np.full(len(sizes), len(mesh.vertices))
    np.minimum.at(heads, labels, rim)
    target[rim] = heads[labels]
    welded = sizes > 1
    vertices = mesh.vertices.copy()
    for axis in range(3):
        sums = np.bincount(labels, weights=mesh.vertices[rim, axis])
        vertices[heads[welded], axis] = (sums / sizes)[welded]
    count = int((sizes[welded] - 1).sum())
    detail = f"vertices closer than {tolerance * 1e6:.2g} um on open edges were made one"
    where = places(vertices[heads[welded]])
    findings.append(Finding("cracks", count, "repaired", detail, where))
    changed = SurfaceMesh(vertices, target[mesh.faces], mesh.sha256)
    return patient.with_mesh(changed).keeping(np.ones(len(mesh.faces), dtype=bool))


def _clusters(points: Array, tolerance: float) -> Indices:
    """Returns for each point, shape (n, 3), the number of its cluster, shape (n,)."""
    # Points in one small cell are taken together first: no crowd can make the pairs explode.
    cells = np.floor((points - points.min(axis=0)) * (4.0 / tolerance))
    _, first, cell = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    pairs = cKDTree(points[first]).query_pairs(tolerance, output_type="ndarray")
    if len(pairs) == 0 and len(first) == len(points):
        return np.arange(len(points))
    count, of_cells = components(len(first), pairs.astype(np.int64))
    labels = of_cells[cell.reshape(-1)]
    return _without_chains(points, labels, count, _LONGEST_CHAIN * tolerance)


def _without_chains(points: Array, labels: Indices, count: int, longest: float) -> Indices:
    """Takes clusters apart that are longer than a limit."""
    sizes = np.maximum(np.bincount(labels, minlength=count), 1)
    middles = np.stack(
        [np.bincount(labels, weights=axis, minlength=count) / sizes for axis in points.T], axis=1
    )
    radius = np.zeros(count)
    np.maximum.at(radius, labels, np.linalg.norm(points - middles[labels], axis=1))
    loose = radius[labels] > longest / 2
    apart = labels.copy()
    apart[loose] = count + np.arange(np.count_nonzero(loose))
    _, numbered = np.unique(apart, return_inverse=True)
    return numbered.reshape(-1).astype(np.int64)
