import numpy as np
import pytest
from scipy.spatial import cKDTree

from skinplan.mesh.model import SurfaceMesh
from skinplan.part.engine import KNOWN_POINTS, engine_mesh, engine_placement, engine_points


@pytest.fixture(scope="module")
def mesh():
    return engine_mesh()


def test_the_known_points_are_the_first_and_last_of_their_surfaces():
    points, _, surfaces = engine_points()
    assert np.bincount(surfaces).tolist() == [0, 50, 50, 50]
    for surface in (1, 2, 3):
        mine = points[surfaces == surface]
        assert np.abs(mine[[0, -1]] - KNOWN_POINTS[surface - 1]).max() < 1e-9


def test_stations_of_step_3_are_the_published_ones():
    """C Table 4: y of the three stations."""
    y = engine_points()[0][:, 1]
    middles = [y.min() + (2 * i - 1) * np.ptp(y) / 6 for i in (1, 2, 3)]
    assert np.abs(np.array(middles) + [2.060877, 1.283429, 0.505981]).max() < 1e-5


def test_a_surface_is_an_equal_grid_of_its_parameters():
    points, normals, _ = engine_points()
    grid = points[50:100].reshape(10, 5, 3)
    along = np.diff(grid, axis=1)
    assert np.allclose(along, along[0, 0], atol=1e-5)  # a cylinder: equal steps along the axis
    around = np.linalg.norm(np.diff(grid[:, 0], axis=0), axis=1)
    assert np.ptp(around) < 1e-6
    assert np.allclose(np.linalg.norm(normals, axis=1), 1.0)
    assert np.all(points[:, 0] > 0.0) and np.all(normals[:, 0] > 0.0)


def test_the_mesh_has_the_published_sizes_and_is_closed(mesh):
    low, high = mesh.bounds
    assert high[1] - low[1] == pytest.approx(2.6, abs=1e-3)
    assert (low[2], high[2]) == pytest.approx((0.0, 0.6), abs=1e-6)
    edges = np.sort(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    assert np.all(np.unique(edges, axis=0, return_counts=True)[1] == 2)
    assert 90_000 < len(mesh.faces) < 110_000


def test_the_mesh_looks_outward(mesh):
    """The divergence theorem: signed volume against cone and cylinders."""
    a, b, c = mesh.corners[:, 0], mesh.corners[:, 1], mesh.corners[:, 2]
    volume = np.einsum("ni,ni->n", a, np.cross(b, c)).sum() / 6.0
    cone = np.pi * 0.7 / 3.0 * (0.30**2 + 0.30 * 0.15 + 0.15**2)
    expected = cone + np.pi * (0.145**2 * 1.0 + 0.130**2 * 0.9)
    assert volume == pytest.approx(expected, rel=2e-3)


def test_points_and_normals_are_those_of_the_mesh(mesh):
    points, normals, _ = engine_points()
    _, nearest = cKDTree(mesh.centroids).query(points)
    face = mesh.face_normals[nearest]
    gap = np.einsum("ni,ni->n", points - mesh.centroids[nearest], face)
    assert np.abs(gap).max() < 2e-4  # the chord of a facet
    assert np.einsum("ni,ni->n", face, normals).min() > np.cos(np.radians(2.0))


def test_the_mesh_is_the_same_each_time_and_as_coarse_as_asked():
    first, again = engine_mesh(2000), engine_mesh(2000)
    assert isinstance(first, SurfaceMesh)
    assert np.array_equal(first.vertices, again.vertices)
    assert 1500 < len(first.faces) < 2500


def test_the_arm_base_of_the_paper_is_752_mm_above_the_floor():
    assert np.allclose(engine_placement()[:3, 3], (0.0, 0.0, 0.752))
    assert np.allclose(engine_placement()[:3, :3], np.eye(3))
