import numpy as np
import pytest
from scipy.spatial import cKDTree

from meshes import bump, grid, half_cylinder, moved, random_transform
from skinplan.mesh.model import SurfaceMesh
from skinplan.scan_path.frame import base_normal, part_frame
from skinplan.scan_path.lattice import lattice_points
from skinplan.scanner.samples import sample_surface

PITCH = 0.01


def panel(cell):
    """A panel with a bump, whose ends and sides all differ."""
    return grid(
        1.0, 0.6, cell, lambda x, y: 0.2 * y**2 + bump(x - 0.11, y + 0.07, 0.06, 0.12, 0.03)
    )


def met(mesh, faces=None):
    chosen = np.ones(len(mesh.faces), dtype=bool) if faces is None else faces
    return lattice_points(mesh, chosen, part_frame(mesh, base_normal(mesh)), PITCH)


def mixed(mesh, seed=0):
    rng = np.random.default_rng(seed)
    vertices, faces = rng.permutation(len(mesh.vertices)), rng.permutation(len(mesh.faces))
    return SurfaceMesh(mesh.vertices[vertices], np.argsort(vertices)[mesh.faces][faces])


@pytest.mark.parametrize(
    "mesh", [panel(0.007), half_cylinder(0.3, 0.5, 0.02, np.pi / 2), grid(0.5, 0.3, 0.3)]
)
def test_points_lie_on_their_faces_and_leave_no_room(mesh):
    found = met(mesh)
    assert found.shares.min() >= -1e-6
    np.testing.assert_allclose(found.shares.sum(axis=1), 1.0)
    again = np.einsum("nc,nci->ni", found.shares, mesh.corners[found.faces])
    np.testing.assert_allclose(again, found.points, atol=1e-12)
    apart, _ = cKDTree(found.points).query(sample_surface(mesh, 0.002).points)
    # In the cells of a lattice on a plane as steep as can be, and at edges a whole one.
    assert apart.max() < np.sqrt(3) * PITCH


def test_only_chosen_faces():
    mesh = panel(0.007)
    chosen = mesh.centroids[:, 0] > 0.1
    found = met(mesh, chosen)
    assert chosen[found.faces].all()
    assert len(met(mesh, np.zeros(len(mesh.faces), dtype=bool)).points) == 0


def test_points_and_order_move_with_the_part():
    mesh, T = panel(0.007), random_transform(6)
    wanted = met(mesh).points @ T[:3, :3].T + T[:3, 3]
    np.testing.assert_allclose(met(moved(mesh, T)).points, wanted, atol=1e-7)


def test_the_order_of_faces_and_vertices_has_no_influence():
    mesh = panel(0.007)
    np.testing.assert_allclose(met(mixed(mesh)).points, met(mesh).points, atol=1e-9)


def test_other_triangles_have_the_same_points_in_the_same_order():
    coarse, fine = met(panel(0.005)).points, met(panel(0.0025)).points
    same, _ = cKDTree(fine).query(coarse)
    assert np.mean(same < 0.001) > 0.97
    # The order is without any: neighbours in it are as far apart as any two.
    steps = np.linalg.norm(np.diff(fine, axis=0), axis=1)
    assert np.median(steps) > 0.25
    places = cKDTree(fine).query(coarse)[1]
    assert np.mean(np.abs(places - np.arange(len(coarse))) < 0.05 * len(fine)) > 0.9


def test_samples_of_a_surface_move_with_it_and_do_not_hang_on_the_order():
    mesh, T = panel(0.007), random_transform(3)
    first = sample_surface(mesh, 0.01).points
    turned = sample_surface(moved(mesh, T), 0.01).points
    np.testing.assert_allclose(turned, first @ T[:3, :3].T + T[:3, 3], atol=1e-9)
    np.testing.assert_allclose(sample_surface(mixed(mesh), 0.01).points, first, atol=1e-9)
