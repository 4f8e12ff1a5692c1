"""Which candidate poses see which part of the surface, and the fewest that see all of it."""

import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, hstack, vstack

from skinplan.cover.many_rows import cover_many_rows, relax
from skinplan.mesh.model import Segmentation, SurfaceMesh
from skinplan.scan_path.poses import Poses
from skinplan.scanner.coverage import visible_pairs
from skinplan.scanner.model import ScannerModel, SurfaceSamples
from skinplan.scanner.rays import RayCaster
from skinplan.scanner.samples import sample_surface

# The surface is judged every so often while choosing, as a share of r_f: features more finely.
_FLAT_RATIO = 0.1
_FEATURE_RATIO = 0.05
_MOST_SAMPLES = 20_000
_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Choice:
    """Chosen poses.

    Attributes:
        poses: The poses, in the order of the candidates.
        lower_bound: No fewer of the candidates see as much.
        proven: So few were chosen.
    """

    poses: Poses
    lower_bound: int
    proven: bool


class ViewChooser:
    """Chooses the fewest poses that see samples of the surface often enough."""

    def __init__(
        self, samples: SurfaceSamples, caster: RayCaster, scanner: ScannerModel, least_views: int
    ) -> None:
        """Keeps what is to be seen.

        Args:
            samples: The samples.
            caster: Rays against what may hide them.
            scanner: The scanner, with the margins that planning keeps.
            least_views: So many poses are to see each sample, where that many can.
        """
        self.samples = samples
        self._caster, self._scanner, self._least = caster, scanner, least_views

    def matrix(self, poses: Poses, samples: SurfaceSamples | None = None) -> csr_matrix:
        """Returns which pose sees which sample, shape (samples, poses), values 0 and 1."""
        asked = self.samples if samples is None else samples
        rows, columns = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
        for view, sample in visible_pairs(
            asked, self._caster, poses.positions, poses.directions, self._scanner
        ):
            rows.append(sample)
            columns.append(view)
        row, column = np.concatenate(rows), np.concatenate(columns)
        return csr_matrix((np.ones(len(row)), (row, column)), shape=(len(asked.points), len(poses)))

    def demand(self, matrix: csr_matrix) -> NDArray[np.int64]:
        """Returns how often each sample is to be seen: as often as wanted, if it can be."""
        return np.minimum(np.diff(matrix.indptr), self._least)

    def short(self, matrix: csr_matrix) -> NDArray[np.int64]:
        """Returns the numbers of the samples that fewer poses see than are wanted."""
        return np.flatnonzero(np.diff(matrix.indptr) < self._least)

    def short_area(self, matrix: csr_matrix) -> float:
        """Returns the area of those samples [m^2]."""
        return float(self.samples.weights[self.short(matrix)].sum())

    def fewest(self, matrix: csr_matrix) -> float:
        """Returns a number of poses below which no choice sees enough."""
        demand = self.demand(matrix)
        some = np.flatnonzero(demand)
        if not len(some):
            return 0.0
        return relax(matrix[some], demand[some], np.ones(matrix.shape[1])).value

    def choose(self, poses: Poses, matrix: csr_matrix) -> Choice:
        """Chooses among candidates.

        Args:
            poses: The candidates.
            matrix: What they see, as `matrix` returns it.
        """
        found = cover_many_rows(matrix, self.demand(matrix))
        _log.info(
            "scan path: %d of %d candidate poses, at least %d are needed",
            len(found.chosen),
            len(poses),
            round(found.lower_bound),
        )
        return Choice(poses.take(found.chosen), round(found.lower_bound), found.proven)

    def extended(self, more: SurfaceSamples) -> "ViewChooser":
        """Returns a chooser that looks at further samples as well."""
        samples = joined([self.samples, more])
        return ViewChooser(samples, self._caster, self._scanner, self._least)


def enough(matrix: csr_matrix, least: int) -> NDArray[np.int64]:
    """Picks poses, those that see most first, until each sample has ``least`` to choose from.

    Args:
        matrix: Which pose sees which sample, shape (samples, poses).
        least: Number of poses per sample.

    Returns:
        Numbers of the poses picked, rising.
    """
    columns = matrix.tocsc()
    have = np.zeros(matrix.shape[0], dtype=np.int64)
    picked = []
    for pose in np.argsort(-np.diff(columns.indptr), kind="stable").tolist():
        rows = columns.indices[columns.indptr[pose] : columns.indptr[pose + 1]]
        if np.any(have[rows] < least):
            have[rows] += 1
            picked.append(pose)
    return np.array(sorted(picked), dtype=np.int64)


def beside(first: csr_matrix, second: csr_matrix) -> csr_matrix:
    """Returns the matrix of two sets of poses, one after the other."""
    return hstack([first, second]).tocsr()


def below(first: csr_matrix, second: csr_matrix) -> csr_matrix:
    """Returns the matrix of two sets of samples, one after the other."""
    return vstack([first, second]).tocsr()


def planning_samples(
    mesh: SurfaceMesh, segmentation: Segmentation, radius_m: float
) -> SurfaceSamples:
    """Spreads the samples to plan with: more finely in complex regions."""
    least = np.sqrt(mesh.area / _MOST_SAMPLES)
    complex_faces = segmentation.face_region > 0
    parts = [
        sample_surface(mesh, max(ratio * radius_m, least), np.flatnonzero(faces))
        for ratio, faces in ((_FLAT_RATIO, ~complex_faces), (_FEATURE_RATIO, complex_faces))
    ]
    return joined([*parts, _edge_samples(mesh, 2 * _FEATURE_RATIO * radius_m)])


def _edge_samples(mesh: SurfaceMesh, spacing_m: float) -> SurfaceSamples:
    """Samples along the open edges, where fields of view end first; they stand for no area."""
    sides = mesh.faces[:, [[0, 1], [1, 2], [2, 0]]]
    keys = sides.min(axis=2) * len(mesh.vertices) + sides.max(axis=2)
    _, place, count = np.unique(keys, return_index=True, return_counts=True)
    face, side = np.unravel_index(np.sort(place[count == 1]), keys.shape)
    ends = mesh.vertices[sides[face, side]]
    number = np.ceil(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / spacing_m).astype(np.int64)
    owner = np.repeat(np.arange(len(face)), number)
    step = np.arange(len(owner)) - np.repeat(np.cumsum(number) - number, number)
    share = ((step + 0.5) / number[owner])[:, None]
    points = (1.0 - share) * ends[owner, 0] + share * ends[owner, 1]
    faces = face[owner]
    # A little inside the face: a ray from the very edge can slip past it.
    points = points + 1e-5 * (mesh.centroids[faces] - points)
    cells = np.floor((points - mesh.bounds[0]) / spacing_m).astype(np.int64)
    kept = np.sort(np.unique(cells, axis=0, return_index=True)[1])
    return SurfaceSamples(
        points[kept], mesh.face_normals[faces[kept]], faces[kept], np.zeros(len(kept))
    )


def joined(parts: list[SurfaceSamples]) -> SurfaceSamples:
    """Puts sets of samples one after another."""
    return SurfaceSamples(
        np.concatenate([part.points for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate([part.faces for part in parts]),
        np.concatenate([part.weights for part in parts]),
    )


def some_of(samples: SurfaceSamples, which: NDArray[np.generic]) -> SurfaceSamples:
    """Returns some samples, by mask or index."""
    return SurfaceSamples(
        samples.points[which], samples.normals[which], samples.faces[which], samples.weights[which]
    )
