"""Closest point of a mesh.

A KD-tree of seeds on the surface finds the faces, the distance to them is exact.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skinplan.errors import MeshEmptyError
from skinplan.mesh.model import SurfaceMesh
from skinplan.scanner.model import SurfaceSamples
from skinplan.transforms import Array

# Faces tried per point, and steps to neighbours from the best of them. Every face has a seed.
_CANDIDATES = 4
_MOST_WALK = 8
# Points handled at once: bounds the memory.
_BATCH = 50_000
# Barycentric coordinate below which a closest point counts as on the opposite edge.
_ON_EDGE = 1e-9


@dataclass(frozen=True, eq=False)
class Closest:
    """Closest surface points.

    Attributes:
        points: shape (n, 3) [m].
        faces: Their faces, shape (n,).
        normals: Outward unit normals of the faces, shape (n, 3).
        distance: shape (n,) [m], >= 0.
        on_border: On the open border of the mesh, shape (n,) bool: beyond it there is no surface
            to compare with.
        samples: About nearest sample of the index, shape (n,).
    """

    points: Array
    faces: NDArray[np.int64]
    normals: Array
    distance: Array
    on_border: NDArray[np.bool_]
    samples: NDArray[np.int64]

    def signed(self, points: Array) -> Array:
        """Returns the distance of the query points, positive outside, shape (n,) [m]."""
        side = np.einsum("ij,ij->i", points - self.points, self.normals)
        return np.where(side < 0.0, -self.distance, self.distance)


class SurfaceIndex:
    """Answers closest-point queries on one mesh.

    Args:
        mesh: The part, workpiece frame [m].
        samples: Even samples of it.

    Raises:
        MeshEmptyError: The mesh has no faces.
    """

    def __init__(self, mesh: SurfaceMesh, samples: SurfaceSamples) -> None:
        if len(mesh.faces) == 0:
            raise MeshEmptyError(
                "a surface was asked for the closest point of; a mesh with faces is accepted, "
                "it has none"
            )
        self.mesh = mesh
        unseeded = np.setdiff1d(np.flatnonzero(mesh.face_areas > 0.0), samples.faces)
        self._faces = np.concatenate([samples.faces, unseeded])
        self._tree = cKDTree(np.concatenate([samples.points, mesh.centroids[unseeded]]))
        # Faces that no sample lies on have a seed of their own, which stands for the next sample.
        beside = np.zeros(0, dtype=np.int64)
        if len(samples.points):
            beside = cKDTree(samples.points).query(mesh.centroids[unseeded])[1].astype(np.int64)
        self._sample_of = np.concatenate([np.arange(len(samples.points)), beside])
        self._neighbours = edge_neighbours(mesh)
        self._triangles = _Triangles(mesh.corners)

    def closest(self, points: Array) -> Closest:
        """Finds the closest surface points.

        Args:
            points: Workpiece frame, shape (n, 3) [m], finite.

        Returns:
            One answer for each.
        """
        batches = [self._batch(points[i : i + _BATCH]) for i in range(0, len(points), _BATCH)]
        if not batches:
            empty = np.zeros((0, 3))
            none = np.zeros(0, np.int64)
            return Closest(empty, none, empty, np.zeros(0), np.zeros(0, bool), none)
        fields = (np.concatenate(parts) for parts in zip(*batches, strict=True))
        return Closest(*fields)

    def normals_near(self, points: Array) -> Array:
        """Returns normals of the surface about where points lie on it, fast, shape (n, 3).

        Beside an edge it may be that of the other face.
        """
        return np.asarray(self.mesh.face_normals[self._faces[self._tree.query(points)[1]]])

    def _batch(
        self, points: Array
    ) -> tuple[Array, NDArray[np.int64], Array, Array, NDArray[np.bool_], NDArray[np.int64]]:
        count = min(_CANDIDATES, len(self._faces))
        _, near = self._tree.query(points, k=count)
        best = self._best(points, _once(self._faces[near.reshape(len(points), count)]))
        self._walk(points, best)
        on_edge = best.weights < _ON_EDGE
        return (
            best.points,
            best.faces,
            self.mesh.face_normals[best.faces],
            best.distance,
            np.any(on_edge & (self._neighbours[best.faces] < 0), axis=1),
            self._sample_of[near.reshape(len(points), count)[:, 0]],
        )

    def _best(self, points: Array, faces: NDArray[np.int64]) -> "_Found":
        """Chooses among candidate faces, shape (n, k); -1 = none, each point has one at least."""
        row, column = np.nonzero(faces >= 0)
        known = faces[row, column]
        found, weights = self._triangles.closest(points[row], known)
        away = points[row] - found
        distance = np.linalg.norm(away, axis=1)
        # At an edge several faces are equally near: the one that looks most toward the point gives
        # the right sign.
        facing = np.abs(np.einsum("ij,ij->i", away, self.mesh.face_normals[known]))
        rank = np.full(faces.shape, np.inf)
        rank[row, column] = distance - 1e-6 * facing
        number = np.zeros(faces.shape, dtype=np.int64)
        number[row, column] = np.arange(len(row))
        of_point = np.arange(len(points))
        column = np.argmin(rank, axis=1)
        best = number[of_point, column]
        return _Found(
            found[best], known[best], weights[best], distance[best], rank[of_point, column]
        )

    def _walk(self, points: Array, best: "_Found") -> None:
        """Goes on over the edges that closest points lie on, as long as that brings them nearer."""
        row = np.arange(len(points))
        for _ in range(_MOST_WALK):
            beyond = np.where(best.weights[row] < _ON_EDGE, self._neighbours[best.faces[row]], -1)
            some = np.any(beyond >= 0, axis=1)
            row = row[some]
            if len(row) == 0:
                return
            found = self._best(points[row], beyond[some])
            nearer = found.rank < best.rank[row] - 1e-12
            row = row[nearer]
            best.take(row, found, nearer)


@dataclass(frozen=True, eq=False)
class _Found:
    """Closest points (n, 3), faces (n,), barycentric (n, 3), distances (n,), ranks (n,)."""

    points: Array
    faces: NDArray[np.int64]
    weights: Array
    distance: Array
    rank: Array

    def take(self, rows: NDArray[np.int64], other: "_Found", chosen: NDArray[np.bool_]) -> None:
        """Overwrites rows with the chosen rows of another."""
        for mine, theirs in zip(vars(self).values(), vars(other).values(), strict=True):
            mine[rows] = theirs[chosen]


def edge_neighbours(mesh: SurfaceMesh) -> NDArray[np.int64]:
    """Returns the face across each edge, shape (f, 3); edge k lies opposite of corner k.

    -1 = open border.

    Where more than two faces share an edge, one of the others is given.
    """
    edges = np.sort(mesh.faces[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2), axis=1)
    keys = edges[:, 0] * len(mesh.vertices) + edges[:, 1]
    order = np.argsort(keys, kind="stable")
    same = np.flatnonzero(np.diff(keys[order]) == 0)
    across = np.full(len(keys), -1, dtype=np.int64)
    first, second = order[same], order[same + 1]
    across[second], across[first] = first // 3, second // 3
    return across.reshape(-1, 3)


def _once(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Returns candidates, shape (n, k), with -1 for those that stand farther left, too."""
    result = faces.copy()
    for k in range(1, faces.shape[1]):
        result[np.any(faces[:, k : k + 1] == faces[:, :k], axis=1), k] = -1
    return result


