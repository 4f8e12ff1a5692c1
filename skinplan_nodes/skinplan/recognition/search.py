"""Many poses of one model at once: costs, and robust point-to-plane steps."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from skinplan.recognition.fit_model import FitModel, outline_middle
from skinplan.recognition.planes import Plane
from skinplan.transforms import Array, apply, inverse, transform

# Normals that differ by more are those of the other side of a sheet (cosine).
_SAME_SIDE = 0.3


@dataclass(frozen=True, eq=False)
class Pairs:
    """Points of a cloud in the part frame with the surface nearest to them, for p poses.

    Attributes:
        points: shape (p, n, 3) [m].
        normals: Of the surface, shape (p, n, 3).
        residual: Along them, positive outside, shape (p, n) [m]; 0 where nothing was found.
        distance: To the nearest sample or its plane, whichever is less, shape (p, n) [m]; infinite
            where nothing was found.
        facing: Whether the cloud's normal looks to the surface's side, shape (p, n).
    """

    points: Array
    normals: Array
    residual: Array
    distance: Array
    facing: NDArray[np.bool_]


def pairs(
    model: FitModel, points: Array, normals: Array, T_part_tray: Array, reach_m: float
) -> Pairs:
    """Looks up what the points of a cloud lie on in each of several poses.

    Args:
        model: The part.
        points: Tray frame, shape (n, 3) [m].
        normals: shape (n, 3).
        T_part_tray: Poses, shape (p, 4, 4) [m].
        reach_m: How much farther off a point is than this makes no difference; what it lies beside
            is not looked for [m].
    """
    turns = np.swapaxes(T_part_tray[:, :3, :3], 1, 2)
    local = points @ turns + T_part_tray[:, None, :3, 3]
    spacing2 = float(model.samples.weights[0])
    # Points without a sample this near are farther from their plane, too.
    bound = float(np.sqrt(reach_m**2 + spacing2))
    away, near = model.tree.query(local.reshape(-1, 3), distance_upper_bound=bound)
    away, near = away.reshape(local.shape[:2]), near.reshape(local.shape[:2])
    found = np.isfinite(away)
    near = np.where(found, near, 0)
    surface = model.samples.normals[near]
    residual = np.einsum("pni,pni->pn", local - model.samples.points[near], surface)
    # A point beside a sample, not over an edge, lies on the sample's plane.
    beside = away**2 - residual**2
    distance = np.sqrt(residual**2 + np.maximum(beside - spacing2, 0.0))
    facing = np.einsum("pni,pni->pn", normals @ turns, surface) > _SAME_SIDE
    return Pairs(local, surface, np.where(found, residual, 0.0), distance, facing)


def costs(found: Pairs, cut_m: float) -> Array:
    """Root mean square distance of each pose, each point counting up to a cut, shape (p,) [m]."""
    return np.asarray(np.sqrt(np.mean(np.minimum(found.distance, cut_m) ** 2, axis=1)))


def stepped(found: Pairs, T_part_tray: Array, scale_m: float, any_side: bool = False) -> Array:
    """Moves each pose by one robust point-to-plane step.

    Args:
        found: Of these poses.
        T_part_tray: shape (p, 4, 4) [m].
        scale_m: Points farther off pull no longer [m].
        any_side: Points count whatever their own normals say. Those on the narrow side of a sheet
            are often wrong, but only such points hold a sheet along itself; once the pose is
            nearly right they do no harm.

    Returns:
        Poses, shape (p, 4, 4) [m].
    """
    middle = found.points.mean(axis=1)
    offset = found.points - middle[:, None]
    rows = np.concatenate([np.cross(offset, found.normals), found.normals], axis=2)
    ratio = np.minimum(found.distance / scale_m, 1.0)
    weight = np.where(found.facing | any_side, (1.0 - ratio**2) ** 2, 0.0)
    weighted = np.swapaxes(weight[..., None] * rows, 1, 2)
    matrix = weighted @ rows
    gradient = (weighted @ found.residual[..., None])[..., 0]
    # A little damping: what nothing holds stays.
    spread = np.mean(np.sum(offset**2, axis=2), axis=1)
    damping = 1e-5 * np.maximum(weight.sum(axis=1), 1.0)
    scale = np.concatenate([np.repeat(spread[:, None], 3, 1), np.ones((len(spread), 3))], axis=1)
    matrix += np.einsum("pi,ij->pij", damping[:, None] * scale, np.eye(6))
    step = -np.linalg.solve(matrix, gradient[..., None])[..., 0]
    turn = Rotation.from_rotvec(step[:, :3]).as_matrix()
    moved = T_part_tray.copy()
    moved[:, :3, :3] = turn @ T_part_tray[:, :3, :3]
    shifted = np.einsum("pij,pj->pi", turn, T_part_tray[:, :3, 3] - middle)
    moved[:, :3, 3] = shifted + middle + step[:, 3:]
    return moved


def lying_poses(
    model: FitModel, points: Array, plane: Plane, headings: int, middles: Array | None = None
) -> Array:
    """Poses in which the model lies on the tray with its outline's middle where the cloud's is.

    Args:
        model: The part.
        points: Cloud, tray frame, shape (n, 3) [m].
        plane: The tray.
        headings: So many in each rest.
        middles: Where the outline's middle may be instead, shape (k, 3) [m].

    Returns:
        ``T_tray_part``, shape (k * rests * headings, 4, 4) [m].
    """
    T_tray_plane = plane_frame(plane)
    flat = apply(inverse(T_tray_plane), points if middles is None else middles)
    places = outline_middle(flat)[None] if middles is None else flat[:, :2]
    angles = 2.0 * np.pi * np.arange(headings) / headings
    turns = Rotation.from_euler("z", angles[:, None]).as_matrix()
    return np.stack(
        [
            T_tray_plane @ transform((x, y, 0.0), turn) @ laid
            for x, y in places
            for laid in model.laid.values()
            for turn in turns
        ]
    )


def plane_frame(plane: Plane) -> Array:
    """A frame with z along the plane's normal and its origin on the plane, shape (4, 4)."""
    z = plane.normal
    x = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    return transform(plane.offset_m * z, np.stack([x, np.cross(z, x), z], axis=1))
