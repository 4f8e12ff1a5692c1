import numpy as np
import pytest

from meshes import grid, half_cylinder, moved, random_transform
from skinplan.mesh.curvature import largest_curvature, vertex_curvatures
from skinplan.mesh.smooth import Smoother, smooth_mesh

INNER = 0.06


def inner(mesh):
    return (np.abs(mesh.vertices[:, 0]) < 0.15 - INNER) & (np.abs(mesh.vertices[:, 1]) < 0.08)


@pytest.mark.parametrize("radius", [0.15, 0.5, 2.0])
@pytest.mark.parametrize("cell", [0.004, 0.01])
def test_cylinder_and_sphere(radius, cell):
    cylinder = half_cylinder(radius, 0.3, cell, half_angle=0.12 / radius)
    found = largest_curvature(vertex_curvatures(cylinder))[inner(cylinder)]
    np.testing.assert_allclose(found, 1 / radius, rtol=0.01)
    cap = grid(0.3, 0.24, cell, lambda x, y: np.sqrt((2 * radius) ** 2 - x**2 - y**2))
    found = largest_curvature(vertex_curvatures(cap))[inner(cap)]
    np.testing.assert_allclose(found, 0.5 / radius, rtol=0.03)


def test_saddle_has_curvatures_of_both_signs():
    saddle = grid(0.3, 0.3, 0.005, lambda x, y: 2.0 * (x**2 - y**2))
    tensors = vertex_curvatures(saddle)
    middle = np.argmin(np.linalg.norm(saddle.vertices, axis=1))
    assert largest_curvature(tensors)[middle] == pytest.approx(4.0, rel=0.01)
    assert tensors[middle, :3].sum() == pytest.approx(0.0, abs=0.02)


def test_invariance_under_rigid_transforms():
    mesh = grid(0.3, 0.2, 0.01, lambda x, y: 0.5 * x**2 + x * y)
    turned = moved(mesh, random_transform(5))
    np.testing.assert_allclose(
        largest_curvature(vertex_curvatures(turned)),
        largest_curvature(vertex_curvatures(mesh)),
        atol=1e-9,
    )


@pytest.mark.parametrize("cell", [0.002, 0.004, 0.008])
def test_smoothing_depends_on_length_and_not_on_triangles(cell):
    """A wave of the wave number w keeps exp(-(s w)^2 / 2) of its height under diffusion by s."""
    length, wave = 0.006, 2 * np.pi / 0.05
    mesh = grid(0.4, 0.1, cell, lambda x, y: 0.001 * np.cos(wave * x))
    smoothed = Smoother(mesh).smooth(mesh.vertices, length, fix_boundary=True)
    middle = (np.abs(mesh.vertices[:, 0]) < 0.1) & (np.abs(mesh.vertices[:, 1]) < 0.01)
    kept = np.ptp(smoothed[middle, 2]) / np.ptp(mesh.vertices[middle, 2])
    assert kept == pytest.approx(np.exp(-((length * wave) ** 2) / 2), abs=0.06)


def test_edges_stay_and_panels_keep_their_shape():
    mesh = grid(0.6, 0.4, 0.01, lambda x, y: 0.25 * y**2)
    smoothed = smooth_mesh(mesh)
    on_edge = (np.abs(np.abs(mesh.vertices[:, 0]) - 0.3) < 1e-9) | (
        np.abs(np.abs(mesh.vertices[:, 1]) - 0.2) < 1e-9
    )
    np.testing.assert_array_equal(smoothed.vertices[on_edge], mesh.vertices[on_edge])
    assert np.abs(smoothed.vertices - mesh.vertices).max() < 1e-4
    np.testing.assert_array_equal(smooth_mesh(mesh, 0.0).vertices, mesh.vertices)
