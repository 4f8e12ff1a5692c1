import hashlib

import numpy as np
import pytest

from skinplan.errors import PartNotFoundError
from skinplan.mesh.load import load_mesh
from skinplan.part.samples import SAMPLES, sample_folder, sample_panel, write_sample

SIZES = {"scene1": (1.8, 1.0), "scene2": (0.7, 0.6), "scene3": (2.5, 0.9), "scene4": (2.9, 0.8)}
# Share of the area steeper than 50 degrees, and the steepest wall that the scene describes.
STEEP = {"scene1": (0.0, 15), "scene2": (0.16, 62), "scene3": (0.04, 65), "scene4": (0.07, 68)}


@pytest.fixture(scope="module", params=SAMPLES)
def sample(request, tmp_path_factory):
    part = write_sample(request.param, tmp_path_factory.mktemp(request.param))
    return part, load_mesh(part.mesh_path, part.unit)


def test_size_and_place(sample):
    part, mesh = sample
    np.testing.assert_allclose(np.ptp(mesh.bounds, axis=0)[:2], SIZES[part.id], atol=1e-6)
    np.testing.assert_allclose(mesh.bounds.mean(axis=0), 0.0, atol=1e-6)
    assert 95_000 < len(mesh.faces) < 105_000
    assert mesh.sha256 == part.mesh_sha256
    assert mesh.face_normals[:, 2].min() > 0


def test_walls(sample):
    part, mesh = sample
    share, wall = STEEP[part.id]
    slope = np.degrees(np.arccos(mesh.face_normals[:, 2]))
    steep = mesh.face_areas[slope > 50].sum() / mesh.area
    assert steep == pytest.approx(share, abs=0.012)
    assert wall - 4 < slope.max() < wall + 3 or share == 0 and slope.max() < wall


@pytest.mark.parametrize("name", SAMPLES)
def test_heights_of_the_features(name):
    for feature in sample_panel(name).features:
        x, y = (np.array([value]) for value in feature.centre_m)
        assert feature.height(x, y)[0] == pytest.approx(feature.height_m, abs=1e-12)
        edge = x + feature.size_m[0] / 2
        assert feature.height(edge, y)[0] == pytest.approx(feature.height_m / 2, abs=1e-9)
        assert feature.height(x + feature.size_m[0], y)[0] == 0.0


def test_the_surface_has_no_steps():
    feature = sample_panel("scene4").features[2]
    x = np.linspace(-0.3, 0.3, 60001)
    height = feature.height(x + feature.centre_m[0], np.full_like(x, feature.centre_m[1]))
    slope = np.diff(height) / np.diff(x)
    assert np.abs(slope).max() == pytest.approx(np.tan(feature.wall_rad), rel=1e-4)
    assert np.abs(np.diff(slope)).max() < 0.02


def test_same_bytes_every_time(tmp_path):
    first = write_sample("scene3", tmp_path / "a", triangles=5000)
    second = write_sample("scene3", tmp_path / "b", triangles=5000)
    assert first.mesh_path.read_bytes() == second.mesh_path.read_bytes()
    assert first.source.read_bytes() == second.source.read_bytes()
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == ["part.yaml", "scene3.stl"]
    assert hashlib.sha256(first.mesh_path.read_bytes()).hexdigest() == first.mesh_sha256


def test_same_bytes_on_every_python(tmp_path):
    part = write_sample("scene2", tmp_path, triangles=5000)
    assert part.mesh_sha256.startswith("84d56ac3ba8e")


def test_unknown_sample(tmp_path):
    with pytest.raises(PartNotFoundError, match="scene5.*scene1"):
        write_sample("scene5", tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_the_cache_can_be_moved(tmp_path, monkeypatch):
    monkeypatch.setenv("SKINPLAN_CACHE", str(tmp_path))
    assert sample_folder().parent == tmp_path
