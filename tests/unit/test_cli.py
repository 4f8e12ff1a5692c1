"""The command: what it prints, how it refuses bad input (code 2, one sentence, no traceback)."""

import json

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

from skinplan.cli import app

runner = CliRunner()


def invoke(*arguments):
    return runner.invoke(app, [str(argument) for argument in arguments])


def flat_mesh(tmp_path, scale=1.0, name="flat.stl"):
    grid = np.stack(
        np.meshgrid(np.linspace(0, 0.6, 13), np.linspace(0, 0.4, 9), indexing="ij"), axis=-1
    )
    number = np.arange(13 * 9).reshape(13, 9)
    a, b, c, d = (
        number[i : 12 + i, j : 8 + j].ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))
    )
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    vertices = np.concatenate([grid.reshape(-1, 2), np.zeros((13 * 9, 1))], axis=1)
    path = tmp_path / name
    trimesh.Trimesh(vertices * scale, faces, process=False).export(path)
    return path


def test_parts_lists_the_four_scenes():
    result = invoke("parts", "--json")
    assert result.exit_code == 0
    names = [sample["name"] for sample in json.loads(result.stdout)["samples"]]
    assert names == ["scene1", "scene2", "scene3", "scene4"]


def test_export_writes_mesh_and_part_file(tmp_path):
    result = invoke("parts", "export", "scene2", tmp_path, "--json")
    assert result.exit_code == 0
    assert (tmp_path / "part.yaml").is_file()
    assert json.loads(result.stdout)["mesh"].endswith(".stl")


def test_check_says_size_and_findings(tmp_path):
    result = invoke("check", flat_mesh(tmp_path), "--json")
    assert result.exit_code == 0
    document = json.loads(result.stdout)
    assert document["area_m2"] == pytest.approx(0.24, rel=1e-5)
    assert document["triangles"] == 192


def test_plan_of_a_bare_mesh_in_millimetres(tmp_path):
    mesh = flat_mesh(tmp_path, scale=1000.0)
    result = invoke("plan", mesh, "--unit", "mm", "--out", tmp_path / "plan", "--json")
    assert result.exit_code == 0, result.stderr
    summary = json.loads(result.stdout)
    keys = {"mesh", "scan_path", "coverage", "stations", "trajectory", "plan_hash", "planning_s"}
    assert keys <= set(summary)
    assert summary["coverage"]["area_ratio"] > 0.99
    written = {path.name for path in (tmp_path / "plan").iterdir()}
    assert written == {"scan_path.json", "stations.json", "trajectories.json", "summary.json"}
    again = invoke("plan", mesh, "--unit", "mm", "--json")
    assert json.loads(again.stdout)["plan_hash"] == summary["plan_hash"]


def broken_mesh(tmp_path, kind):
    path = tmp_path / "broken.stl"
    if kind == "empty":
        path.write_bytes(b"")
    elif kind == "not a mesh":
        path.write_text("this is a shopping list\n" * 20)
    elif kind == "no faces":
        path.write_text("solid nothing\nendsolid nothing\n")
    elif kind == "nan":
        good = trimesh.load(flat_mesh(tmp_path, name="good.stl"), process=False)
        vertices = np.array(good.vertices)
        vertices[3, 1] = np.nan
        trimesh.Trimesh(vertices, good.faces, process=False).export(path)
    return path


@pytest.mark.parametrize(
    ("kind", "word"),
    [
        ("missing", "broken.stl"),
        ("empty", "no bytes"),
        ("not a mesh", "STL"),
        ("no faces", "face"),
        ("nan", "finite"),
    ],
)
@pytest.mark.parametrize("command", ["check", "plan", "run"])
def test_bad_meshes_are_named(tmp_path, command, kind, word):
    mesh = broken_mesh(tmp_path, kind)
    unit = ["--runs", tmp_path / "runs"] if command == "run" else []
    result = invoke(command, mesh, "--unit", "m", *unit)
    assert result.exit_code == 2
    assert word.lower() in result.stderr.lower()
    assert "Traceback" not in result.stderr
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("command", ["check", "plan", "run"])
def test_a_wing_of_kilometres_is_refused_with_the_likely_unit(tmp_path, command):
    result = invoke(command, flat_mesh(tmp_path, scale=1000.0), "--unit", "m")
    assert result.exit_code == 2
    assert "mm" in result.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("plan", "scene9"), ("scene9", "scene4")),
        (("plan", "scene1", "--strategy", "magic"), ("magic", "published")),
        (("run", "scene1", "--stations", "magic"), ("magic", "rectangles")),
        (("run", "scene1", "--order", "magic"), ("magic", "published")),
        (("plan", "scene1", "--cell", "no-such-cell.yaml"), ("no-such-cell.yaml",)),
        (("parts", "export", "scene9", "."), ("scene9", "scene1")),
        (("replay", "no-such-bag"), ("no-such-bag",)),
        (("report", "no-such-run"), ("no-such-run",)),
    ],
)
def test_unknown_names_are_answered_with_what_exists(arguments, words):
    result = invoke(*arguments)
    assert result.exit_code == 2
    for word in words:
        assert word in result.stderr
    assert "Traceback" not in result.stderr


def test_errors_are_json_too(tmp_path):
    result = invoke("check", tmp_path / "nothing.stl", "--json")
    assert result.exit_code == 2
    assert json.loads(result.stdout)["error"]["kind"] == "MeshNotFoundError"


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("standoff_m: 0.3", "standoff_m: -0.3", "standoff_m"),
        ("standoff_m: 0.3", "standof_m: 0.3", "standof_m"),
        ("size_m: 0.1", "", "size_m"),
    ],
)
def test_a_bad_part_file_names_the_key(tmp_path, old, new, word):
    assert invoke("parts", "export", "scene2", tmp_path).exit_code == 0
    file = tmp_path / "part.yaml"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    result = invoke("plan", file)
    assert result.exit_code == 2
    assert word in result.stderr
