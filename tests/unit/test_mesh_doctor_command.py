"""What a person and a program are told: `skinplan check` and the stage `mesh`."""

import json

import pytest
from typer.testing import CliRunner

import broken_meshes as broken
from skinplan.cli import app
from skinplan.mesh.prepare import prepare_mesh
from skinplan.part.resolve import resolve_part


def invoke(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def write_obj(path, mesh):
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices.tolist()]
    quads = mesh.faces.reshape(-1, 6)[:, [0, 1, 2, 5]] + 1
    lines += [f"f {a} {b} {c} {d}" for a, b, c, d in quads.tolist()]
    path.write_text("\n".join(lines))
    return path


@pytest.fixture
def holed(tmp_path):
    """A panel with a missing quad, written as quads."""
    mesh = broken.panel()
    faces = [number for number in range(len(mesh.faces)) if number not in (210, 211)]
    return write_obj(tmp_path / "panel.obj", broken.kept(mesh, faces))


def test_check_says_each_finding_with_its_place(holed):
    result = invoke("check", holed, "--json")
    assert result.exit_code == 0
    findings = {found["name"]: found for found in json.loads(result.stdout)["findings"]}
    assert findings["polygons"]["action"] == "repaired"
    assert findings["polygons"]["count"] == 239
    assert findings["holes"]["count"] == 1
    assert len(findings["holes"]["where"]) == 1
    assert len(findings["holes"]["where"][0]) == 3
    text = invoke("check", holed)
    for word in ("polygons", "repaired", "holes", "noted"):
        assert word in text.stdout


@pytest.mark.parametrize(
    ("text", "unit", "finding"),
    [
        ("v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n", "m", "vertices not finite"),
        ("v 0 0 0\nv 2900 0 0\nv 0 1 0\nf 1 2 3\n", "m", "unit implausible"),
        ("v 0 0 0\nv 2.9 0 0\nv 0 1 0\nf 1 2 3\n", "mm", "unit implausible"),
        ("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "m", "degenerate faces"),
    ],
)
def test_check_names_what_is_refused_and_ends_with_2(tmp_path, text, unit, finding):
    path = tmp_path / "wing.obj"
    path.write_text(text)
    result = invoke("check", path, "--unit", unit)
    assert result.exit_code == 2
    assert finding in result.stdout
    assert "refused" in result.stdout
    assert "Traceback" not in result.output
    document = json.loads(invoke("check", path, "--unit", unit, "--json").stdout)
    assert document["error"]["kind"].startswith("Mesh")


def test_the_stage_hands_on_what_reading_and_the_doctor_found(holed):
    prepared = prepare_mesh(resolve_part(str(holed)))
    assert [finding.name for finding in prepared.findings] == ["polygons", "holes"]
