import struct

import numpy as np
import pytest
import trimesh

from meshes import grid
from skinplan.errors import (
    MeshEmptyError,
    MeshNotFiniteError,
    MeshNotFoundError,
    MeshUnitError,
    MeshUnreadableError,
)
from skinplan.mesh.load import file_sha256, load_mesh, merge_vertices
from skinplan.mesh.merge import _keys
from skinplan.part.shapes import write_stl

PANEL = grid(1.0, 0.5, 0.1, lambda x, y: 0.1 * x * y)


def write(folder, kind, mesh=PANEL, scale=1.0):
    path = folder / f"panel.{kind.split('_')[0]}"
    exported = trimesh.Trimesh(mesh.vertices * scale, mesh.faces, process=False).export(
        file_type=kind
    )
    path.write_bytes(exported.encode() if isinstance(exported, str) else exported)
    return path


@pytest.mark.parametrize("kind", ["stl", "stl_ascii", "ply", "obj"])
@pytest.mark.parametrize(("unit", "scale"), [("m", 1.0), ("mm", 1000.0), ("inch", 1 / 0.0254)])
def test_every_format_and_unit_gives_the_same_mesh(tmp_path, kind, unit, scale):
    path = write(tmp_path, kind, scale=scale)
    mesh = load_mesh(path, unit)
    assert (len(mesh.vertices), len(mesh.faces)) == (len(PANEL.vertices), len(PANEL.faces))
    np.testing.assert_allclose(mesh.corners, PANEL.corners, atol=1e-6)
    assert mesh.sha256 == file_sha256(path)


def test_merging_keeps_every_corner():
    rng = np.random.default_rng(3)
    points = rng.integers(-3, 4, (5000, 3)).astype(float)
    points[::7] *= -0.0
    faces = rng.integers(0, 5000, (3000, 3))
    vertices, merged = merge_vertices(points, faces)
    np.testing.assert_array_equal(vertices[merged], points[faces])
    assert len(vertices) == len(np.unique(points, axis=0))


def stl(corners, count=None):
    faces = np.asarray(corners, dtype="<f4").reshape(-1, 9)
    records = b"".join(bytes(12) + face.tobytes() + b"\0\0" for face in faces)
    return bytes(80) + struct.pack("<I", len(faces) if count is None else count) + records


TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]


@pytest.mark.parametrize(
    ("name", "data", "error"),
    [
        ("a.stl", b"", MeshEmptyError),
        ("a.stl", stl(np.zeros((0, 9))), MeshEmptyError),
        ("a.stl", b"solid empty\nendsolid empty\n", MeshEmptyError),
        ("a.stl", stl([[[np.nan, 0, 0], *TRIANGLE[1:]]]), MeshNotFiniteError),
        ("a.stl", stl([[[np.inf, 0, 0], *TRIANGLE[1:]]]), MeshNotFiniteError),
        ("a.stl", stl([TRIANGLE], count=10), MeshUnreadableError),
        ("a.stl", b"GIF89a" + bytes(range(256)), MeshUnreadableError),
        ("a.stl", b"hello world, this is no mesh", MeshUnreadableError),
        ("a.ply", b"hello world", MeshUnreadableError),
        ("a.obj", b"\xff\xd8\xff\xe0 jpeg", (MeshUnreadableError, MeshEmptyError)),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", MeshUnreadableError),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", (MeshUnreadableError, MeshEmptyError)),
        ("a.step", b"ISO-10303-21;", MeshUnreadableError),
        ("a.stl", stl([np.array(TRIANGLE) * 1e-3]), MeshUnitError),
        ("a.stl", stl([np.array(TRIANGLE) * 2900.0]), MeshUnitError),
        ("a.stl", stl([np.zeros((3, 3))]), MeshUnitError),
    ],
)
def test_each_kind_of_bad_file_has_its_error(tmp_path, name, data, error):
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(error) as caught:
        load_mesh(path, "m")
    assert name in str(caught.value)


def test_missing_files_and_folders(tmp_path):
    with pytest.raises(MeshNotFoundError, match=r"none\.stl"):
        load_mesh(tmp_path / "none.stl")
    with pytest.raises(MeshNotFoundError):
        file_sha256(tmp_path / "none.stl")
    with pytest.raises(MeshUnreadableError):
        load_mesh(tmp_path)


@pytest.mark.parametrize(
    ("scale", "unit", "words"),
    [
        (2900.0, "m", r"2\.9 km.*did you mean unit mm or"),
        (0.0029, "m", r"2\.9 mm.*accepted$"),
        (2.9, "mm", r"2\.9 mm.*did you mean unit m or"),
        (2.9, "yard", "yard.*accepted are m, cm, mm, inch"),
    ],
)
def test_the_unit_must_make_a_part(tmp_path, scale, unit, words):
    write_stl(tmp_path / "wing.stl", PANEL.vertices * scale, PANEL.faces)
    with pytest.raises(MeshUnitError, match=words):
        load_mesh(tmp_path / "wing.stl", unit)


def test_points_of_single_precision_do_not_share_a_number():
    """Where two share one, merging falls back to sorting rows, which takes ten times as long."""
    axes = np.linspace(-1.45, 1.45, 700), np.linspace(-0.4, 0.4, 500), (0.0, 0.012)
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3).astype(np.float32).astype(float)
    assert len(np.unique(_keys(points + 0.0))) == len(points)
