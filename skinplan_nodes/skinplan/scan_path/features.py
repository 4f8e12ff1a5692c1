"""Target points in complex regions by Poisson sampling with the spacing of eq (4) (M2.2 step 4)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skinplan.mesh.model import SurfaceMesh
from skinplan.scan_path.frame import RowFrame
from skinplan.scan_path.lattice import lattice_points
from skinplan.scan_path.spacing import equivalent_spacing
from skinplan.transforms import Array

# Candidates stand on lines this share of the interval apart.
_CANDIDATE_RATIO = 0.05
# Opposite walls have d_e = 0: two targets are never nearer than this share of the interval.
FLOOR_RATIO = 0.2


@dataclass(frozen=True, eq=False)
class FeaturePoints:
    """Target points in complex regions.

    Attributes:
        targets: shape (n, 3) [m].
        normals: Unit normals of the smoothed surface, shape (n, 3).
        faces: Face of each, shape (n,).
    """

    targets: Array
    normals: Array
    faces: NDArray[np.int64]


def sample_features(
    mesh: SurfaceMesh,
    smoothed: SurfaceMesh,
    faces: NDArray[np.bool_],
    frame: RowFrame,
    interval_m: float,
    sensitivity: float,
) -> FeaturePoints:
    """Puts as many targets into the complex regions as eq (4) lets stand side by side.

    Candidates are spread densely and taken in a shuffled order (always the same); each that is
    taken removes those nearer than d_e of the two normals.

    Args:
        mesh: The part; targets lie on it.
        smoothed: The same faces without small features; its normals count.
        faces: The faces to sample, shape (f,).
        frame: A frame of the part's own; candidates stand on lines along its axes.
        interval_m: d_interval [m].
        sensitivity: Exponent k.

    Returns:
        The targets.
    """
    candidates = lattice_points(mesh, faces, frame, _CANDIDATE_RATIO * interval_m)
    corners = smoothed.vertex_normals[mesh.faces[candidates.faces]]
    normals = np.einsum("sc,sci->si", candidates.shares, corners)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    kept = _thinned(candidates.points, normals, interval_m, sensitivity)
    return FeaturePoints(candidates.points[kept], normals[kept], candidates.faces[kept])


def _thinned(
    points: Array, normals: Array, interval_m: float, sensitivity: float
) -> NDArray[np.int64]:
    """Takes candidates, shape (n, 3), in their order; returns those that are taken, shape (m,)."""
    if len(points) == 0:
        return np.zeros(0, dtype=np.int64)
    tree = cKDTree(points)
    open_ = np.ones(len(points), dtype=bool)
    kept = []
    for candidate in range(len(points)):
        if not open_[candidate]:
            continue
        kept.append(candidate)
        near = np.asarray(tree.query_ball_point(points[candidate], interval_m), dtype=np.int64)
        near = near[open_[near]]
        spacing = equivalent_spacing(normals[candidate], normals[near], interval_m, sensitivity)
        distance = np.linalg.norm(points[near] - points[candidate], axis=1)
        open_[near[distance < np.maximum(spacing, FLOOR_RATIO * interval_m)]] = False
    return np.array(kept, dtype=np.int64)
