"""The command: what it prints, how it refuses bad input (code 2, one sentence, no traceback)."""

import importlib.util
import json
import os
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

from skinplan.cli import app
from skinplan.inspection.cloud import write_ply
from skinplan.mesh.check import check_mesh
from skinplan.mesh.load import load_mesh
from skinplan.scanner.samples import sample_surface

runner = CliRunner()


def invoke(*arguments):
    return runner.invoke(app, [str(argument) for argument in arguments])


#: Planned in a second [m].
SMALL = (0.3, 0.2)


def flat_mesh(tmp_path, scale=1.0, name="flat.stl", size=(0.6, 0.4)):
    grid = np.stack(
        np.meshgrid(np.linspace(0, size[0], 13), np.linspace(0, size[1], 9), indexing="ij"),
        axis=-1,
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


def test_parts_lists_the_samples():
    result = invoke("parts", "--json")
    assert result.exit_code == 0
    names = [sample["name"] for sample in json.loads(result.stdout)["samples"]]
    assert names == ["scene1", "scene2", "scene3", "scene4", "engine"]


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


def test_a_part_that_no_station_locates_is_planned_without_markers_only(tmp_path):
    # By these figures no place is near enough.
    (tmp_path / "cell.yaml").write_text("quality: {distance_min_m: 0.2, threshold: 0.97}\n")
    arguments = ("plan", flat_mesh(tmp_path), "--cell", tmp_path / "cell.yaml", "--json")
    arguments += ("--strategy", "published", "--stations", "rectangles", "--until", "stations")
    refused = invoke(*arguments)
    assert refused.exit_code != 0 and "E >= 0.985" in refused.output
    planned = invoke(*arguments, "--without-markers")
    assert planned.exit_code == 0
    assert json.loads(planned.stdout)["stations"]["marker_quality"] is None


def test_plan_of_a_bare_mesh_in_millimetres(tmp_path):
    mesh = flat_mesh(tmp_path, scale=1000.0, size=SMALL)
    result = invoke("plan", mesh, "--unit", "mm", "--out", tmp_path / "plan", "--json")
    assert result.exit_code == 0, result.stderr
    summary = json.loads(result.stdout)
    keys = {"mesh", "scan_path", "coverage", "stations", "trajectory", "plan_hash", "planning_s"}
    assert keys <= set(summary)
    assert summary["coverage"]["area_ratio"] > 0.99
    written = {path.name for path in (tmp_path / "plan").iterdir()}
    assert written == {
        *(f"{name}.json" for name in ("scan_path", "coverage", "stations", "trajectories")),
        "coverage.ply",
        "summary.json",
    }
    again = invoke("plan", mesh, "--unit", "mm", "--json")
    assert json.loads(again.stdout)["plan_hash"] == summary["plan_hash"]


#: All pictures of a plan, in their order; those up to `reach` need no trajectories.
PICTURES = (
    "regions", "points", "rows", "coverage", "stations", "reach", "order", "joints", "timeline",
)  # fmt: skip
UNTIL_STATIONS = PICTURES[:6]


def names_of(kinds):
    return [f"{kind}.png" for kind in kinds]


def test_plan_writes_pictures_to_a_folder_of_the_part(tmp_path, monkeypatch):
    """And they end with what is planned."""
    monkeypatch.chdir(tmp_path)
    result = invoke(
        "plan", flat_mesh(tmp_path, size=SMALL), "--view", "--until", "stations", "--json"
    )
    assert result.exit_code == 0, result.stderr
    view = json.loads(result.stdout)["view"]
    assert view["url"] is None
    assert [Path(file).name for file in view["pictures"]] == names_of(UNTIL_STATIONS)
    for file in view["pictures"]:
        assert Path(file).parent == Path("plan-flat")
        assert Path(file).read_bytes().startswith(b"\x89PNG")


def test_plan_writes_pictures_beside_the_plan(tmp_path):
    result = invoke("plan", flat_mesh(tmp_path, size=SMALL), "--view", "--out", tmp_path / "here")
    assert result.exit_code == 0, result.stderr
    written = {path.name for path in (tmp_path / "here").iterdir()}
    assert written >= {"scan_path.json", "summary.json", *names_of(PICTURES)}
    assert "motion.gif" not in written
    assert str(tmp_path / "here" / "coverage.png") in result.stdout.replace("\n", "")


def test_pictures_end_with_what_is_planned(tmp_path):
    arguments = ("--view", "--until", "coverage", "--out", tmp_path / "here", "--json")
    result = invoke("plan", flat_mesh(tmp_path, size=SMALL), *arguments)
    assert result.exit_code == 0, result.stderr
    names = [Path(file).name for file in json.loads(result.stdout)["view"]["pictures"]]
    assert names[-1] == "coverage.png" and "stations.png" not in names


def test_plan_animates_the_arm(tmp_path, monkeypatch):
    monkeypatch.setattr("skinplan.view.animation.MOST_FRAMES", 3)
    arguments = ("--animate", "--out", tmp_path / "here", "--json")
    result = invoke("plan", flat_mesh(tmp_path, size=SMALL), *arguments)
    assert result.exit_code == 0, result.stderr
    pictures = [Path(file) for file in json.loads(result.stdout)["view"]["pictures"]]
    assert [file.name for file in pictures] == [*names_of(PICTURES), "motion.gif"]
    assert all(file.read_bytes().startswith(b"\x89PNG") for file in pictures[:-1])
    assert pictures[-1].read_bytes().startswith(b"GIF89a")


def test_an_animation_without_trajectories_is_refused_before_planning(tmp_path):
    result = invoke("plan", flat_mesh(tmp_path), "--animate", "--until", "stations")
    assert result.exit_code == 2
    assert "--until trajectory" in " ".join(result.stderr.split())
    assert "scan path" not in result.stderr


def test_pictures_that_can_not_be_written_are_a_named_error(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plan-flat").write_text("in the way")
    result = invoke("plan", flat_mesh(tmp_path, size=SMALL), "--view")
    assert result.exit_code == 1
    assert "plan-flat" in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize("port", [-1, 70000, "x"])
def test_the_view_refuses_what_is_no_port(tmp_path, port):
    result = invoke("plan", flat_mesh(tmp_path), "--browser", "--port", port)
    assert result.exit_code == 2
    assert "port" in result.stderr


def test_without_viser_the_view_is_refused_before_planning(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    result = invoke("plan", flat_mesh(tmp_path), "--browser", "--json")
    assert result.exit_code == 1
    assert json.loads(result.stdout)["error"]["kind"] == "ViewerMissingError"
    assert "pip install" in result.stderr
    assert "stations" not in result.stderr


@pytest.mark.skipif(importlib.util.find_spec("viser") is None, reason="viser is not installed")
def test_the_view_is_served_until_ctrl_c(tmp_path):
    command = [sys.executable, "-m", "skinplan.cli", "plan", str(flat_mesh(tmp_path, size=SMALL))]
    process = subprocess.Popen(
        [*command, "--browser", "--port", "0", "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    try:
        text = ""
        while not text.endswith("\n}\n"):
            line = process.stdout.readline()
            assert line, text
            text += line
        url = json.loads(text)["view"]["url"]
        with urllib.request.urlopen(url, timeout=20) as answer:
            assert answer.status == 200
        process.send_signal(signal.SIGINT)
        rest, _ = process.communicate(timeout=30)
    finally:
        process.kill()
    assert (process.returncode, rest) == (0, "")
    with pytest.raises(OSError):
        urllib.request.urlopen(url, timeout=5)


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


def test_plan_until_a_stage_has_that_stage_and_no_later_one(tmp_path):
    mesh = flat_mesh(tmp_path)
    result = invoke("plan", str(mesh), "--unit", "m", "--until", "coverage", "--json")
    assert result.exit_code == 0, result.stderr
    document = json.loads(result.stdout)
    assert document["coverage"]["area_ratio"] > 0.99
    assert "stations" not in document and "plan_hash" not in document
    result = invoke("plan", str(mesh), "--unit", "m", "--until", "paint")
    assert result.exit_code == 2
    assert "scan_path, coverage, stations, trajectory" in result.stderr


def test_passes_are_optimised_when_asked(tmp_path):
    arguments = ("plan", flat_mesh(tmp_path), "--until", "scan_path", "--json")
    plain = json.loads(invoke(*arguments).stdout)["scan_path"]
    asked = json.loads(invoke(*arguments, "--optimise-passes").stdout)["scan_path"]
    assert "passes" not in plain
    # Nothing is to be gained on a flat panel: all views are straight.
    assert asked["passes"] == {
        "count": asked["passes"]["count"], "improved": 0, "error_before": 0.0, "error_after": 0.0,
    }  # fmt: skip
    assert asked["passes"]["count"] >= 1 and asked["hash"] == plain["hash"]


def test_plan_writes_the_certificate_as_data_and_as_coloured_mesh(tmp_path):
    mesh = flat_mesh(tmp_path)
    folder = tmp_path / "plan"
    arguments = ("--unit", "m", "--until", "coverage", "--out", str(folder))
    result = invoke("plan", str(mesh), *arguments)
    assert result.exit_code == 0, result.stderr
    certificate = json.loads((folder / "coverage.json").read_text())
    assert certificate["regions"][0]["name"] == "whole part"
    points, motion = certificate["regions"][0], certificate["along_motion"]["regions"][0]
    assert points["often_seen_of_seeable_ratio"] > 0.99
    assert motion["often_seen_ratio"] >= points["often_seen_ratio"]
    assert motion["incidence_axis"]["median_rad"] <= points["incidence_axis"]["median_rad"] + 1e-9
    coloured = trimesh.load(folder / "coverage.ply", process=False)
    assert len(coloured.visual.face_colors) == len(coloured.faces)
    assert not (folder / "stations.json").exists()


def test_rescan_plans_only_what_the_cloud_leaves_out(tmp_path):
    mesh = flat_mesh(tmp_path)
    whole, _ = check_mesh(load_mesh(mesh))
    points = sample_surface(whole, 0.004).points
    write_ply(
        tmp_path / "cloud.ply", points[np.hypot(points[:, 0] - 0.3, points[:, 1] - 0.2) > 0.05]
    )
    arguments = ("--unit", "m", "--until", "scan_path", "--json", "--rescan")
    result = invoke("plan", str(mesh), *arguments, str(tmp_path / "cloud.ply"))
    assert result.exit_code == 0, result.stderr
    path = json.loads(result.stdout)["scan_path"]
    assert (path["strategy"], path["points"]) == ("rescan", 3)
    # The folder of a run holds its cloud.
    assert invoke("plan", str(mesh), *arguments, str(tmp_path)).exit_code == 0
    write_ply(tmp_path / "cloud.ply", points)
    result = invoke("plan", str(mesh), *arguments, str(tmp_path))
    assert result.exit_code == 1
    assert json.loads(result.stdout)["error"]["kind"] == "NothingMissingError"
    write_ply(tmp_path / "cloud.ply", points, "tracker")
    result = invoke("plan", str(mesh), *arguments, str(tmp_path))
    assert result.exit_code == 2
    assert "frame workpiece is accepted" in result.stderr
    assert invoke("plan", str(mesh), *arguments, str(tmp_path / "none.ply")).exit_code == 2


def test_a_refused_mesh_has_its_findings_in_the_json_error(tmp_path):
    flat = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], process=False)
    flat.export(tmp_path / "flat.stl")
    result = invoke("check", str(tmp_path / "flat.stl"), "--json")
    assert result.exit_code == 2
    error = json.loads(result.stdout)["error"]
    assert error["findings"][0]["action"] == "refused"
