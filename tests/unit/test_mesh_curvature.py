import numpy as np
import pytest
from scipy.spatial import Delaunay

from meshes import grid, half_cylinder, moved, random_transform
from skinplan.mesh.curvature import largest_curvature, vertex_curvatures
from skinplan.mesh.model import SurfaceMesh
from skinplan.mesh.smooth import Smoother, smooth_mesh
from skinplan.mesh.topology import edge_table

INNER = 0.06
BLUR = 0.010


def curvatures(mesh, blur=BLUR):
    edges = edge_table(mesh.faces)
    return vertex_curvatures(mesh, blur, Smoother(mesh, edges), edges)


def inner(mesh):
    return (np.abs(mesh.vertices[:, 0]) < 0.15 - INNER) & (np.abs(mesh.vertices[:, 1]) < 0.06)


def scattered(length, width, cell, height, seed=0):
    """A height field over random points: triangles of all shapes."""
    rng = np.random.default_rng(seed)
    rim = grid(length, width, cell)
    on_rim = (np.abs(np.abs(rim.vertices[:, 0]) - length / 2) < 1e-9) | (
        np.abs(np.abs(rim.vertices[:, 1]) - width / 2) < 1e-9
    )
    inside = rng.uniform(-0.5, 0.5, ((~on_rim).sum(), 2)) * [length - cell, width - cell]
    flat = np.concatenate([rim.vertices[on_rim, :2], inside])
    faces = Delaunay(flat).simplices.astype(np.int64)
    a, b, c = (flat[corner] for corner in faces.T)
    areas = np.cross(np.c_[b - a, np.zeros(len(a))], np.c_[c - a, np.zeros(len(a))])[:, 2]
    faces = np.where(areas[:, None] < 0, faces[:, ::-1], faces)[np.abs(areas) > 1e-12]
    return SurfaceMesh(np.c_[flat, height(flat[:, 0], flat[:, 1])], faces)


@pytest.mark.parametrize("radius", [0.15, 0.5, 2.0])
@pytest.mark.parametrize("cell", [0.004, 0.01])
def test_cylinder_and_sphere(radius, cell):
    cylinder = half_cylinder(radius, 0.3, cell, half_angle=0.12 / radius)
    found = largest_curvature(curvatures(cylinder))[inner(cylinder)]
    np.testing.assert_allclose(found, 1 / radius, rtol=0.01)
    cap = grid(0.3, 0.24, cell, lambda x, y: np.sqrt((2 * radius) ** 2 - x**2 - y**2))
    found = largest_curvature(curvatures(cap))[inner(cap)]
    np.testing.assert_allclose(found, 0.5 / radius, rtol=0.03)


def test_cylinder_of_random_triangles():
    radius = 0.3
    mesh = scattered(0.3, 0.24, 0.004, lambda x, y: np.sqrt(radius**2 - y**2))
    found = largest_curvature(curvatures(mesh))[inner(mesh)]
    assert np.median(found) == pytest.approx(1 / radius, rel=0.05)
    assert np.abs(found * radius - 1).max() < 0.35


def test_long_triangles_measure_as_compact_ones():
    radius = 0.3
    for stretch in (0.2, 5.0):
        mesh = grid(0.3, 0.24 / stretch, 0.004, None)
        flat = mesh.vertices * [1.0, stretch, 1.0]
        bent = np.c_[flat[:, :2], np.sqrt(radius**2 - flat[:, 1] ** 2)]
        mesh = SurfaceMesh(bent, mesh.faces)
        found = largest_curvature(curvatures(mesh, 0.012))[inner(mesh)]
        np.testing.assert_allclose(found, 1 / radius, rtol=0.1)


def test_saddle_has_curvatures_of_both_signs():
    saddle = grid(0.3, 0.3, 0.005, lambda x, y: 2.0 * (x**2 - y**2))
    tensors = curvatures(saddle)
    middle = np.argmin(np.linalg.norm(saddle.vertices, axis=1))
    assert largest_curvature(tensors)[middle] == pytest.approx(4.0, rel=0.02)
    assert tensors[middle, :3].sum() == pytest.approx(0.0, abs=0.03)


