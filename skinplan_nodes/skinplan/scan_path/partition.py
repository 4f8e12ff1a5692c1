"""Splits the surface of a part into patches that one direction can treat (R 5, eq (1))."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.mesh.model import SurfaceMesh
from skinplan.mesh.topology import components, edge_table
from skinplan.transforms import Array

Indices = NDArray[np.int64]

# The facets about the mean normal are a patch when they are this share of what is split.
_CORE_RATIO = 0.5
# Normals that add up to less than this share of their area cancel out.
_LEAST_MEAN = 0.05
_MEAN_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class _Piece:
    """Connected faces, and which of them share an edge, shapes (m,) and (p, 2)."""

    faces: Indices
    pairs: Indices


def mean_normal(normals: Array, areas: Array) -> Array | None:
    """Returns the unit mean normal of facets weighted by their areas, eq (1) of R.

    Args:
        normals: Unit normals, shape (k, 3).
        areas: Areas, shape (k,) [m^2].

    Returns:
        shape (3,); None where the normals cancel out.
    """
    total = areas @ normals
    length = float(np.linalg.norm(total))
    if length <= _LEAST_MEAN * float(areas.sum()):
        return None
    return np.asarray(total / length)


class Partition:
    """Splits faces into patches."""

    def __init__(
        self, mesh: SurfaceMesh, normals: Array, angle_rad: float, least_area_m2: float
    ) -> None:
        """Keeps a part.

        Args:
            mesh: The part.
            normals: Unit normals that count, of the smoothed surface, shape (f, 3).
            angle_rad: Largest angle between the normal of a facet and the mean of its patch [rad].
            least_area_m2: Smaller patches are left to their neighbours [m^2].
        """
        self._pairs = edge_table(mesh.faces).pairs
        self._normals, self._areas = normals, mesh.face_areas
        self._cosine, self._least = float(np.cos(angle_rad)), least_area_m2
        self._rank = np.full(len(mesh.faces), -1, dtype=np.int64)

    def patches(self, use: NDArray[np.bool_]) -> list[Indices]:
        """Splits some faces.

        Args:
            use: Which, shape (f,).

        Returns:
            The faces of each patch, rising; no face is in two. Faces of patches that are too small
            are in none; of each connected part at least the largest patch is kept.
        """
        whole = _Piece(np.flatnonzero(use), self._pairs[use[self._pairs].all(axis=1)])
        found: list[Indices] = []
        for part in self._connected(whole, 0.0):
            patches = self._split(part)
            areas = np.array([self._areas[patch].sum() for patch in patches])
            kept = areas >= min(self._least, float(areas.max()))
            found += [patch for patch, keep in zip(patches, kept, strict=True) if keep]
        return found

    def _split(self, part: _Piece) -> list[Indices]:
        """Splits a connected part; the order of the patches hangs on the order of its faces."""
        least = min(self._least, float(self._areas[part.faces].sum()) / 4)
        waiting, done = [part], []
        while waiting:
            piece = waiting.pop()
            core = self._core(piece)
            if core.all():
                done.append(piece.faces)
                continue
            inside = self._connected(self._some(piece, core), 0.0)
            areas = [float(self._areas[each.faces].sum()) for each in inside]
            if areas and max(areas) >= _CORE_RATIO * float(self._areas[piece.faces].sum()):
                patch = inside[int(np.argmax(areas))].faces
                done.append(patch)
                rest = ~np.isin(piece.faces, patch, assume_unique=True)
                waiting += self._connected(self._some(piece, rest), least)
            else:
                half = self._half(piece)
                waiting += self._connected(self._some(piece, half), least)
                waiting += self._connected(self._some(piece, ~half), least)
        return done

    def _core(self, piece: _Piece) -> NDArray[np.bool_]:
        """Says which faces of a piece are near its mean normal, shape (m,)."""
        normals, areas = self._normals[piece.faces], self._areas[piece.faces]
        core = np.ones(len(areas), dtype=bool)
        # What is cut off no longer weighs in the mean.
        for _ in range(_MEAN_ROUNDS):
            mean = mean_normal(normals[core], areas[core])
            if mean is None:
                return np.zeros(len(areas), dtype=bool)
            found = normals @ mean >= self._cosine
            if np.array_equal(found, core):
                break
            core = found
        return core

    def _half(self, piece: _Piece) -> NDArray[np.bool_]:
        """Parts the normals of a piece where they spread most, shape (m,)."""
        normals, areas = self._normals[piece.faces], self._areas[piece.faces]
        offsets = normals - np.average(normals, axis=0, weights=areas)
        spread = np.linalg.eigh((offsets * areas[:, None]).T @ offsets)[1][:, -1]
        half = np.asarray(offsets @ spread > 0.0)
        if half.all() or not half.any():
            half = np.arange(len(areas)) < len(areas) // 2
        return half

    def _some(self, piece: _Piece, which: NDArray[np.bool_]) -> _Piece:
        faces = piece.faces[which]
        self._rank[piece.faces] = -1
        self._rank[faces] = np.arange(len(faces))
        return _Piece(faces, piece.pairs[(self._rank[piece.pairs] >= 0).all(axis=1)])

    def _connected(self, piece: _Piece, least_m2: float) -> list[_Piece]:
        """Returns the connected pieces that are large enough."""
        if not len(piece.faces):
            return []
        self._rank[piece.faces] = np.arange(len(piece.faces))
        count, labels = components(len(piece.faces), self._rank[piece.pairs])
        if count == 1:
            return [piece]
        areas = np.bincount(labels, weights=self._areas[piece.faces], minlength=count)
        owner = labels[self._rank[piece.pairs[:, 0]]]
        return [
            _Piece(piece.faces[labels == label], piece.pairs[owner == label])
            for label in np.flatnonzero(areas >= least_m2)
        ]
