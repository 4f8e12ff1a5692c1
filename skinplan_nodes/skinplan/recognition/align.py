"""Lays a cloud on a mesh quickly: point-to-plane ICP, robust (Tukey), held by a weak prior.

Recognition tries many poses with it; a measured part is laid on its mesh by
`skinplan.inspection.registration`.

A smooth flat panel says nothing about where it lies along itself: without the prior the solution
would slide. The prior says how well the initial pose is known; wherever the shape says more,
thousands of points outweigh it.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from skinplan.errors import AlignmentError
from skinplan.inspection.closest import SurfaceIndex
from skinplan.inspection.model import Alignment
from skinplan.inspection.points import FEWEST, SIGMA_OF_MAD, TUKEY, enough_points, evenly
from skinplan.transforms import Array, apply, inverse, require_transform, transform


@dataclass(frozen=True)
class AlignSettings:
    """How a cloud is laid on a mesh.

    Attributes:
        points: At most so many points of the cloud are used, spread evenly over it.
        gate_m: Pairs farther apart are left out in the beginning [m].
        gate_min_m: The gate shrinks with the residual, but never below this [m].
        prior_position_m: Standard deviation of the initial position [m].
        prior_angle_rad: Standard deviation of the initial orientation.
        noise_min_m: Noise that is assumed at least [m].
        iterations: At most so many.
        inlier_ratio_min: Less of the points on the surface is no alignment [1].
    """

    points: int = 20_000
    gate_m: float = 0.06
    gate_min_m: float = 0.002
    prior_position_m: float = 0.005
    prior_angle_rad: float = 0.005
    noise_min_m: float = 2e-5
    iterations: int = 60
    inlier_ratio_min: float = 0.3


# Converged: the last step moved the points by less than this along the normals (RMS). Sliding along
# a surface that says nothing about it goes on for long and changes nothing that is measured.
_MOTION_M = 1e-7


def align(
    points: Array,
    index: SurfaceIndex,
    T_tracker_workpiece: Array,
    settings: AlignSettings | None = None,
) -> Alignment:
    """Finds where the part stands from points measured on it.

    Args:
        points: Tracker frame, shape (n, 3) [m].
        index: The part's surface.
        T_tracker_workpiece: Initial pose, shape (4, 4) [m], good to a few centimetres and about a
            degree.
        settings: How.

    Returns:
        The pose and its residual.

    Raises:
        NoCloudError: Too few points.
        AlignmentError: Too few of them lie on the surface.
        InputError: A pose that is none, or points that are not finite.
    """
    settings = settings or AlignSettings()
    cloud = enough_points(points)
    initial = require_transform(T_tracker_workpiece, "initial pose")
    cloud = cloud[evenly(len(cloud), settings.points)]
    # Solved in the workpiece frame about the cloud's centroid: there position and angle hardly
    # depend on each other.
    cloud = apply(inverse(initial), cloud)
    T_workpiece_cloud, gate, iterations, converged = _solved(cloud, index, settings)
    pairs = _pairs(cloud, index, T_workpiece_cloud, gate, settings)
    rms = float(np.sqrt(np.average(pairs.residual**2, weights=pairs.weight)))
    return Alignment(initial @ inverse(T_workpiece_cloud), rms, iterations, converged)


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Points with the planes that they are laid on.

    Workpiece frame, shapes (m, 3), (m, 3), (m,), (m,); noise [m].
    """

    points: Array
    normals: Array
    residual: Array
    weight: Array
    sigma: float


def _solved(
    cloud: Array, index: SurfaceIndex, settings: AlignSettings
) -> tuple[Array, float, int, bool]:
    """Returns the pose of the cloud (4, 4), the last gate [m], iterations, and if it converged."""
    T_workpiece_cloud, gate = np.eye(4), settings.gate_m
    centre = np.median(cloud, axis=0)
    for iteration in range(settings.iterations):
        pairs = _pairs(cloud, index, T_workpiece_cloud, gate, settings)
        step, motion = _step(pairs, centre, T_workpiece_cloud, settings)
        pivot = apply(T_workpiece_cloud, centre[None])[0]
        T_workpiece_cloud = _moved(step, pivot) @ T_workpiece_cloud
        gate = max(settings.gate_min_m, min(gate, 6.0 * pairs.sigma))
        if motion < _MOTION_M:
            return T_workpiece_cloud, gate, iteration + 1, True
    return T_workpiece_cloud, gate, settings.iterations, False


def _pairs(
    cloud: Array,
    index: SurfaceIndex,
    T_workpiece_cloud: Array,
    gate: float,
    settings: AlignSettings,
) -> _Pairs:
    moved = apply(T_workpiece_cloud, cloud)
    found = index.closest(moved)
    kept = (found.distance < gate) & ~found.on_border
    if np.count_nonzero(kept) < max(FEWEST, settings.inlier_ratio_min * len(cloud)):
        share = 100.0 * np.count_nonzero(kept) / len(cloud)
        raise AlignmentError(
            f"the cloud was to be laid on the part; {share:.0f} % of its points lie within "
            f"{gate * 1e3:.1f} mm of the surface, at least "
            f"{100 * settings.inlier_ratio_min:.0f} % are accepted"
        )
    points, normals = moved[kept], found.normals[kept]
    residual = np.einsum("ij,ij->i", points - found.points[kept], normals)
    sigma = max(
        settings.noise_min_m,
        SIGMA_OF_MAD * float(np.median(np.abs(residual - np.median(residual)))),
    )
    ratio = np.minimum(
        np.abs(residual) / (TUKEY * max(sigma, float(np.median(np.abs(residual))))), 1.0
    )
    return _Pairs(points, normals, residual, (1.0 - ratio**2) ** 2, sigma)


def _step(
    pairs: _Pairs, centre: Array, T_workpiece_cloud: Array, settings: AlignSettings
) -> tuple[Array, float]:
    """Gauss-Newton step about the moved centroid, prior included: rx ry rz [rad], x y z [m].

    Returns:
        The step, shape (6,), and how far it moves the points along their normals, RMS [m].
    """
    pivot = apply(T_workpiece_cloud, centre[None])[0]
    jacobian = np.hstack([np.cross(pairs.points - pivot, pairs.normals), pairs.normals])
    weight = pairs.weight / pairs.sigma**2
    information = np.concatenate(
        [np.full(3, settings.prior_angle_rad**-2), np.full(3, settings.prior_position_m**-2)]
    )
    # How far the centroid has been turned and moved from the initial pose so far: the prior pulls
    # back by it.
    so_far = np.concatenate(
        [Rotation.from_matrix(T_workpiece_cloud[:3, :3]).as_rotvec(), pivot - centre]
    )
    normal_matrix = jacobian.T @ (weight[:, None] * jacobian) + np.diag(information)
    gradient = jacobian.T @ (weight * pairs.residual) + information * so_far
    step = np.asarray(np.linalg.solve(normal_matrix, -gradient))
    return step, float(np.sqrt(np.mean((jacobian @ step) ** 2)))


def _moved(step: Array, pivot: Array) -> Array:
    turn = Rotation.from_rotvec(step[:3]).as_matrix()
    return transform(pivot + step[3:] - turn @ pivot, turn)
