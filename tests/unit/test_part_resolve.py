import numpy as np
import pytest

from meshes import grid
from skinplan.errors import (
    MeshNotFoundError,
    MeshUnitError,
    PartInvalidError,
    PartNotFoundError,
)
from skinplan.part.defaults import default_fixture, default_placement
from skinplan.part.resolve import resolve_part
from skinplan.part.samples import write_sample
from skinplan.part.shapes import write_stl


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("SKINPLAN_CACHE", str(tmp_path / "cache"))


def write_panel(path, scale=1.0):
    mesh = grid(2.0, 0.8, 0.1)
    write_stl(path, mesh.vertices * scale, mesh.faces)
    return path


def test_a_sample_by_name_twice_is_the_same():
    first = resolve_part("scene2")
    assert first.id == "scene2"
    assert first.source.is_file()
    stamp = first.mesh_path.stat().st_mtime_ns
    assert resolve_part("scene2").mesh_path.stat().st_mtime_ns == stamp


def test_a_part_file_by_path_and_uri(tmp_path):
    part = write_sample("scene1", tmp_path / "my part", triangles=500)
    assert resolve_part(str(part.source)).mesh_sha256 == part.mesh_sha256
    assert resolve_part(part.source.as_uri()).mesh_path == part.mesh_path
    with pytest.raises(PartInvalidError, match="unit mm"):
        resolve_part(str(part.source), unit="mm")


def test_a_bare_mesh_gets_a_part_file(tmp_path):
    mesh = write_panel(tmp_path / "wing skin.stl", scale=1000.0)
    part = resolve_part(str(mesh), "mm", tmp_path / "run" / "part")
    assert (part.id, part.unit) == ("wing_skin", "mm")
    again = resolve_part(part.source.as_uri())
    assert again.mesh_path == mesh
    np.testing.assert_allclose(again.T_map_workpiece, part.T_map_workpiece, atol=1e-11)
    assert resolve_part(str(mesh), "mm").source is None


def test_wrong_unit_names_the_right_one(tmp_path):
    mesh = write_panel(tmp_path / "wing.stl", scale=1450.0)
    with pytest.raises(MeshUnitError, match=r"2\.9 km.*did you mean unit mm"):
        resolve_part(str(mesh))


@pytest.mark.parametrize(
    "reference", ["scene9", "", "nothing/here", "http://x/part.yaml", "a\0b", "part.xml"]
)
def test_nothing_of_that_name(reference):
    with pytest.raises(PartNotFoundError, match=r"accepted|part\.yaml"):
        resolve_part(reference)


def test_missing_mesh_and_file_of_another_kind(tmp_path):
    with pytest.raises(MeshNotFoundError, match=r"none\.stl"):
        resolve_part(str(tmp_path / "none.stl"))
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(PartNotFoundError, match=r"notes\.txt"):
        resolve_part(str(tmp_path / "notes.txt"))


def test_default_fixture_and_placement():
    bounds = np.array([[-1.45, -0.4, -0.1], [1.45, 0.4, 0.1]])
    fixture = default_fixture(bounds)
    assert fixture.T_workpiece_fixture[1, 3] == pytest.approx(-0.5)
    places = [fixture.T_workpiece_marker(marker.id)[0, 3] for marker in fixture.markers]
    np.testing.assert_allclose(np.diff(places), 0.4)
    assert sum(places) == pytest.approx(0.0)
    assert min(places) - 0.05 >= -1.45
    T = default_placement(bounds)
    # Workpiece z looks to map -y, workpiece y up.
    np.testing.assert_allclose(T[:3, :3] @ [0, 0, 1], [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(T[:3, :3] @ [0, 1, 0], [0, 0, 1], atol=1e-12)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
    assert T[2, 3] == pytest.approx(1.05)


@pytest.mark.parametrize("half_height", [0.1, 0.3, 0.5, 0.8])
def test_markers_hang_low_enough_for_the_camera(half_height):
    bounds = np.array([[-0.5, -half_height, 0.0], [0.5, half_height, 0.1]])
    fixture = default_fixture(bounds)
    height = (default_placement(bounds) @ fixture.T_workpiece_marker(0))[2, 3]
    assert height <= 0.55 + 1e-9
    assert fixture.T_workpiece_marker(0)[1, 3] <= -half_height - 0.1 + 1e-9


def test_a_high_part_stands_clear_of_the_floor_and_a_short_one_has_two_markers():
    bounds = np.array([[-0.15, -0.7, 0.0], [0.15, 0.7, 0.1]])
    assert default_placement(bounds)[2, 3] == pytest.approx(1.25)
    fixture = default_fixture(bounds)
    first, second = (fixture.T_workpiece_marker(number)[0, 3] for number in (0, 1))
    assert second - first >= 0.15
