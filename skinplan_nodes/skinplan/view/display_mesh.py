"""Meshes for the eye: long faces cut for their colours, large meshes made smaller."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.mesh.model import SurfaceMesh
from skinplan.transforms import Array

FINEST_EDGE_M = 0.012
MOST_PICTURE_FACES = 600_000


@dataclass(frozen=True, eq=False)
class DisplayMesh:
    """A mesh made for a picture.

    Attributes:
        mesh: The mesh.
        parents: For each of its faces the face of the part that it came from, shape (f,).
    """

    mesh: SurfaceMesh
    parents: NDArray[np.int64]


def refined(
    mesh: SurfaceMesh, longest_m: float = FINEST_EDGE_M, most: int = MOST_PICTURE_FACES
) -> DisplayMesh:
    """Cuts faces in two at their longest edge until no edge is longer than wanted.

    Args:
        mesh: The part; meshes that are fine enough come back as they are.
        longest_m: Longest edge wanted [m].
        most: No more cuts once there are so many faces.

    Returns:
        The mesh; faces that were cut share no vertices any more.
    """
    parents = np.arange(len(mesh.faces))
    corners = mesh.corners
    while True:
        sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        cut = np.flatnonzero(sides.max(axis=1) > longest_m)
        if not len(cut) or len(corners) + len(cut) > most:
            break
        corners, parents = _halved(corners, parents, cut, sides[cut].argmax(axis=1))
    if len(corners) == len(mesh.faces):
        return DisplayMesh(mesh, parents)
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    return DisplayMesh(SurfaceMesh(corners.reshape(-1, 3), faces, mesh.sha256), parents)


def thinned(mesh: SurfaceMesh, most: int) -> DisplayMesh:
    """Merges near vertices until a mesh is small enough to be sent to a browser.

    Args:
        mesh: The part; small meshes come back as they are.
        most: Number of faces wanted at most.

    Returns:
        The mesh. Its shape differs from the part's by about an edge length: for the eye only.
    """
    display = DisplayMesh(mesh, np.arange(len(mesh.faces)))
    cell = float(np.sqrt(2.0 * mesh.area / max(most, 1)))
    while len(display.mesh.faces) > most:
        display = _clustered(mesh, cell)
        cell *= 1.25
    return display


def _halved(
    corners: Array, parents: NDArray[np.int64], cut: NDArray[np.int64], side: NDArray[np.int64]
) -> tuple[Array, NDArray[np.int64]]:
    number = np.arange(len(cut))
    turned = corners[cut][number[:, None], (side[:, None] + np.arange(3)) % 3]
    middle = 0.5 * (turned[:, 0] + turned[:, 1])
    first = np.stack([turned[:, 0], middle, turned[:, 2]], axis=1)
    second = np.stack([middle, turned[:, 1], turned[:, 2]], axis=1)
    corners = corners.copy()
    corners[cut] = first
    return np.concatenate([corners, second]), np.concatenate([parents, parents[cut]])


def _clustered(mesh: SurfaceMesh, cell_m: float) -> DisplayMesh:
    cells = np.floor((mesh.vertices - mesh.bounds[0]) / cell_m).astype(np.int64)
    sizes = cells.max(axis=0) + 1
    keys = (cells[:, 0] * sizes[1] + cells[:, 1]) * sizes[2] + cells[:, 2]
    _, owner = np.unique(keys, return_inverse=True)
    owner = owner.ravel()
    count = np.bincount(owner)
    places = np.stack([np.bincount(owner, weights=axis) for axis in mesh.vertices.T], axis=1)
    faces = owner[mesh.faces]
    whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    _, first = np.unique(np.sort(faces[whole], axis=1), axis=0, return_index=True)
    kept = np.flatnonzero(whole)[np.sort(first)]
    return DisplayMesh(SurfaceMesh(places / count[:, None], faces[kept], mesh.sha256), kept)
