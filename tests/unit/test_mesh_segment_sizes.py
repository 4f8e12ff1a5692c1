"""The same shape in other triangles has the same regions."""

import numpy as np
import pytest
from scipy.spatial import Delaunay

from meshes import moved, random_transform
from skinplan.mesh.model import SurfaceMesh
from skinplan.mesh.segment import segment_mesh
from skinplan.part.samples import sample_panel
from skinplan.scanner.rays import RayCaster
from skinplan.scanner.samples import sample_surface

SCENES = ("scene2", "scene3", "scene4")
# What a mesh of about 15 mm wide triangles of random shape must still have in common.
RANDOM = {("scene2", 20_000): 0.97, ("scene3", 20_000): 0.91, ("scene4", 20_000): 0.91}


def regular(name, triangles):
    return SurfaceMesh(*sample_panel(name).triangulate(triangles))


def heights(panel, flat):
    faces = Delaunay(flat).simplices.astype(np.int64)
    a, b, c = (flat[corner] for corner in faces.T)
    areas = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    faces = np.where(areas[:, None] < 0, faces[:, ::-1], faces)[np.abs(areas) > 1e-9]
    return SurfaceMesh(np.c_[flat, panel.height(flat[:, 0], flat[:, 1])], faces)


def rim(size, step):
    x, y = (np.linspace(-0.5, 0.5, round(side / step) + 1) * side for side in size)
    ends = [np.c_[x, np.full_like(x, side)] for side in (-size[1] / 2, size[1] / 2)]
    ends += [np.c_[np.full_like(y, side), y][1:-1] for side in (-size[0] / 2, size[0] / 2)]
    return np.concatenate(ends)


def random_triangles(name, triangles):
    panel = sample_panel(name)
    size = np.array(panel.size_m)
    cell = np.sqrt(2 * size.prod() / triangles)
    inside = np.random.default_rng(1).uniform(-0.5, 0.5, (triangles // 2, 2)) * (size - cell)
    return heights(panel, np.concatenate([inside, rim(size, cell)]))


def graded_triangles(name, triangles):
    """Small triangles where the surface bends, large ones elsewhere, as a CAD system makes them."""
    panel, rng = sample_panel(name), np.random.default_rng(2)
    size = np.array(panel.size_m)
    x, y = ((rng.uniform(-0.5, 0.5, (20 * triangles, 2))) * (size - 0.02)).T
    step = 0.003
    around = sum(
        panel.height(x + dx, y + dy)
        for dx, dy in ((step, 0.0), (-step, 0.0), (0.0, step), (0.0, -step))
    )
    bend = np.abs(around - 4 * panel.height(x, y)) / step**2
    wanted = np.minimum(bend, 40.0) + 2.0
    kept = rng.uniform(0, 1, len(x)) < wanted / wanted.sum() * triangles / 2
    return heights(panel, np.concatenate([np.c_[x, y][kept], rim(size, 0.012)]))


def stretched_triangles(name, triangles, ratio):
    panel = sample_panel(name)
    cell = np.sqrt(2 * panel.size_m[0] * panel.size_m[1] / triangles)
    columns = round(panel.size_m[0] / cell / np.sqrt(ratio))
    rows = round(panel.size_m[1] / cell * np.sqrt(ratio))
    x, y = np.meshgrid(
        np.linspace(-0.5, 0.5, columns + 1) * panel.size_m[0],
        np.linspace(-0.5, 0.5, rows + 1) * panel.size_m[1],
    )
    row, column = np.divmod(np.arange(rows * columns), columns)
    a = row * (columns + 1) + column
    b, c, d = a + 1, a + columns + 2, a + columns + 1
    faces = np.stack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)], 1).reshape(-1, 3)
    return SurfaceMesh(np.c_[x.ravel(), y.ravel(), panel.height(x, y).ravel()], faces)


def complex_at(mesh, places):
    """Whether the face of the mesh at places x, y belongs to a region."""
    starts = np.c_[places, np.full(len(places), 2.0)]
    _, face = RayCaster(mesh).hits(starts, np.tile([0.0, 0.0, -1.0], (len(places), 1)))
    assert np.mean(face < 0) < 1e-3
    return (segment_mesh(mesh).face_region > 0)[face]


def in_common(name, *meshes):
    """Area that belongs to regions of all meshes over area that belongs to those of any."""
    samples = sample_surface(regular(name, 100_000), 0.003)
    found = [complex_at(mesh, samples.points[:, :2]) for mesh in meshes]
    return np.mean(np.all(found, axis=0)) / np.mean(np.any(found, axis=0))


@pytest.mark.parametrize("name", SCENES)
def test_regular_triangles(name):
    coarse, fine = regular(name, 20_000), regular(name, 100_000)
    assert in_common(name, coarse, fine) >= 0.95


@pytest.mark.long
@pytest.mark.parametrize("name", SCENES)
def test_regular_triangles_up_to_a_million(name):
    meshes = [regular(name, count) for count in (20_000, 100_000, 1_000_000)]
    for one, other in ((0, 2), (1, 2)):
        assert in_common(name, meshes[one], meshes[other]) >= 0.95
    assert in_common(name, *meshes) >= 0.94


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("triangles", [20_000, 100_000])
def test_random_triangles(name, triangles):
    found = in_common(name, random_triangles(name, triangles), regular(name, 100_000))
    assert found >= RANDOM.get((name, triangles), 0.96)


@pytest.mark.parametrize("name", SCENES)
def test_graded_triangles(name):
    assert in_common(name, graded_triangles(name, 60_000), regular(name, 100_000)) >= 0.95


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("ratio", [0.2, 5.0])
def test_stretched_triangles(name, ratio):
    found = in_common(name, stretched_triangles(name, 60_000, ratio), regular(name, 100_000))
    assert found >= 0.95


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("seed", [3, 8])
def test_regions_and_their_numbers_move_with_the_part(name, seed):
    mesh = regular(name, 20_000)
    found = segment_mesh(moved(mesh, random_transform(seed))).face_region
    wanted = segment_mesh(mesh).face_region
    np.testing.assert_array_equal(found > 0, wanted > 0)
    if name != "scene2":  # Its two ends are alike.
        np.testing.assert_array_equal(found, wanted)


def test_the_order_of_faces_and_vertices_has_no_influence():
    mesh, rng = regular("scene4", 20_000), np.random.default_rng(5)
    faces, vertices = rng.permutation(len(mesh.faces)), rng.permutation(len(mesh.vertices))
    mixed = SurfaceMesh(mesh.vertices[vertices], np.argsort(vertices)[mesh.faces][faces])
    np.testing.assert_array_equal(
        segment_mesh(mixed).face_region, segment_mesh(mesh).face_region[faces]
    )
