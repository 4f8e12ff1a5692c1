import numpy as np
import pytest
from scipy.spatial import cKDTree

from meshes import bump, grid, groove, moved, random_transform
from skinplan.errors import MeshEmptyError
from skinplan.mesh.check import check_mesh
from skinplan.mesh.load import load_mesh
from skinplan.mesh.model import SurfaceMesh
from skinplan.mesh.segment import segment_mesh
from skinplan.part.samples import sample_panel


def regions_at(mesh, points):
    _, nearest = cKDTree(mesh.centroids).query(points)
    return segment_mesh(mesh).face_region[nearest] > 0


def test_smooth_panels_have_no_regions():
    panel = grid(1.8, 1.0, 0.01, lambda x, y: 0.25 * y**2 + 0.02 * np.sin(6 * x))
    found = segment_mesh(panel)
    assert found.regions == 0
    assert not found.face_region.any()


def test_rivets_are_no_features():
    def rivets(x, y):
        dx, dy = (x + 0.0125) % 0.025 - 0.0125, (y + 0.2) % 0.4 - 0.2
        return np.sqrt(np.maximum(0.0065**2 - dx**2 - dy**2, 0.0042**2)) - 0.0042

    assert segment_mesh(grid(0.8, 0.5, 0.002, rivets)).regions == 0


def test_a_groove_and_a_bump_are_features():
    def panel(x, y):
        return bump(x + 0.4, y) + groove(x - 0.4)

    mesh = grid(1.4, 0.6, 0.005, panel)
    found = segment_mesh(mesh)
    assert found.regions == 2
    region = found.face_region
    x, y = mesh.centroids[:, 0], mesh.centroids[:, 1]
    # Numbered along x; the flat top of the bump belongs to it; the flat rest does not.
    assert np.all(region[np.hypot(x + 0.4, y) < 0.1] == 1)
    assert np.all(region[np.abs(x - 0.4) < 0.02] == 2)
    assert not region[(np.hypot(x + 0.4, y) > 0.17) & (np.abs(x - 0.4) > 0.09)].any()


@pytest.mark.parametrize("name", ["scene2", "scene3", "scene4"])
def test_regions_do_not_depend_on_triangle_size(name):
    panel = sample_panel(name)
    meshes = [SurfaceMesh(*panel.triangulate(count)) for count in (20_000, 100_000)]
    points = meshes[0].centroids
    coarse, fine = (regions_at(mesh, points) for mesh in meshes)
    area = meshes[0].face_areas
    common = area[coarse & fine].sum() / area[coarse | fine].sum()
    assert common > {"scene2": 0.85, "scene3": 0.9, "scene4": 0.9}[name]


def test_regions_move_with_the_part():
    mesh = SurfaceMesh(*sample_panel("scene3").triangulate(20_000))
    turned = segment_mesh(moved(mesh, random_transform(8)))
    region = segment_mesh(mesh).face_region > 0
    differing = mesh.face_areas[region != (turned.face_region > 0)].sum()
    assert differing < 1e-3 * mesh.area


def test_noise_of_a_scan_makes_no_regions():
    noise = np.random.default_rng(0)
    mesh = grid(1.0, 0.8, 0.008, lambda x, y: 0.2 * y**2 + noise.normal(0, 5e-5, x.shape))
    assert segment_mesh(mesh).regions == 0


def test_scanned_wing(shared_data):
    path = shared_data / "panels" / "gom_b737_wing_manholes_2.6x0.8.stl"
    mesh, _ = check_mesh(load_mesh(path, "m"))
    found = segment_mesh(mesh)
    share = mesh.face_areas[found.face_region > 0].sum() / mesh.area
    assert 0.05 < share < 0.5


def test_no_faces():
    with pytest.raises(MeshEmptyError):
        segment_mesh(SurfaceMesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)))
