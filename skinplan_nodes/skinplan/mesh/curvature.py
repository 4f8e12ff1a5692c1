"""Curvature of a triangle mesh."""

import numpy as np

from skinplan.mesh.model import SurfaceMesh
from skinplan.mesh.smooth import Smoother
from skinplan.mesh.topology import EdgeTable
from skinplan.transforms import Array

# A mesh measures curvature as through a blur: its variance per direction over the mean squared edge
# of a triangle.
_BLUR_RATIO = 1 / 6
# Every vertex sees at least this share of the variance that was asked for.
_LEAST_SHARE = 0.1


def edge_curvatures(mesh: SurfaceMesh, edges: EdgeTable) -> Array:
    """Finds how much the surface turns at the edges, summed at the vertices.

    A mesh is flat but for its edges: there the normal turns by the dihedral angle, across the edge.
    Angle times length times the square of the direction across, half to each end: divided by area
    this is the curvature tensor of the surface (convex positive), whatever the triangles' shape.

    Args:
        mesh: The mesh.
        edges: Its edges.

    Returns:
        The six values xx, yy, zz, xy, xz, yz per vertex, shape (v, 6) [m].
    """
    ends = edges.vertices[edges.face_counts == 2].T
    one, other = edges.pairs.T
    normals, centroids = mesh.face_normals, mesh.centroids
    turn, apart, both, side = [], [], [], []
    # Single coordinates one after the other: much faster than rows of three.
    for normal, centroid, vertex in zip(normals.T, centroids.T, mesh.vertices.T, strict=True):
        normal, centroid, vertex = (np.ascontiguousarray(c) for c in (normal, centroid, vertex))
        before, behind = normal[one], normal[other]
        turn.append(behind - before)
        both.append(behind + before)
        apart.append(centroid[other] - centroid[one])
        side.append(vertex[ends[1]] - vertex[ends[0]])
    sine = np.minimum(np.sqrt(_product(turn, turn)) / 2, 1.0)
    angle = 2 * np.arcsin(sine) * np.sign(_product(turn, apart))
    across = [
        side[1] * both[2] - side[2] * both[1],
        side[2] * both[0] - side[0] * both[2],
        side[0] * both[1] - side[1] * both[0],
    ]
    # |across| is the edge's length times that of the sum of the normals.
    squares = np.maximum(_product(across, across), 1e-30)
    weights = angle * np.sqrt(_product(side, side)) / squares / 2
    count = len(mesh.vertices)
    sums = np.empty((count, 6))
    for column, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))):
        amounts = weights * across[i] * across[j]
        sums[:, column] = np.bincount(ends[0], weights=amounts, minlength=count)
        sums[:, column] += np.bincount(ends[1], weights=amounts, minlength=count)
    return sums


def _product(first: list[Array], second: list[Array]) -> Array:
    """Returns scalar products of vectors given by their three coordinates, shape (n,)."""
    return first[0] * second[0] + first[1] * second[1] + first[2] * second[2]


def vertex_curvatures(
    mesh: SurfaceMesh, length_m: float, smoother: Smoother, edges: EdgeTable
) -> Array:
    """Returns the curvature tensor around each vertex, seen through a bell of a given width.

    Large triangles blur by themselves; what they do is taken off the bell.

    Args:
        mesh: The mesh.
        length_m: Standard deviation of the bell [m].
        smoother: The smoother of a mesh of the same faces.
        edges: Its edges.

    Returns:
        The six values xx, yy, zz, xy, xz, yz per vertex, shape (v, 6) [1/m].
    """
    sides = mesh.vertices[edges.vertices[:, 0]] - mesh.vertices[edges.vertices[:, 1]]
    lengths = np.einsum("ei,ei->e", sides, sides)
    squares = (lengths[edges.of_faces[:, 0]] + lengths[edges.of_faces[:, 1]]) / 3
    squares += lengths[edges.of_faces[:, 2]] / 3
    variances = np.maximum(length_m**2 - _BLUR_RATIO * squares, _LEAST_SHARE * length_m**2)
    return smoother.density(edge_curvatures(mesh, edges), variances)


def largest_curvature(tensors: Array) -> Array:
    """Finds the principal curvature of the largest magnitude.

    Args:
        tensors: As `vertex_curvatures` returns them, shape (n, 6) [1/m].

    Returns:
        Magnitudes, shape (n,) [1/m].
    """
    trace = tensors[:, :3].sum(axis=1)
    squares = (tensors[:, :3] ** 2).sum(axis=1) + 2 * (tensors[:, 3:] ** 2).sum(axis=1)
    # One eigenvalue is 0 (along the normal), so that trace and sum of squares give the other two.
    return (np.abs(trace) + np.sqrt(np.maximum(2 * squares - trace**2, 0.0))) / 2
