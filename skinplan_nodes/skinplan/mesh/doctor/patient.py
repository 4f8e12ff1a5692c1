"""The mesh under examination, with what several steps ask about it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from skinplan.mesh.model import SurfaceMesh
from skinplan.mesh.topology import EdgeTable, Indices, Mask, compact, components, edge_table
from skinplan.transforms import Array

_MOST_PLACES = 3
Places = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True, eq=False)
class Patient:
    """The mesh under examination.

    Attributes:
        mesh: As it is now [m].
        toward: Unit vector to the side that the scanner is on, shape (3,), in the mesh's frame.
    """

    mesh: SurfaceMesh
    toward: Array

    @cached_property
    def edges(self) -> EdgeTable:
        """The edges."""
        return edge_table(self.mesh.faces)

    @cached_property
    def parts(self) -> tuple[int, Indices]:
        """Number of parts that hang together by edges, and the part of each face, shape (f,).

        Edges with more than two faces count too: ribs do not cut the skin that they stand on.
        """
        count, labels = self.patches
        of_faces = self.edges.of_faces
        crowded = self.edges.face_counts[of_faces] > 2
        if not crowded.any():
            return count, labels
        faces = np.flatnonzero(crowded.any(axis=1)).repeat(crowded[crowded.any(axis=1)].sum(axis=1))
        edges = of_faces[crowded]
        order = np.argsort(edges, kind="stable")
        same = edges[order][1:] == edges[order][:-1]
        links = labels[np.stack([faces[order][:-1][same], faces[order][1:][same]], axis=1)]
        count, joined = components(count, links)
        return count, joined[labels]

    @cached_property
    def patches(self) -> tuple[int, Indices]:
        """Like `parts`, but only edges with exactly two faces count."""
        return components(len(self.mesh.faces), self.edges.pairs)

    @cached_property
    def part_areas(self) -> Array:
        """Areas of the parts, shape (p,) [m^2]."""
        count, labels = self.parts
        return summed(labels, self.mesh.face_areas, count)

    @cached_property
    def facing(self) -> Array:
        """Cosine between each face's normal and the scanner's side, shape (f,)."""
        return self.mesh.face_normals @ self.toward

    @cached_property
    def size(self) -> float:
        """Twice the largest distance from the middle of the area [m]; the same in any frame."""
        mesh = self.mesh
        area = max(mesh.area, np.finfo(float).tiny)
        # One product over all nine numbers of the faces: far cheaper than their centroids.
        middle = (mesh.face_areas @ mesh.corners.reshape(-1, 9)).reshape(3, 3).mean(axis=0) / area
        away = mesh.vertices - middle
        return 2.0 * float(np.sqrt(np.einsum("ij,ij->i", away, away).max(initial=0.0)))

    @cached_property
    def boundary_runs(self) -> Indices:
        """Edges with one face, as that face runs along them, from and to, shape (b, 2)."""
        single = self.edges.face_counts[self.edges.of_faces] == 1
        faces = self.mesh.faces
        return np.stack([faces[single], faces[:, [1, 2, 0]][single]], axis=1)

    def with_mesh(self, mesh: SurfaceMesh) -> "Patient":
        """Returns the patient with another mesh."""
        return Patient(mesh, self.toward)

    def keeping(self, faces: Mask) -> "Patient":
        """Returns the patient with only the faces of a mask, shape (f,)."""
        return self.with_mesh(compact(self.mesh, faces))

    def turning(self, faces: Mask) -> "Patient":
        """Returns the patient with the faces of a mask, shape (f,), turned over."""
        turned = np.where(faces[:, None], self.mesh.faces[:, ::-1], self.mesh.faces)
        return self.with_mesh(SurfaceMesh(self.mesh.vertices, turned, self.mesh.sha256))


def summed(labels: Indices, values: Array, count: int) -> Array:
    """Adds values by label.

    Args:
        labels: Numbers from 0, shape (n,).
        values: shape (n,) or (n, k).
        count: Number of labels.

    Returns:
        shape (count,) or (count, k).
    """
    if values.ndim == 1:
        return np.bincount(labels, weights=values, minlength=count).astype(np.float64)
    return np.stack([summed(labels, column, count) for column in values.T], axis=1)


def places(points: Array, weights: Array | None = None) -> Places:
    """Returns up to three of some points, shape (n, 3), for a finding.

    Args:
        points: Where something was found [m].
        weights: How bad it is there, shape (n,), the worst first; None = in the order given.
    """
    order = np.arange(len(points)) if weights is None else np.argsort(-weights, kind="stable")
    chosen = np.round(points[order[:_MOST_PLACES]], 6) + 0.0
    return tuple((float(x), float(y), float(z)) for x, y, z in chosen)