def test_bumps_are_positive_and_recesses_negative():
    for sign in (1.0, -1.0):
        mesh = grid(0.3, 0.24, 0.006, lambda x, y, sign=sign: -sign * (x**2 + y**2))
        middle = np.argmin(np.linalg.norm(mesh.vertices, axis=1))
        assert sign * curvatures(mesh)[middle, :3].sum() == pytest.approx(4.0, rel=0.03)


def test_invariance_under_rigid_transforms():
    mesh = grid(0.3, 0.2, 0.01, lambda x, y: 0.5 * x**2 + x * y)
    turned = moved(mesh, random_transform(5))
    np.testing.assert_allclose(
        largest_curvature(curvatures(turned)), largest_curvature(curvatures(mesh)), atol=1e-9
    )


@pytest.mark.parametrize("cell", [0.001, 0.002, 0.004, 0.008])
def test_smoothing_depends_on_length_and_not_on_triangles(cell):
    """A wave of the wave number w keeps exp(-(s w)^2 / 2) of its height under diffusion by s."""
    length, wave = 0.006, 2 * np.pi / 0.05
    mesh = grid(0.4, 0.1, cell, lambda x, y: 0.001 * np.cos(wave * x))
    smoothed = Smoother(mesh).smooth(mesh.vertices, length, fix_boundary=True)
    middle = (np.abs(mesh.vertices[:, 0]) < 0.1) & (np.abs(mesh.vertices[:, 1]) < 0.01)
    kept = np.ptp(smoothed[middle, 2]) / np.ptp(mesh.vertices[middle, 2])
    assert kept == pytest.approx(np.exp(-((length * wave) ** 2) / 2), abs=0.06)


@pytest.mark.parametrize("cell", [0.0007, 0.002, 0.006, 0.02])
def test_a_peak_spreads_to_a_bell_of_the_length(cell):
    """Sum and variance are those of the heat equation, exactly, at every triangle size."""
    length = 0.006
    mesh = grid(20 * cell + 0.08, 20 * cell + 0.08, cell)
    areas = Smoother(mesh)._mass
    peak = np.zeros((len(areas), 1))
    middle = np.argmin(np.linalg.norm(mesh.vertices, axis=1))
    peak[middle] = 1 / areas[middle]
    bell = areas * Smoother(mesh).smooth(peak, length, fix_boundary=False)[:, 0]
    assert bell.sum() == pytest.approx(1.0, abs=1e-9)
    offsets = mesh.vertices[:, :2] - mesh.vertices[middle, :2]
    np.testing.assert_allclose(bell @ offsets**2, length**2, rtol=1e-3)


def test_tiny_triangles_do_no_harm():
    """Triangles far smaller than the stages can cover: the rest comes out as without them."""
    flat = grid(0.2, 0.2, 0.01)
    extra = np.array([[0.00501, 0.0030, 0], [0.00501, 0.0030 + 2e-5, 0], [0.00502, 0.0031, 0]])
    points = np.concatenate([flat.vertices, extra])[:, :2]
    faces = Delaunay(points).simplices.astype(np.int64)
    heights = 0.002 * np.sin(points[:, 0] / 0.02)
    mesh = SurfaceMesh(np.c_[points, heights], faces)
    found = Smoother(mesh).smooth(mesh.vertices, 0.006, fix_boundary=True)
    assert np.isfinite(found).all()
    assert np.abs(found - mesh.vertices).max() < 1e-3
    assert np.isfinite(curvatures(mesh)).all()


def test_edges_stay_and_panels_keep_their_shape():
    mesh = grid(0.6, 0.4, 0.01, lambda x, y: 0.25 * y**2)
    smoothed = smooth_mesh(mesh)
    on_edge = (np.abs(np.abs(mesh.vertices[:, 0]) - 0.3) < 1e-9) | (
        np.abs(np.abs(mesh.vertices[:, 1]) - 0.2) < 1e-9
    )
    np.testing.assert_array_equal(smoothed.vertices[on_edge], mesh.vertices[on_edge])
    assert np.abs(smoothed.vertices - mesh.vertices).max() < 1e-4
    np.testing.assert_array_equal(smooth_mesh(mesh, 0.0).vertices, mesh.vertices)
