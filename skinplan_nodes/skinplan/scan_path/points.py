"""Scan path strategy ``points``: the points that someone wants measured, and nothing else."""

import numpy as np

from skinplan.errors import InspectionPointsError
from skinplan.mesh.model import Segmentation, SurfaceMesh
from skinplan.part.inspection_points import InspectionPoints
from skinplan.part.model import ScanSettings
from skinplan.scan_path.model import FEATURE, ScanPath
from skinplan.scan_path.published import offset_and_repair
from skinplan.transforms import Array

_LEAST_MEAN = 0.05  # a group whose normals cancel out has no side to tilt to


def points_path(
    mesh: SurfaceMesh,
    segmentation: Segmentation,
    settings: ScanSettings,
    points: InspectionPoints | None,
) -> ScanPath:
    """Makes a scan path that looks at given points along their inward normals (M2.1).

    Poses too near to the part, or whose view it hides, are tilted toward the mean normal of their
    group, or left out with the reason, as in the other strategies.

    Args:
        mesh: A checked mesh.
        segmentation: Its complex regions.
        settings: Checked settings.
        points: The points, workpiece frame; None = the part has none.

    Returns:
        Feature points, surface by surface, each surface in the given order.

    Raises:
        InspectionPointsError: There are no points.
        MeshRefusedError: No pose keeps clear of the part.
    """
    if points is None:
        raise InspectionPointsError(
            "scan path strategy 'points' was asked for, and the part gives no measuring points; "
            "a part file with the key 'points' is accepted, or another strategy"
        )
    order = np.argsort(points.groups, kind="stable")
    normals, groups = points.normals[order], points.groups[order]
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    path = ScanPath(
        positions=np.zeros((len(points), 3)),
        directions=-normals,
        targets=points.targets[order],
        kinds=np.full(len(points), FEATURE, dtype=np.int64),
        groups=groups.astype(np.int64),
        strategy="points",
        regions=segmentation.regions,
    )
    return offset_and_repair(path, mesh, _mean_normals(normals, path), settings)


def _mean_normals(normals: Array, path: ScanPath) -> Array:
    """Mean normal of each pose's group, shape (n, 3); its own where they cancel out."""
    numbers = np.unique(path.groups, return_inverse=True)[1].reshape(-1)
    sums = np.zeros((int(numbers.max()) + 1, 3))
    np.add.at(sums, numbers, normals)
    lengths = np.linalg.norm(sums, axis=1)
    clear = lengths > _LEAST_MEAN * np.bincount(numbers)
    means = sums / np.maximum(lengths, 1e-12)[:, None]
    return np.where(clear[numbers][:, None], means[numbers], normals)
