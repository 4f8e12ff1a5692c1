"""Curvature of a triangle mesh."""

import numpy as np

from skinplan.mesh.model import SurfaceMesh
from skinplan.transforms import Array


def curvature_tensors(mesh: SurfaceMesh) -> Array:
    """Finds how the normal turns over each face.

    The vertex normals are taken as linear over a face; their gradient, symmetric and in the face's
    plane, is the curvature tensor. Its eigenvalues in the plane are the principal curvatures.

    Args:
        mesh: The mesh.

    Returns:
        The six values xx, yy, zz, xy, xz, yz per face, shape (f, 6) [1/m].
    """
    normals = mesh.vertex_normals[mesh.faces]
    corners = mesh.corners
    unit = mesh.face_normals
    doubled = np.maximum(2 * mesh.face_areas, 1e-18)[:, None]
    gradient = np.zeros((len(mesh.faces), 3, 3))
    for corner in range(3):
        opposite = corners[:, (corner + 2) % 3] - corners[:, (corner + 1) % 3]
        slope = np.cross(unit, opposite) / doubled
        gradient += normals[:, corner, :, None] * slope[:, None, :]
    # Remove what points out of the plane, then make it symmetric.
    gradient -= unit[:, :, None] * np.einsum("fi,fij->fj", unit, gradient)[:, None, :]
    xx, yy, zz = gradient[:, 0, 0], gradient[:, 1, 1], gradient[:, 2, 2]
    xy = (gradient[:, 0, 1] + gradient[:, 1, 0]) / 2
    xz = (gradient[:, 0, 2] + gradient[:, 2, 0]) / 2
    yz = (gradient[:, 1, 2] + gradient[:, 2, 1]) / 2
    return np.stack([xx, yy, zz, xy, xz, yz], axis=1)


def largest_curvature(tensors: Array) -> Array:
    """Finds the principal curvature of the largest magnitude.

    Args:
        tensors: As `curvature_tensors` returns them, shape (n, 6) [1/m].

    Returns:
        Magnitudes, shape (n,) [1/m].
    """
    trace = tensors[:, :3].sum(axis=1)
    squares = (tensors[:, :3] ** 2).sum(axis=1) + 2 * (tensors[:, 3:] ** 2).sum(axis=1)
    # One eigenvalue is 0 (along the normal), so that trace and sum of squares give the other two.
    return (np.abs(trace) + np.sqrt(np.maximum(2 * squares - trace**2, 0.0))) / 2


def vertex_curvatures(mesh: SurfaceMesh) -> Array:
    """Returns the area-weighted mean curvature tensor around each vertex, shape (v, 6) [1/m]."""
    weighted = curvature_tensors(mesh) * mesh.face_areas[:, None]
    areas = np.bincount(
        mesh.faces.ravel(), weights=np.repeat(mesh.face_areas, 3), minlength=len(mesh.vertices)
    )
    sums = np.stack(
        [
            np.bincount(
                mesh.faces.ravel(), weights=np.repeat(column, 3), minlength=len(mesh.vertices)
            )
            for column in weighted.T
        ],
        axis=1,
    )
    return sums / np.maximum(areas, 1e-18)[:, None]
