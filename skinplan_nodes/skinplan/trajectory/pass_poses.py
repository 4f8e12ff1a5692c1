"""Scan path points as depth and angles over the surface they look at (T S3)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skinplan.scan_path.model import ROW, ScanPath
from skinplan.scanner.model import ScannerModel, SurfaceSamples
from skinplan.scanner.motion import row_sequences
from skinplan.trajectory.pass_error import angles_of, frames, toward_of
from skinplan.transforms import Array

Indices = NDArray[np.int64]
DEPTH, IN_PLANE, OUT_OF_PLANE = 0, 1, 2

_EPS = 1e-9
_ON_AXIS_M = 1e-6
# A view axis flatter over the surface than this sine has no angles to speak of.
_LEAST_HIGH = 0.05
# Nearer rows, as shares of r_f, are pieces of one row; points are beside each other within:
_SAME_ROW = 0.1
_BESIDE = 0.5


@dataclass(frozen=True, eq=False)
class PassPoses:
    """Poses as depth and angles over the surface.

    Attributes:
        normals: Outward unit normals of the surface that each point stands for, shape (n, 3).
        along: Unit vectors in the surface along the motion, shape (n, 3).
        across: Unit vectors in the surface across it, shape (n, 3).
        values: Rows `DEPTH` [m], `IN_PLANE` and `OUT_OF_PLANE` [rad], shape (3, n).
        placed: Whether a pose has its target on its axis, within its range, and sees its side,
            shape (n,).
    """

    normals: Array
    along: Array
    across: Array
    values: Array
    placed: NDArray[np.bool_]

    @classmethod
    def of(
        cls, path: ScanPath, samples: SurfaceSamples, scanner: ScannerModel, patch_m: float
    ) -> "PassPoses":
        """Takes the poses of a path; arguments as those of `patch_normals`."""
        normals = patch_normals(samples, path.targets, patch_m)
        along, across = frames(normals, motions_of(path), -path.directions)
        offset = path.targets - path.positions
        depth = np.einsum("ij,ij->i", offset, path.directions)
        aside = np.linalg.norm(offset - depth[:, None] * path.directions, axis=1)
        out, inside = angles_of(-path.directions, normals, along, across)
        high = np.einsum("ij,ij->i", normals, -path.directions)
        placed = (aside < _ON_AXIS_M) & (high > _LEAST_HIGH)
        placed &= (depth >= scanner.range_min_m - _EPS) & (depth <= scanner.range_max_m + _EPS)
        return cls(normals, along, across, np.stack([depth, inside, out]), placed)

    def toward(self, which: Indices, values: Array) -> Array:
        """Returns unit directions to the scanner of some poses with other angles, shape (k, 3).

        Args:
            which: Numbers of the poses, shape (k,).
            values: Depths and angles as in ``values``, shape (3, k).
        """
        return toward_of(
            values[OUT_OF_PLANE],
            values[IN_PLANE],
            self.normals[which],
            self.along[which],
            self.across[which],
        )


def patch_normals(samples: SurfaceSamples, targets: Array, radius_m: float) -> Array:
    """Returns the mean outward normal of the surface that each point stands for, shape (n, 3).

    Only what faces to the same side as the nearest sample counts: a thin part has two sides.

    Args:
        samples: The surface samples.
        targets: shape (n, 3) [m].
        radius_m: Half the distance of the points: eq (5) of M2.2 gives their spacing [m].
    """
    tree = cKDTree(samples.points)
    nearest = samples.normals[tree.query(targets)[1]]
    lists = tree.query_ball_point(targets, radius_m)
    owner = np.repeat(np.arange(len(targets)), [len(each) for each in lists])
    member = np.concatenate([np.asarray(each, dtype=np.int64) for each in lists])
    same = np.einsum("ij,ij->i", samples.normals[member], nearest[owner]) > 0.0
    owner, member = owner[same], member[same]
    sums = _EPS * nearest * samples.weights.mean()
    np.add.at(sums, owner, samples.weights[member, None] * samples.normals[member])
    return np.asarray(sums / np.linalg.norm(sums, axis=1, keepdims=True))


def pass_spacings(path: ScanPath, radius_m: float) -> Array:
    """Returns the distance of each row point from the nearest neighbouring row, shape (n,) [m].

    Distances are taken across the pass, from points beside it; pieces of the same row do not count.
    0 where there is no neighbour, and for feature points, which stand on no pass.

    Args:
        path: The scan path.
        radius_m: r_f, which says what is beside [m].
    """
    result = np.zeros(len(path))
    rows = np.flatnonzero(path.kinds == ROW)
    motions = motions_of(path)
    for row in row_sequences(path):
        others = rows[path.groups[rows] != path.groups[row[0]]]
        if not len(others):
            continue
        offset = path.targets[None, others] - path.targets[row][:, None]
        unit = motions[row] / np.maximum(np.linalg.norm(motions[row], axis=1), _EPS)[:, None]
        along = np.einsum("ijk,ik->ij", offset, unit)
        across = np.sqrt(np.maximum(np.sum(offset**2, axis=2) - along**2, 0.0))
        beside = (np.abs(along) <= _BESIDE * radius_m) & (across > _SAME_ROW * radius_m)
        nearest = np.where(beside, across, np.inf).min(axis=1)
        result[row] = np.where(np.isfinite(nearest), nearest, 0.0)
    return result


def motions_of(path: ScanPath) -> Array:
    """Returns the directions of motion of row points, shape (n, 3); 0 for single points."""
    result = np.zeros((len(path), 3))
    for row in row_sequences(path):
        if len(row) > 1:
            result[row] = np.gradient(path.targets[row], axis=0)
    return result
