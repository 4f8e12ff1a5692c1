"""A model prepared for registration: its surface, and how it may lie on a tray."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from skinplan.inspection.closest import SurfaceIndex
from skinplan.mesh.model import SurfaceMesh
from skinplan.recognition.database import RESTS
from skinplan.scanner.model import SurfaceSamples
from skinplan.scanner.rays import RayCaster
from skinplan.scanner.samples import sample_surface
from skinplan.transforms import Array, transform

# Samples of the surface for the search; distances in the end are exact.
_SPACING_M = 0.002
_MOST = 40_000
# Cells of the outline seen from above [m].
CELL_M = 0.003


@dataclass(frozen=True, eq=False)
class FitModel:
    """One model.

    Attributes:
        name: Of the part.
        mesh: Closed body, part frame [m].
        rests: Rotations that lay it on the tray, by name, each of shape (3, 3).
    """

    name: str
    mesh: SurfaceMesh
    rests: dict[str, Array]

    @classmethod
    def of(cls, name: str, mesh: trimesh.Trimesh) -> "FitModel":
        """The model of a mesh that lies as it was made or turned over about x."""
        surface = SurfaceMesh(np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int64))
        return cls(name, surface, {RESTS[0]: np.eye(3), RESTS[1]: np.diag([1.0, -1.0, -1.0])})

    @cached_property
    def samples(self) -> SurfaceSamples:
        """Even samples of the surface."""
        spacing = max(_SPACING_M, float(np.sqrt(self.mesh.area / _MOST)))
        return sample_surface(self.mesh, spacing)

    @cached_property
    def tree(self) -> cKDTree:
        """KD-tree of the samples."""
        return cKDTree(self.samples.points)

    @cached_property
    def index(self) -> SurfaceIndex:
        """Exact closest points."""
        return SurfaceIndex(self.mesh, self.samples)

    @cached_property
    def size_m(self) -> float:
        """Diagonal of the box [m]."""
        return float(np.linalg.norm(np.diff(self.mesh.bounds, axis=0)))

    @cached_property
    def middle(self) -> Array:
        """Middle of the box, part frame, shape (3,) [m]."""
        return np.asarray(self.mesh.bounds.mean(axis=0))

    @cached_property
    def laid(self) -> dict[str, Array]:
        """Pose in each rest: the middle of the outline over the tray's origin, lowest point on it.

        Shapes (4, 4) [m].
        """
        return {name: self._laid(turn) for name, turn in self.rests.items()}

    def _laid(self, turn: Array) -> Array:
        x, y = outline_middle(self.samples.points @ turn.T)
        low = float((self.mesh.vertices @ turn.T)[:, 2].min())
        return transform((-x, -y, -low), turn)

    @cached_property
    def rays(self) -> RayCaster:
        """Rays against the surface."""
        return RayCaster(self.mesh)

    def prepare(self) -> "FitModel":
        """Computes all of the above, so that the first registration takes no longer than others."""
        for name in ("index", "tree", "laid", "rays", "size_m", "middle"):
            getattr(self, name)
        return self


def outline_middle(points: Array) -> Array:
    """Middle of the area that points cover seen from above, shape (2,) [m].

    Args:
        points: shape (n, 3) [m]; how densely they lie makes no difference.
    """
    cells = np.unique(np.floor(points[:, :2] / CELL_M).astype(np.int64), axis=0)
    return np.asarray((cells.mean(axis=0) + 0.5) * CELL_M)
