"""Rays against a mesh (Embree, single precision)."""

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from skinplan.errors import InputError
from skinplan.mesh.model import SurfaceMesh
from skinplan.transforms import Array

_BATCH = 2_000_000


class RayCaster:
    """Answers what rays hit first.

    Coordinates are those of the mesh. Embree works in single precision: over a part of 3 m it is
    exact to a micrometre. Both sides of a face are hit.
    """

    def __init__(self, mesh: SurfaceMesh) -> None:
        """Builds the acceleration structure.

        Args:
            mesh: What the rays may hit, at least one face.

        Raises:
            InputError: No faces.
        """
        if len(mesh.faces) == 0:
            raise InputError("rays need a mesh with at least one face, found none")
        self._origin = mesh.bounds.mean(axis=0)
        self._corners = mesh.corners - self._origin
        self._normals = mesh.face_normals
        self._scene = EmbreeScene()
        TriangleMesh(
            scene=self._scene,
            vertices=(mesh.vertices - self._origin).astype(np.float32),
            indices=mesh.faces.astype(np.int32),
        )

    def hits(self, origins: Array, directions: Array) -> tuple[Array, NDArray[np.int64]]:
        """Finds the first face along each ray.

        Args:
            origins: shape (n, 3) [m].
            directions: Unit vectors, shape (n, 3).

        Returns:
            Distances, shape (n,) [m], infinite for a miss, and faces, shape (n,), -1 for a miss.
        """
        starts, along = self._checked(origins, directions)
        faces = self._run(starts, along, None, "INTERSECT")
        distance = np.full(len(starts), np.inf)
        hit = np.flatnonzero(faces >= 0)
        # The face is right in single precision; the distance is taken from its plane in double
        # precision.
        normal = self._normals[faces[hit]]
        slope = np.einsum("ij,ij->i", normal, along[hit])
        rise = np.einsum("ij,ij->i", normal, self._corners[faces[hit], 0] - starts[hit])
        with np.errstate(divide="ignore", invalid="ignore"):
            distance[hit] = np.where(np.abs(slope) > 1e-9, rise / slope, np.inf)
        faces[~np.isfinite(distance)] = -1
        return distance, faces

    def occluded(
        self, origins: Array, directions: Array, distance: Array | float
    ) -> NDArray[np.bool_]:
        """Says which rays hit something within a distance.

        Args:
            origins: shape (n, 3) [m].
            directions: Unit vectors, shape (n, 3).
            distance: Length of the rays, shape (n,) or one number [m].

        Returns:
            Whether something is in the way, shape (n,).
        """
        starts, along = self._checked(origins, directions)
        limit = np.broadcast_to(np.asarray(distance, dtype=np.float32), (len(starts),))
        # Embree answers 0 for a hit and -1 for a free ray.
        return self._run(starts, along, limit, "OCCLUDED") == 0

    def _run(
        self, starts: Array, along: Array, limit: NDArray[np.float32] | None, query: str
    ) -> NDArray[np.int64]:
        answers = np.empty(len(starts), dtype=np.int64)
        for begin in range(0, len(starts), _BATCH):
            part = slice(begin, begin + _BATCH)
            answers[part] = self._scene.run(
                np.ascontiguousarray(starts[part], dtype=np.float32),
                np.ascontiguousarray(along[part], dtype=np.float32),
                None if limit is None else np.array(limit[part]),
                query=query,
            )
        return answers

    def _checked(self, origins: Array, directions: Array) -> tuple[Array, Array]:
        starts, along = np.asarray(origins, dtype=float), np.asarray(directions, dtype=float)
        if starts.ndim != 2 or starts.shape[1] != 3 or starts.shape != along.shape:
            raise InputError(
                f"origins and directions of one shape (n, 3) are accepted, found {starts.shape} "
                f"and {along.shape}"
            )
        return starts - self._origin, along
