"""Parts that are located by their shape, or can't be."""

import numpy as np
import trimesh

import meshes
from skinplan.mesh.model import SurfaceMesh
from skinplan.transforms import Array

LENGTH_M, WIDTH_M = 0.5, 0.3


def two_bumps(x: Array, y: Array) -> Array:
    """A round bump and a higher, long one: no motion leaves this surface as it is."""
    ridge = np.minimum((0.08 - np.abs(x - 0.12)) / 0.02, (0.04 - np.abs(y + 0.05)) / 0.02)
    return np.asarray(meshes.bump(x + 0.1, y - 0.03, 0.03, 0.06) + 0.04 * np.clip(ridge, 0.0, 1.0))


def flat(x: Array, y: Array) -> Array:
    """A plate."""
    return np.zeros_like(x + y)


def egg_crate(x: Array, y: Array) -> Array:
    """Hills every 60 mm: each looks like the next."""
    return np.asarray(0.01 * np.cos(2 * np.pi * x / 0.06) * np.cos(2 * np.pi * y / 0.06))


def cylinder() -> SurfaceMesh:
    """A body of revolution about x, in facets as a mesh has them."""
    body = trimesh.creation.cylinder(0.12, LENGTH_M, sections=64)
    body.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0]))
    return SurfaceMesh(np.asarray(body.vertices), np.asarray(body.faces, dtype=np.int64))
