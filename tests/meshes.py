"""Meshes of known shape for the tests."""

import numpy as np
from scipy.spatial.transform import Rotation

from skinplan.mesh.model import SurfaceMesh
from skinplan.transforms import transform

#: Panels of others, in ``shared/data/panels``.
PANELS = (
    "crm_fuselage_side_2.9x0.8.stl",
    "crm_wing_upper_2.9x0.8.stl",
    "d150_nose_rippled_1.8x0.8.stl",
    "gom_b737_wing_manholes_2.6x0.8.stl",
    "helibody_tailboom_2.2x0.6.stl",
    "reach_hood_1.6x1.4.stl",
)


def grid(length, width, cell, height=None):
    """A height field `height(x, y)` over a rectangle about the origin, normals about +z."""
    columns, rows = max(1, round(length / cell)), max(1, round(width / cell))
    x, y = np.meshgrid(
        np.linspace(-length / 2, length / 2, columns + 1),
        np.linspace(-width / 2, width / 2, rows + 1),
    )
    z = np.zeros_like(x) if height is None else height(x, y)
    row, column = np.divmod(np.arange(rows * columns), columns)
    a = row * (columns + 1) + column
    b, c, d = a + 1, a + columns + 2, a + columns + 1
    faces = np.stack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)], 1).reshape(-1, 3)
    return SurfaceMesh(np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1), faces)


def half_cylinder(radius, length, cell, half_angle=np.pi / 3):
    """A cylinder shell about an axis parallel to x, its middle looking to +z."""
    flat = grid(length, 2 * half_angle * radius, cell)
    angle = flat.vertices[:, 1] / radius
    vertices = np.stack(
        [flat.vertices[:, 0], radius * np.sin(angle), radius * np.cos(angle)], axis=1
    )
    return SurfaceMesh(vertices, flat.faces)


def without(mesh, inside):
    """The mesh without the faces whose centroid fulfils `inside(x, y)`."""
    keep = ~inside(mesh.centroids[:, 0], mesh.centroids[:, 1])
    used, faces = np.unique(mesh.faces[keep], return_inverse=True)
    return SurfaceMesh(mesh.vertices[used], faces.reshape(-1, 3))


def joined(*meshes):
    """One mesh of several, side by side as they are."""
    offsets = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    return SurfaceMesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate(
            [mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=False)]
        ),
    )


def moved(mesh, T):
    """The mesh under a rigid transform."""
    return SurfaceMesh(mesh.vertices @ T[:3, :3].T + T[:3, 3], mesh.faces, mesh.sha256)


def random_transform(seed):
    """A rigid transform drawn from a seed."""
    rng = np.random.default_rng(seed)
    return transform(rng.uniform(-2, 2, 3), Rotation.random(rng=rng).as_matrix())


def groove(x, depth=0.015, width=0.040, wall=0.008):
    """A groove along y: full depth within half the width less the wall, straight walls."""
    return -depth * np.clip((width / 2 - np.abs(x)) / wall, 0.0, 1.0)


def bump(x, y, height=0.03, radius=0.1, wall=0.015):
    """A round bump with a flat top."""
    return height * np.clip((radius - np.hypot(x, y)) / wall, 0.0, 1.0)
