"""From samples to facets.

A facet with samples has the highest code of them: it counts as seen when all of it is seen. A facet
smaller than the sample spacing may have none: it has the code of the nearest sample whose normal is
within 60 degrees of its own, of the four nearest samples; without such, of the nearest.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skinplan.mesh.model import SurfaceMesh
from skinplan.transforms import Array

_NEIGHBOURS = 4
_LEAST_COSINE = 0.5


def facet_codes(
    mesh: SurfaceMesh,
    points: Array,
    normals: Array,
    faces: NDArray[np.int64],
    codes: NDArray[np.integer],
) -> NDArray[np.int8]:
    """Gives every facet a code.

    Args:
        mesh: The mesh.
        points: Samples, shape (s, 3) [m], at least one.
        normals: Their unit normals, shape (s, 3).
        faces: Their facets, shape (s,).
        codes: Their codes, from 0, shape (s,).

    Returns:
        Codes of the facets, shape (f,); -1 for all without any sample.
    """
    result = np.full(len(mesh.faces), -1, dtype=np.int8)
    if len(points) == 0:
        return result
    np.maximum.at(result, faces, codes.astype(np.int8))
    small = np.flatnonzero(result < 0)
    if len(small):
        near = _nearest_alike(mesh.centroids[small], mesh.face_normals[small], points, normals)
        result[small] = codes[near]
    return result


def _nearest_alike(
    places: Array, directions: Array, points: Array, normals: Array
) -> NDArray[np.int64]:
    """Returns the nearest sample of like normal for each place, shape (n,)."""
    count = min(_NEIGHBOURS, len(points))
    _, near = cKDTree(points).query(places, k=count)
    near = np.asarray(near, dtype=np.int64).reshape(-1, count)
    # The first of like normal; argmax is 0, the nearest, when there is none.
    alike = np.einsum("nkj,nj->nk", normals[near], directions) > _LEAST_COSINE
    return near[np.arange(len(near)), np.argmax(alike, axis=1)]
