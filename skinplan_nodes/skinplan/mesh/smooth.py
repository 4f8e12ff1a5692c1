"""Smoothing by a physical length, whatever the size of the triangles."""

import math

import numpy as np
from scipy import sparse

from skinplan.mesh.model import SurfaceMesh
from skinplan.mesh.topology import EdgeTable, edge_table
from skinplan.transforms import Array

_MOST_STEPS = 400
_LARGEST_STEP = 0.5


class Smoother:
    """Diffuses values over a mesh, as heat would spread.

    After smoothing by a length s a single peak has spread to a bell of standard deviation s. Each
    step moves a vertex by a share of the way to the mean of its neighbours; share and number of
    steps follow from (s / edge length)^2, so that meshes of other triangle size come out alike.
    """

    def __init__(self, mesh: SurfaceMesh, edges: EdgeTable | None = None) -> None:
        """Prepares a mesh.

        Args:
            mesh: The mesh.
            edges: Its edges, when they are at hand.
        """
        table = edges or edge_table(mesh.faces)
        count = len(mesh.vertices)
        a, b = table.vertices.T
        squares = ((mesh.vertices[a] - mesh.vertices[b]) ** 2).sum(axis=1)
        rows, columns = np.concatenate([a, b]), np.concatenate([b, a])
        neighbours = np.maximum(np.bincount(rows, minlength=count), 1)
        self._square = np.bincount(rows, weights=np.tile(squares, 2), minlength=count) / neighbours
        self._mean = sparse.csr_matrix(
            (1.0 / neighbours[rows], (rows, columns)), shape=(count, count)
        )
        self._fixed = np.zeros(count, dtype=bool)
        self._fixed[table.vertices[table.face_counts != 2]] = True
        self._fixed |= np.bincount(rows, minlength=count) == 0

    def smooth(self, values: Array, length_m: float, fix_boundary: bool) -> Array:
        """Smooths values at the vertices.

        Args:
            values: shape (v, c).
            length_m: Standard deviation of the bell [m].
            fix_boundary: Leave the values at open and non-manifold edges as they are.

        Returns:
            Smoothed values, shape (v, c).
        """
        if length_m <= 0:
            return values.copy()
        # A step with share w widens the bell's variance per direction by w * edge^2 / 2.
        wanted = 2 * length_m**2 / np.maximum(self._square, 1e-12)
        steps = int(
            np.clip(math.ceil(float(np.quantile(wanted, 0.95)) / _LARGEST_STEP), 1, _MOST_STEPS)
        )
        share = np.minimum(wanted / steps, _LARGEST_STEP)
        if fix_boundary:
            share[self._fixed] = 0.0
        step = sparse.diags_array(share) @ self._mean + sparse.diags_array(1.0 - share)
        step = step.tocsr()
        result = values
        for _ in range(steps):
            result = step @ result
        return result


def smooth_mesh(
    mesh: SurfaceMesh, length_m: float = 0.006, smoother: Smoother | None = None
) -> SurfaceMesh:
    """Makes small features disappear and leaves large ones as steep as they are (M2.2 step 1).

    What diffusion took away is diffused too and given back (once): waves much longer than the
    length keep their height to second order, those much shorter vanish.

    Args:
        mesh: The mesh.
        length_m: Details much smaller than this vanish [m].
        smoother: The mesh's smoother, when it is at hand.

    Returns:
        A mesh with the same faces and moved vertices; open edges stay where they are.
    """
    return smooth_both(mesh, length_m, smoother or Smoother(mesh))[0]


def smooth_both(
    mesh: SurfaceMesh, length_m: float, smoother: Smoother
) -> tuple[SurfaceMesh, SurfaceMesh]:
    """Smooths a mesh to look at its slopes and, stronger, to look at its curvature.

    Args:
        mesh: The mesh.
        length_m: Details much smaller than this vanish [m].
        smoother: The mesh's smoother.

    Returns:
        The mesh of `smooth_mesh`, and the mesh diffused twice.
    """
    once = smoother.smooth(mesh.vertices, length_m, fix_boundary=True)
    twice = smoother.smooth(once, length_m, fix_boundary=True)
    steep = SurfaceMesh(once + (once - twice), mesh.faces, mesh.sha256)
    return steep, SurfaceMesh(twice, mesh.faces, mesh.sha256)
