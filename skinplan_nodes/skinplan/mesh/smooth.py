"""Smoothing by a physical length, whatever the size and shape of the triangles."""

import math

import numpy as np
from scipy import sparse

from skinplan.mesh.model import SurfaceMesh
from skinplan.mesh.topology import EdgeTable, edge_table
from skinplan.transforms import Array

# A needle's stiffness is limited to that of a triangle whose height is this share of its longest
# side.
_LEAST_HEIGHT = 1e-3
# Waves much shorter than the length keep at most 1 / cosh(sqrt(2 * damping)) = 2 % of their height.
_DAMPING = 10.0
# Enough for edges of a fifteenth of the length; smaller triangles let heat through more slowly.
_MOST_STAGES = 48


class Smoother:
    """Diffuses values over a mesh, as heat would spread.

    After smoothing by a length s a single peak has spread to a bell of standard deviation s in
    every direction. Space is that of linear finite elements (stiffness of cotangents, lumped mass):
    neither the size nor the shape of the triangles changes what comes out. Time is one step of a
    stabilised explicit scheme (Runge-Kutta-Chebyshev), whose stages grow as s / edge length where
    plain explicit steps would grow as its square.
    """

    def __init__(self, mesh: SurfaceMesh, edges: EdgeTable | None = None) -> None:
        """Prepares a mesh.

        Args:
            mesh: The mesh.
            edges: Its edges, when they are at hand.
        """
        self._edges = edges or edge_table(mesh.faces)
        count = len(mesh.vertices)
        self._cotangents = _half_cotangents(mesh)
        self._mass = _summed(mesh.face_areas / 3, mesh, count)
        self._fixed = np.zeros(count, dtype=bool)
        self._fixed[self._edges.vertices[self._edges.face_counts != 2]] = True
        self._plain = self._stiffness(self._cotangents)

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
        # Over the time t heat spreads to a bell of the variance 2 t.
        stiffness, mass = self._limited(self._plain * (length_m**2 / 2))
        held = self._fixed & fix_boundary
        rates = sparse.diags_array(np.where(held, 0.0, -1.0 / mass)) @ stiffness
        return np.where(held[:, None], values, _one_step(rates, values))

    def density(self, sums: Array, variances_m2: Array) -> Array:
        """Spreads sums at the vertices over the surface around them.

        Args:
            sums: Amounts at the vertices, shape (v, c).
            variances_m2: Variance of the bell per direction at each face, shape (f,) [m^2].

        Returns:
            Amounts per area, shape (v, c) [1/m^2].
        """
        stiffness, mass = self._limited(
            self._stiffness(self._cotangents * (variances_m2 / 2)[:, None])
        )
        return _one_step(sparse.diags_array(-1.0 / mass) @ stiffness, sums / mass[:, None])

    def _stiffness(self, weights: Array) -> sparse.csr_array:
        """Assembles the stiffness matrix from weights of the faces' sides, shape (f, 3)."""
        edges = self._edges
        count = len(self._mass)
        across = np.bincount(
            edges.of_faces.ravel(), weights=weights.ravel(), minlength=len(edges.vertices)
        )
        a, b = edges.vertices.T.astype(np.int32)
        diagonal = np.bincount(a, weights=across, minlength=count)
        diagonal += np.bincount(b, weights=across, minlength=count)
        own = np.arange(count, dtype=np.int32)
        rows, columns = np.concatenate([a, b, own]), np.concatenate([b, a, own])
        return sparse.csr_array(
            (np.concatenate([-across, -across, diagonal]), (rows, columns)), shape=(count, count)
        )

    def _limited(self, stiffness: sparse.csr_array) -> tuple[sparse.csr_array, Array]:
        """Adds mass where triangles are so small that the stages would not suffice.

        Returns:
            The stiffness, and the mass of each vertex, shape (v,).
        """
        sums = np.asarray(abs(stiffness).sum(axis=1)).ravel()
        mass = np.maximum(self._mass, sums / _reach(_MOST_STAGES))
        return stiffness, np.where(mass > 0, mass, 1.0)


def _reach(stages: int) -> float:
    """Returns the largest rate times step that a number of stages damps."""
    start, slope = _chebyshev(stages)
    return (1 + start) / slope


def _chebyshev(stages: int) -> tuple[float, float]:
    """Returns w0 and w1 of the damping polynomial T_s(w0 + w1 z) / T_s(w0), slope 1 at z = 0."""
    start = 1 + _DAMPING / stages**2
    width = math.acosh(start)
    return start, math.sinh(width) / (stages * math.tanh(stages * width))


def _one_step(rates: sparse.csr_array, values: Array) -> Array:
    """Applies the damping polynomial of a matrix with eigenvalues from some -z to 0 to values."""
    # By Gershgorin no eigenvalue is larger than the largest sum of a row.
    largest = float(np.asarray(abs(rates).sum(axis=1)).max(initial=0.0))
    stages = 1
    while _reach(stages) < largest * (1 - 1e-9):
        stages += 1
    start, slope = _chebyshev(stages)
    before, now = values, values + (slope / start) * (rates @ values)
    last, this = 1.0, start
    for _ in range(stages - 1):
        following = 2 * start * this - last
        change = rates @ now
        change *= 2 * slope * this / following
        before = before * (-last / following)
        before += change
        np.multiply(now, 2 * start * this / following, out=change)
        before += change
        before, now = now, before
        last, this = this, following
    return now


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


def _half_cotangents(mesh: SurfaceMesh) -> Array:
    """Returns half the cotangent of the corner opposite to each side, shape (f, 3).

    Side 0 runs from corner 0 to corner 1, and so on.
    """
    corners = mesh.corners
    squares = np.empty((len(corners), 3))
    for number in range(3):
        side = corners[:, (number + 1) % 3] - corners[:, number]
        squares[:, number] = np.einsum("fi,fi->f", side, side)
    largest = np.maximum(np.maximum(squares[:, 0], squares[:, 1]), squares[:, 2])
    doubled = np.maximum(2 * mesh.face_areas, _LEAST_HEIGHT * largest)
    doubled = np.maximum(doubled, 1e-30)[:, None]
    # The cosine rule gives the scalar product of the two other sides.
    total = (squares[:, 0] + squares[:, 1] + squares[:, 2])[:, None]
    return (total - 2 * squares) / (4 * doubled)


def _summed(values: Array, mesh: SurfaceMesh, count: int) -> Array:
    """Sums values of faces, shape (f,), at their corners, shape (count,)."""
    sums = np.zeros(count)
    for corner in mesh.faces.T:
        sums += np.bincount(corner, weights=values, minlength=count)
    return sums
