"""Where a surface ends: holes, open cracks, T-junctions, edges with too many faces."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from skinplan.mesh.doctor.patient import Patient, places, summed
from skinplan.mesh.model import Finding
from skinplan.mesh.topology import Indices, components
from skinplan.transforms import Array

_SLIT_RATIO = 1e-5  # width over the part's size: 30 um of 3 m is no hole
_ON_EDGE_RATIO = 1e-5
_MOST_PAIRS = 5_000_000


@dataclass(frozen=True, eq=False)
class Loops:
    """The closed runs of edges with one face only.

    Attributes:
        parts: The part that each belongs to, shape (l,).
        lengths: shape (l,) [m].
        areas: Area of what each spans, as a vector sum, shape (l,) [m^2].
        middles: Means of their vertices, shape (l, 3) [m].
        spans: Twice the largest distance of a vertex from the middle, shape (l,) [m].
    """

    parts: Indices
    lengths: Array
    areas: Array
    middles: Array
    spans: Array


def boundary_loops(patient: Patient) -> Loops:
    """Finds the loops; those that touch at a vertex count as one."""
    runs, mesh = patient.boundary_runs, patient.mesh
    ends, ranks = np.unique(runs, return_inverse=True)
    ranks = ranks.reshape(-1, 2)
    count, labels = components(len(ends), ranks)
    points = mesh.vertices[ends]
    middles = (
        summed(labels, points, count) / np.maximum(np.bincount(labels, minlength=count), 1)[:, None]
    )
    loop = labels[ranks[:, 0]]
    first = mesh.vertices[runs[:, 0]] - middles[loop]
    second = mesh.vertices[runs[:, 1]] - middles[loop]
    spans = np.zeros(count)
    np.maximum.at(spans, labels, 2 * np.linalg.norm(points - middles[labels], axis=1))
    parts = np.zeros(count, dtype=np.int64)
    single = patient.edges.face_counts[patient.edges.of_faces] == 1
    parts[loop] = np.repeat(patient.parts[1], single.sum(axis=1))
    return Loops(
        parts=parts,
        lengths=summed(loop, np.linalg.norm(second - first, axis=1), count),
        areas=np.linalg.norm(summed(loop, np.cross(first, second) / 2, count), axis=1),
        middles=middles,
        spans=spans,
    )


def note_holes(patient: Patient, findings: list[Finding]) -> None:
    """Notes holes and open cracks; the longest loop of each part is its outer edge."""
    loops = boundary_loops(patient)
    inner = np.ones(len(loops.parts), dtype=bool)
    order = np.lexsort((-loops.spans, loops.parts))
    outer = order[np.unique(loops.parts[order], return_index=True)[1]]
    inner[outer] = False
    width = 2 * loops.areas / np.maximum(loops.lengths, np.finfo(float).tiny)
    slit = inner & (width < _SLIT_RATIO * patient.size)
    hole = inner & ~slit
    if hole.any():
        largest = np.flatnonzero(hole)[np.argmax(loops.spans[hole])]
        detail = (
            f"the largest is {loops.spans[largest] * 1e3:.3g} mm across and has "
            f"{loops.areas[largest] * 1e4:.3g} cm2; rows stop at holes wider than half a row "
            "interval"
        )
        where = places(loops.middles[hole], loops.spans[hole])
        findings.append(Finding("holes", int(hole.sum()), "noted", detail, where))
    if slit.any():
        where = places(loops.middles[slit], loops.lengths[slit])
        detail = f"edges that meet without being joined, {loops.lengths[slit].sum() / 2:.3g} m long"
        findings.append(Finding("open cracks", int(slit.sum()), "noted", detail, where))


def note_crowded_edges(patient: Patient, findings: list[Finding]) -> None:
    """Notes edges with more than two faces."""
    crowded = patient.edges.vertices[patient.edges.face_counts > 2]
    if len(crowded):
        where = places(patient.mesh.vertices[crowded].mean(axis=1))
        detail = "edges with more than two faces"
        findings.append(Finding("non-manifold edges", len(crowded), "noted", detail, where))


def note_t_junctions(patient: Patient, findings: list[Finding]) -> None:
    """Notes vertices that lie on an edge without being joined to it."""
    runs, mesh = patient.boundary_runs, patient.mesh
    rim = np.unique(runs)
    if len(rim) == 0:
        return
    edges, points = _near(patient, runs, rim)
    start, along = mesh.vertices[runs[edges, 0]], mesh.vertices[runs[edges, 1]]
    along = along - start
    place = mesh.vertices[points] - start
    square = np.maximum(np.einsum("ij,ij->i", along, along), np.finfo(float).tiny)
    share = np.einsum("ij,ij->i", place, along) / square
    beside = np.linalg.norm(place - share[:, None] * along, axis=1)
    tolerance = _ON_EDGE_RATIO * patient.size
    inside = (share * np.sqrt(square) > tolerance) & ((1 - share) * np.sqrt(square) > tolerance)
    found = np.unique(points[inside & (beside <= tolerance)])
    if len(found):
        where = places(mesh.vertices[found])
        detail = "vertices lie on an open edge without being joined to it"
        findings.append(Finding("T-junctions", len(found), "noted", detail, where))


def _near(patient: Patient, runs: Indices, rim: Indices) -> tuple[Indices, Indices]:
    """Returns pairs of an edge and a vertex of the rim inside the ball about the edge."""
    ends = patient.mesh.vertices[runs]
    # A little wider, so that the ends themselves are surely inside.
    radius = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) * 0.51
    tree = cKDTree(patient.mesh.vertices[rim])
    middles = ends.mean(axis=1)
    counts = tree.query_ball_point(middles, radius, return_length=True)
    # A few very long edges beside very many vertices are left out rather than run out of memory.
    counts = np.where(counts > _MOST_PAIRS // 10, 0, counts)
    asked = np.flatnonzero((counts > 2) & (np.cumsum(counts) <= _MOST_PAIRS))
    if len(asked) == 0:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    found = tree.query_ball_point(middles[asked], radius[asked])
    edges = np.repeat(asked, [len(group) for group in found])
    return edges, rim[np.concatenate([np.asarray(group, dtype=np.int64) for group in found])]
