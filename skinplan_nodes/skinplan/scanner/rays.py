"""Rays against a part and what stands about it (Embree, single precision)."""

from collections.abc import Sequence

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

    Attributes:
        part_faces: Number of faces of the part; higher face numbers are those of the obstacles, one
            after another.
    """

    def __init__(self, mesh: SurfaceMesh, obstacles: Sequence[SurfaceMesh] = ()) -> None:
        """Builds the acceleration structure.

        Args:
            mesh: The part, at least one face.
            obstacles: What else the rays may hit, in the frame of the part.

        Raises:
            InputError: No faces, or an obstacle that is not finite.
        """
        if len(mesh.faces) == 0:
            raise InputError("rays need a mesh with at least one face, found none")
        self.part_faces = len(mesh.faces)
        everything = _joined(mesh, obstacles)
        self._origin = mesh.bounds.mean(axis=0)
        self._corners = everything.corners - self._origin
        self._normals = everything.face_normals
        self._scene = EmbreeScene()
        TriangleMesh(
            scene=self._scene,
            vertices=(everything.vertices - self._origin).astype(np.float32),
            indices=everything.faces.astype(np.int32),
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


def _joined(mesh: SurfaceMesh, obstacles: Sequence[SurfaceMesh]) -> SurfaceMesh:
    filled = [obstacle for obstacle in obstacles if len(obstacle.faces)]
    if not filled:
        return mesh
    for obstacle in filled:
        if not np.isfinite(obstacle.vertices).all():
            raise InputError(
                "obstacles with finite vertices are accepted, found NaN or infinite values"
            )
    meshes = [mesh, *filled]
    firsts = np.cumsum([0] + [len(each.vertices) for each in meshes[:-1]])
    return SurfaceMesh(
        np.concatenate([each.vertices for each in meshes]),
        np.concatenate([each.faces + first for each, first in zip(meshes, firsts, strict=True)]),
    )
