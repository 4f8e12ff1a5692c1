"""Cuts a mesh by parallel planes into polylines (M2.2 step 3)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from skinplan.mesh.model import SurfaceMesh
from skinplan.scan_path.frame import RowFrame
from skinplan.transforms import Array

Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Polylines:
    """Intersection curves. The points of a curve follow one another.

    Attributes:
        points: shape (n, 3) [m].
        normals: Unit normals of the smoothed surface there, shape (n, 3).
        faces: Face between each point and the next of its curve, shape (n,); -1 at the end of a
            curve.
        planes: Number of the cutting plane, shape (n,).
        starts: Index of the first point of each curve, and n at the end, shape (c + 1,).
    """

    points: Array
    normals: Array
    faces: Indices
    planes: Indices
    starts: Indices


def cut_mesh(
    mesh: SurfaceMesh, normals: Array, use: NDArray[np.bool_], frame: RowFrame, offsets: Array
) -> Polylines:
    """Intersects a mesh with the planes ``across . p = offset``.

    Args:
        mesh: The mesh.
        normals: Normals at its vertices, shape (v, 3).
        use: Which faces to cut, shape (f,).
        frame: Row frame; curves run toward ``along``.
        offsets: Rising plane offsets, shape (m,) [m].

    Returns:
        The curves, by plane, then by where they start along the rows.
    """
    heights = mesh.vertices @ frame.across
    pair_face, pair_plane, edge_low, edge_high = _crossings(mesh.faces, heights, use, offsets)
    if len(pair_face) == 0:
        empty = np.zeros(0, dtype=np.int64)
        return Polylines(
            np.zeros((0, 3)), np.zeros((0, 3)), empty, empty, np.zeros(1, dtype=np.int64)
        )
    # A node is where a plane crosses an edge of the mesh; both faces at the edge share it.
    size = len(mesh.vertices)
    keys = ((pair_plane[:, None] * size) + edge_low) * size + edge_high
    nodes, ends = np.unique(keys, return_inverse=True)
    ends = ends.reshape(keys.shape)
    plane, low, high = nodes // (size * size), nodes // size % size, nodes % size
    share = ((offsets[plane] - heights[low]) / (heights[high] - heights[low]))[:, None]
    points = (1 - share) * mesh.vertices[low] + share * mesh.vertices[high]
    blended = (1 - share) * normals[low] + share * normals[high]
    blended /= np.maximum(np.linalg.norm(blended, axis=1, keepdims=True), 1e-12)
    order, face_after = _chained(ends, pair_face, points @ frame.along)
    return _ordered(
        Polylines(
            points[order], blended[order], face_after, plane[order], np.zeros(0, dtype=np.int64)
        ),
        frame,
    )


def _crossings(
    faces: Indices, heights: Array, use: NDArray[np.bool_], offsets: Array
) -> tuple[Indices, Indices, Indices, Indices]:
    """Finds which faces are crossed by which planes.

    Returns:
        For each crossing: face, plane, and the lower and the higher vertices of the two crossed
        edges, shape (k, 2).
    """
    # The number of planes at or below a vertex; a face is crossed by those between its corners. A
    # vertex on a plane counts as above it: every crossed face then has exactly two crossed edges.
    below = np.searchsorted(offsets, heights, side="right").astype(np.int32)
    first, second, third = (below[corner] for corner in faces.T)
    lowest = np.minimum(np.minimum(first, second), third)
    counts = np.maximum(np.maximum(first, second), third) - lowest
    crossed = np.flatnonzero((counts > 0) & use)
    counts = counts[crossed].astype(np.int64)
    face = np.repeat(crossed, counts)
    skipped = np.cumsum(counts) - counts
    plane = np.arange(len(face)) - np.repeat(skipped - lowest[crossed], counts)
    corners = faces[face]
    above = below[corners] > plane[:, None]
    following = corners[:, [1, 2, 0]]
    crossing = above != above[:, [1, 2, 0]]
    low = np.minimum(corners, following)[crossing].reshape(-1, 2)
    high = np.maximum(corners, following)[crossing].reshape(-1, 2)
    return face, plane, low, high


def _chained(ends: Indices, face: Indices, along: Array) -> tuple[Indices, Indices]:
    """Puts nodes into the order of their curves.

    Args:
        ends: The two nodes of each segment, shape (k, 2).
        face: Face of each segment, shape (k,).
        along: Place of each node along the rows, shape (n,).

    Returns:
        Nodes in order, shape (n,), and the face between each and the next, -1 where a curve ends,
        shape (n,).
    """
    count = len(along)
    degree = np.bincount(ends.ravel(), minlength=count)
    links = sparse.coo_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    found, labels = csgraph.connected_components(links, directed=False)
    # Every curve is entered at its end that comes first along the rows; a closed one at its first
    # point.
    ranking = np.lexsort((along, degree != 1, labels))
    entries = ranking[np.searchsorted(labels[ranking], np.arange(found))]
    # One more node in front of all curves: a single walk then visits them one after the other.
    rows = np.concatenate([ends[:, 0], np.full(found, count)])
    columns = np.concatenate([ends[:, 1], entries])
    graph = sparse.coo_matrix(
        (np.ones(len(rows)), (rows, columns)), shape=(count + 1, count + 1)
    ).tocsr()
    walk, _ = csgraph.depth_first_order(graph, count, directed=False)
    order = walk[walk != count].astype(np.int64)
    segments = np.sort(ends, axis=1) @ np.array([count, 1])
    by_key = np.argsort(segments, kind="stable")
    steps = np.stack([order[:-1], order[1:]], axis=1)
    wanted = np.sort(steps, axis=1) @ np.array([count, 1])
    place = np.minimum(np.searchsorted(segments[by_key], wanted), len(segments) - 1)
    joined = segments[by_key][place] == wanted
    return order, np.append(np.where(joined, face[by_key][place], -1), -1)


def _ordered(lines: Polylines, frame: RowFrame) -> Polylines:
    """Sorts curves by plane and start, each running toward ``along``."""
    ends = np.flatnonzero(lines.faces < 0)
    begins = np.append(0, ends[:-1] + 1)
    along = lines.points @ frame.along
    backward = along[begins] > along[ends]
    curve_order = np.lexsort((np.minimum(along[begins], along[ends]), lines.planes[begins]))
    lengths = (ends - begins + 1)[curve_order]
    starts = np.append(0, np.cumsum(lengths))
    within = np.arange(len(along)) - np.repeat(starts[:-1], lengths)
    turned = np.repeat(backward[curve_order], lengths)
    picked = np.where(
        turned,
        np.repeat(ends[curve_order], lengths) - within,
        np.repeat(begins[curve_order], lengths) + within,
    )
    # Backward, the face after a point is the one that was before it.
    faces = np.where(turned, lines.faces[np.maximum(picked - 1, 0)], lines.faces[picked])
    faces[starts[1:] - 1] = -1
    return Polylines(
        lines.points[picked], lines.normals[picked], faces, lines.planes[picked], starts
    )
