"""Which faces and vertices of a mesh hang together."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from skinplan.mesh.model import SurfaceMesh

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class EdgeTable:
    """The edges of a mesh.

    Attributes:
        vertices: The two ends of each edge, the smaller number first, shape (e, 2).
        face_counts: Number of faces at each edge, shape (e,).
        pairs: Faces that share an edge with exactly two faces, shape (p, 2).
        same_winding: Whether the two faces of a pair are wound alike, shape (p,).
        of_faces: Numbers of the edges of each face, shape (f, 3): from corner 0 to corner 1, from 1
            to 2, from 2 to 0.
    """

    vertices: Indices
    face_counts: Indices
    pairs: Indices
    same_winding: Mask
    of_faces: Indices

    @property
    def boundary(self) -> Indices:
        """Edges with one face only, shape (b, 2)."""
        return self.vertices[self.face_counts == 1]


def edge_table(faces: Indices) -> EdgeTable:
    """Finds the edges of faces, shape (f, 3)."""
    begin, end = faces.ravel(), faces[:, [1, 2, 0]].ravel()
    low, high = np.minimum(begin, end), np.maximum(begin, end)
    order, starts = _grouped(low, high, int(faces.max(initial=-1)) + 1)
    counts = np.diff(starts, append=len(order))
    of_faces = np.empty(len(order), dtype=np.int64)
    of_faces[order] = np.repeat(np.arange(len(starts)), counts)
    two = starts[counts == 2]
    # Within an edge the sides stand in no particular order.
    first = np.minimum(order[two], order[two + 1])
    second = np.maximum(order[two], order[two + 1])
    return EdgeTable(
        vertices=np.stack([low[order[starts]], high[order[starts]]], axis=1),
        face_counts=counts,
        pairs=np.stack([first // 3, second // 3], axis=1),
        # Neighbours wound alike run along their common edge in opposite directions.
        same_winding=(begin[first] == low[first]) != (begin[second] == low[second]),
        of_faces=of_faces.reshape(-1, 3),
    )


def _grouped(low: Indices, high: Indices, count: int) -> tuple[Indices, Indices]:
    """Sorts pairs of numbers below a count; returns their order and where each new pair starts."""
    sides = sparse.coo_array(
        (np.arange(len(low)), (low.astype(np.int32), high.astype(np.int32))), shape=(count, count)
    )
    # Said to have no duplicates, it keeps them when it is put into rows: sorting in linear time.
    sides.has_canonical_format = True
    rows = sides.tocsr()
    rows.has_sorted_indices = False
    rows.sort_indices()
    new = np.ones(len(low), dtype=bool)
    new[1:] = rows.indices[1:] != rows.indices[:-1]
    begins = rows.indptr[:-1]
    new[begins[begins < len(low)]] = True
    return rows.data, np.flatnonzero(new)


def components(count: int, pairs: Indices) -> tuple[int, Indices]:
    """Finds what hangs together.

    Args:
        count: Number of nodes.
        pairs: Joined nodes, shape (p, 2).

    Returns:
        Number of components, and the component of each node, shape (count,).
    """
    graph = sparse.coo_matrix(
        (np.ones(len(pairs), dtype=bool), (pairs[:, 0], pairs[:, 1])), shape=(count, count)
    )
    found, labels = csgraph.connected_components(graph, directed=False)
    return int(found), labels.astype(np.int64)


def parts_of(mask: Mask, pairs: Indices) -> tuple[int, Indices]:
    """Finds what hangs together among the faces of a mask.

    Args:
        mask: shape (f,).
        pairs: Neighbouring faces, shape (p, 2).

    Returns:
        Number of connected parts, and for each face of the mask the number of its part from 0,
        shape (m,).
    """
    inside = np.flatnonzero(mask)
    rank = np.cumsum(mask) - 1
    return components(len(inside), rank[pairs[mask[pairs].all(axis=1)]])


def compact(mesh: SurfaceMesh, keep: Mask) -> SurfaceMesh:
    """Returns the mesh with only the faces of a mask, shape (f,), and the vertices they use."""
    faces = mesh.faces[keep]
    used = np.zeros(len(mesh.vertices), dtype=bool)
    used[faces] = True
    return SurfaceMesh(mesh.vertices[used], (np.cumsum(used) - 1)[faces], mesh.sha256)


def winding_signs(faces: int, edges: EdgeTable) -> NDArray[np.int64]:
    """Says which faces to turn so that all of a connected part are wound alike.

    Args:
        faces: Number of faces.
        edges: Their edges.

    Returns:
        +1 or -1 per face, shape (faces,); +1 for one face of each connected part.
    """
    found, labels = components(faces, edges.pairs)
    roots = np.full(found, faces, dtype=np.int64)
    np.minimum.at(roots, labels, np.arange(faces))
    # One more node, tied to one face of every part, makes a single tree of all parts.
    ties = np.stack([np.full(found, faces), roots], axis=1)
    links = np.concatenate([edges.pairs, ties])
    alike = np.concatenate([edges.same_winding, np.ones(found, dtype=bool)])
    rows, columns = links.T
    shape = (faces + 1, faces + 1)
    graph = sparse.coo_matrix((np.ones(len(links)), (rows, columns)), shape=shape)
    turned = sparse.coo_matrix((np.where(alike, 0.0, 1.0), (rows, columns)), shape=shape).tocsr()
    turned = turned.maximum(turned.T)
    _, parents = csgraph.breadth_first_order(graph.tocsr(), faces, directed=False)
    parents = parents.astype(np.int64)
    parents[faces] = faces
    signs = 1 - 2 * np.asarray(turned[np.arange(faces + 1), parents]).ravel().astype(np.int64)
    # Follow the tree to its root in doubling steps.
    while np.any(parents != faces):
        signs = signs * signs[parents]
        parents = parents[parents]
    return signs[:faces]
