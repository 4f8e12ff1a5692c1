"""The part and the arm's capsules as shapes of coal, for exact checks."""

from functools import lru_cache
from math import sqrt

import coal
import numpy as np

from skinplan.mesh.model import SurfaceMesh
from skinplan.robot.arm import Body
from skinplan.transforms import Array


def touches(mesh: SurfaceMesh, body: Body, ends: Array, margin_m: float) -> bool:
    """Tells whether a capsule comes nearer to a mesh than a margin.

    Args:
        mesh: The mesh.
        body: Its radius and length are used.
        ends: End points of its axis in the mesh's frame, shape (2, 3) [m].
        margin_m: Distance to be kept [m].
    """
    request = coal.CollisionRequest()
    request.security_margin = margin_m
    place = coal.Transform3s(turn_z_to(ends[1] - ends[0]), ends.mean(axis=0))
    here = coal.Transform3s()
    result = coal.CollisionResult()
    return bool(coal.collide(coal_mesh(mesh), here, coal_capsule(body), place, request, result))


@lru_cache(maxsize=4)
def coal_mesh(mesh: SurfaceMesh) -> coal.BVHModelOBBRSS:
    """Returns the mesh as coal's bounding volume hierarchy; built once per mesh object."""
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(mesh.faces), len(mesh.vertices))
    model.addVertices(np.ascontiguousarray(mesh.vertices, dtype=float))
    model.addTriangles(np.ascontiguousarray(mesh.faces, dtype=np.int64))
    model.endModel()
    return model


def coal_capsule(body: Body) -> coal.ShapeBase:
    """Returns a body as coal's capsule about its z axis, or as sphere when it has no length."""
    length = float(np.linalg.norm(body.ends[1] - body.ends[0]))
    return coal.Sphere(body.radius) if length < 1e-9 else coal.Capsule(body.radius, length)


def turn_z_to(axis: Array) -> Array:
    """A rotation whose z axis points along the argument, shape (3, 3); any for zero length."""
    x, y, z = (float(value) for value in axis)
    length = sqrt(x * x + y * y + z * z)
    if length < 1e-9:
        return np.eye(3)
    x, y, z = x / length, y / length, z / length
    # Plain numbers: this is called once for every exact check. Across z and the nearer of x and y.
    if abs(x) < abs(y):
        size = sqrt(y * y + z * z)
        first = (0.0, z / size, -y / size)
    else:
        size = sqrt(x * x + z * z)
        first = (z / size, 0.0, -x / size)
    a, b, c = first
    second = (y * c - z * b, z * a - x * c, x * b - y * a)
    return np.array([[a, second[0], x], [b, second[1], y], [c, second[2], z]])
