import numpy as np

from meshes import grid
from skinplan.mesh.model import SurfaceMesh
from skinplan.robot.distance_field import DistanceField


def plate_distance(points, length, width):
    beside = np.maximum(np.abs(points[:, :2]) - 0.5 * np.array([length, width]), 0.0)
    return np.linalg.norm(np.column_stack([beside, points[:, 2]]), axis=1)


def test_the_stated_error_holds_for_a_plate():
    for mesh in (grid(0.8, 0.5, 0.02), grid(0.8, 0.5, 0.5)):  # the second of a few huge triangles
        field = DistanceField(mesh)
        points = np.random.default_rng(0).uniform((-1, -1, -1), (1, 1, 1), (5000, 3))
        true = plate_distance(points, 0.8, 0.5)
        found = field.distance(points)
        near = true < field.reach - field.error
        assert np.abs(found - true)[near].max() <= field.error
        assert np.all(found[~near] >= field.reach - 2.0 * field.error)
        assert np.all(found <= true + field.error)
        assert field.error < 0.035


def test_far_points_are_never_called_near():
    field = DistanceField(grid(0.8, 0.5, 0.05))
    points = np.array([[5.0, 0, 0], [0.0, -3.0, 0.1], [0.0, 0.0, 40.0]])
    assert np.all(field.distance(points) >= field.reach)


def test_a_single_triangle_is_enough():
    mesh = SurfaceMesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    field = DistanceField(mesh)
    inside = np.array([[0.3, 0.3, 0.0], [0.3, 0.3, 0.1]])
    assert np.abs(field.distance(inside) - (0.0, 0.1)).max() <= field.error
