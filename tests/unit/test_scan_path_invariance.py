"""The plan of strategy ``published`` hangs on the shape of the part alone."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree

from meshes import bump, grid, moved, random_transform
from skinplan.mesh.check import check_mesh
from skinplan.mesh.load import load_mesh
from skinplan.mesh.model import SurfaceMesh
from skinplan.mesh.segment import segment_mesh
from skinplan.part.model import ScanSettings
from skinplan.part.samples import sample_panel
from skinplan.part.shapes import write_stl
from skinplan.plan_record import scan_path_hash
from skinplan.scan_path.plan import plan_scan_path

SETTINGS = dataclasses.replace(ScanSettings(), strategy="published")
HERE = np.eye(4)


def planned(mesh, **settings):
    return plan_scan_path(mesh, segment_mesh(mesh), dataclasses.replace(SETTINGS, **settings))


def uneven():
    """A panel with a bump and a slanted end; its triangles are uneven."""
    flat = grid(1.0, 0.6, 0.0097)
    vertices = flat.vertices + 0.0
    inner = (np.abs(vertices[:, 0]) < 0.49) & (np.abs(vertices[:, 1]) < 0.29)
    shift = np.random.default_rng(7).uniform(-0.002, 0.002, (len(vertices), 2))
    vertices[inner, :2] += shift[inner]
    vertices[:, 0] *= 1.0 + 0.1 * vertices[:, 1]
    x, y = vertices[:, 0], vertices[:, 1]
    vertices[:, 2] = 0.2 * y**2 + bump(x - 0.0123, y + 0.0071, 0.05, 0.12, 0.03)
    return SurfaceMesh(vertices, flat.faces)


def scene(name, triangles=20_000):
    return SurfaceMesh(*sample_panel(name).triangulate(triangles))


def assert_same(found, wanted, T=HERE, ordered=True):
    assert len(found) == len(wanted)
    assert found.feature_points == wanted.feature_points
    positions = wanted.positions @ T[:3, :3].T + T[:3, 3]
    directions = wanted.directions @ T[:3, :3].T
    match = np.arange(len(found)) if ordered else cKDTree(found.positions).query(positions)[1]
    assert len(np.unique(match)) == len(found)
    np.testing.assert_allclose(found.positions[match], positions, atol=1e-6)
    np.testing.assert_allclose(found.directions[match], directions, atol=1e-6)
    if ordered:
        np.testing.assert_array_equal(found.kinds, wanted.kinds)
        np.testing.assert_array_equal(found.groups, wanted.groups)


@pytest.mark.parametrize("seed", [1, 2, 21])
@pytest.mark.parametrize("name", ["uneven", "scene3", "scene4"])
def test_the_plan_moves_with_the_part(name, seed):
    mesh, T = uneven() if name == "uneven" else scene(name), random_transform(seed)
    assert_same(planned(moved(mesh, T)), planned(mesh), T)


def test_rows_of_a_part_whose_ends_are_alike_may_run_the_other_way():
    mesh, T = scene("scene1"), random_transform(1)
    assert_same(planned(moved(mesh, T)), planned(mesh), T, ordered=False)


def test_a_given_row_direction_moves_with_the_part():
    mesh, T = uneven(), random_transform(4)
    direction = np.array([0.3, 1.0, 0.0])
    assert_same(
        planned(moved(mesh, T), row_direction=tuple(T[:3, :3] @ direction)),
        planned(mesh, row_direction=tuple(direction)),
        T,
    )


@pytest.mark.parametrize("name", ["uneven", "scene3", "scene4"])
def test_the_order_of_faces_and_vertices_has_no_influence(name):
    mesh, rng = uneven() if name == "uneven" else scene(name), np.random.default_rng(0)
    faces, vertices = rng.permutation(len(mesh.faces)), rng.permutation(len(mesh.vertices))
    mixed = SurfaceMesh(mesh.vertices[vertices], np.argsort(vertices)[mesh.faces][faces])
    assert_same(planned(mixed), planned(mesh))


def test_the_unit_of_the_file_has_no_influence(tmp_path):
    mesh = uneven()
    # Whole 65536ths of a metre are whole numbers of 2^-13 mm times 125: exact in both files.
    vertices = np.round(mesh.vertices * 65536) / 65536
    paths = []
    for unit, scale in (("m", 1.0), ("mm", 1000.0)):
        write_stl(tmp_path / f"{unit}.stl", vertices * scale, mesh.faces)
        loaded, _ = check_mesh(load_mesh(tmp_path / f"{unit}.stl", unit))
        paths.append(planned(loaded))
    assert_same(*paths)
    assert scan_path_hash(paths[0]) == scan_path_hash(paths[1])


@pytest.mark.parametrize("name", ["scene1", "scene3", "scene4"])
def test_other_triangles_have_about_the_same_plan(name):
    """From 15 mm to 4 mm wide triangles the number of points changes by at most 4 %."""
    counts = [len(planned(scene(name, triangles))) for triangles in (20_000, 100_000, 300_000)]
    assert max(counts) <= 1.04 * min(counts)


def test_triangles_too_large_for_grooves_thin_out_their_points():
    """Walls 8 mm wide on 6.5 mm wide triangles: up to 15 % fewer points; 2.9 mm will do."""
    coarse, middle, fine = (
        len(planned(scene("scene2", triangles))) for triangles in (20_000, 100_000, 300_000)
    )
    assert coarse >= 0.85 * fine
    assert middle == pytest.approx(fine, rel=0.05)
