import numpy as np
import pytest

from meshes import bump, grid, groove
from skinplan.errors import MeshEmptyError, MeshNotFiniteError
from skinplan.mesh.check import check_mesh
from skinplan.mesh.load import load_mesh
from skinplan.mesh.model import SurfaceMesh
from skinplan.mesh.segment import segment_mesh


def test_smooth_panels_have_no_regions():
    panel = grid(1.8, 1.0, 0.01, lambda x, y: 0.25 * y**2 + 0.02 * np.sin(6 * x))
    found = segment_mesh(panel)
    assert found.regions == 0
    assert not found.face_region.any()


def domes(x, y, height, diameter=0.005, pitch=0.025, rows=0.2):
    """Rows of rivet heads: caps of spheres, the high ones on a shank."""
    dx = (x + 0.0007) % pitch - pitch / 2
    dy = (y + 0.0004) % rows - rows / 2
    aside, radius = np.hypot(dx, dy), diameter / 2
    sphere = max(radius, (radius**2 + height**2) / (2 * height))
    cap = np.sqrt(np.maximum(sphere**2 - aside**2, 0.0)) - sphere + height
    return np.where(aside < radius, cap, 0.0)


@pytest.mark.parametrize("cell", [0.0015, 0.003, 0.005, 0.008])
@pytest.mark.parametrize("height", [0.002, 0.005])
def test_rivets_are_no_features(cell, height):
    mesh = grid(0.6, 0.3, cell, lambda x, y: 0.2 * y**2 + domes(x, y, height))
    assert domes(*mesh.vertices[:, :2].T, height).max() > 0.3 * height
    assert segment_mesh(mesh).regions == 0


@pytest.mark.parametrize("cell", [0.002, 0.005, 0.010, 0.015])
def test_a_deep_groove_is_a_feature_between_rivets(cell):
    mesh = grid(
        0.8, 0.4, cell, lambda x, y: 0.2 * y**2 + groove(x + 0.013) + domes(x - 0.1, y, 0.002)
    )
    found = segment_mesh(mesh)
    assert found.regions == 1
    x = mesh.centroids[:, 0]
    assert found.face_region[np.abs(x + 0.013) < 0.02].all()
    assert not found.face_region[np.abs(x + 0.013) > 0.02 + 0.060 + cell / 3].any()


@pytest.mark.parametrize("cell", [0.002, 0.005, 0.010, 0.015])
def test_a_bump_is_a_feature(cell):
    mesh = grid(0.6, 0.5, cell, lambda x, y: 0.2 * y**2 + bump(x - 0.004, y, height=0.030))
    found = segment_mesh(mesh)
    assert found.regions == 1
    aside = np.hypot(mesh.centroids[:, 0] - 0.004, mesh.centroids[:, 1])
    assert found.face_region[aside < 0.1].all()
    assert not found.face_region[aside > 0.1 + 0.060 + cell / 3].any()


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


def test_vertices_that_are_no_numbers():
    mesh = grid(0.2, 0.2, 0.02)
    broken = SurfaceMesh(np.where(mesh.vertices > 0.09, np.nan, mesh.vertices), mesh.faces)
    with pytest.raises(MeshNotFiniteError, match="accepted"):
        segment_mesh(broken)


@pytest.mark.parametrize(
    "faces", [[[0, 1, 2]], [[0, 1, 2], [0, 2, 1]], [[0, 1, 1]], [[0, 1, 2], [3, 4, 5]]]
)
def test_odd_meshes_do_not_crash(faces):
    vertices = np.random.default_rng(0).uniform(0, 0.1, (7, 3))
    found = segment_mesh(SurfaceMesh(vertices, np.array(faces)))
    assert found.face_region.shape == (len(faces),)
    assert np.isfinite(found.smoothed.vertices).all()