class _Triangles:
    """Closest point of triangles, vectorised.

    Inside by barycentric coordinates, else the best of the three edges.
    """

    def __init__(self, corners: Array) -> None:
        self._corners = corners
        self._ab = corners[:, 1] - corners[:, 0]
        self._ac = corners[:, 2] - corners[:, 0]
        self._dots = np.stack(
            [
                np.einsum("ij,ij->i", u, v)
                for u, v in ((self._ab, self._ab), (self._ab, self._ac), (self._ac, self._ac))
            ],
            axis=1,
        )

    def closest(self, points: Array, faces: NDArray[np.int64]) -> tuple[Array, Array]:
        """Returns closest points and barycentric coordinates, shapes (n, 3).

        For points of shape (n, 3) and as many faces, shape (n,).
        """
        weights = self._inside(points, faces)
        beside = np.flatnonzero(np.min(weights, axis=1) < 0.0)
        weights[beside] = self._on_edges(points[beside], faces[beside])
        return np.einsum("nc,ncj->nj", weights, self._corners[faces]), weights

    def _inside(self, points: Array, faces: NDArray[np.int64]) -> Array:
        relative = points - self._corners[faces, 0]
        d1 = np.einsum("nj,nj->n", relative, self._ab[faces])
        d2 = np.einsum("nj,nj->n", relative, self._ac[faces])
        bb, bc, cc = self._dots[faces].T
        area = np.maximum(bb * cc - bc * bc, 1e-300)
        v = (cc * d1 - bc * d2) / area
        w = (bb * d2 - bc * d1) / area
        return np.stack([1.0 - v - w, v, w], axis=1)

    def _on_edges(self, points: Array, faces: NDArray[np.int64]) -> Array:
        corners = self._corners[faces]
        weights = np.zeros((len(points), 3, 3))
        distance = np.empty((len(points), 3))
        for edge in range(3):
            first, second = (edge + 1) % 3, (edge + 2) % 3
            along = corners[:, second] - corners[:, first]
            length = np.maximum(np.einsum("ij,ij->i", along, along), 1e-300)
            share = np.einsum("ij,ij->i", points - corners[:, first], along) / length
            share = np.clip(share, 0.0, 1.0)
            weights[:, edge, first], weights[:, edge, second] = 1.0 - share, share
            offset = corners[:, first] + share[:, None] * along - points
            distance[:, edge] = np.einsum("ij,ij->i", offset, offset)
        return weights[np.arange(len(points)), np.argmin(distance, axis=1)]
