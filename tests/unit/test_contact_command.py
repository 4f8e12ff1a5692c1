"""``skinplan contact``: the command, its document and its table."""

import dataclasses
import json

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from skinplan.contact.command import contact, plan_part_contact
from skinplan.contact.document import contact_document, figure_rows, station_rows
from skinplan.contact.model import MissedPoint
from skinplan.errors import InspectionPointsError
from skinplan.part.files import save_part
from skinplan.part.inspection_points import InspectionPoints
from skinplan.part.samples import write_sample
from skinplan.transforms import apply

APP = typer.Typer()
APP.command()(contact)


@pytest.fixture(scope="module")
def part(tmp_path_factory):
    """The engine with every tenth of its points."""
    folder = tmp_path_factory.mktemp("engine")
    whole = write_sample("engine", folder, triangles=4_000)
    points = InspectionPoints(
        whole.points.targets[::10], whole.points.normals[::10], whole.points.groups[::10]
    )
    few = dataclasses.replace(whole, points=points)
    return dataclasses.replace(few, source=save_part(few, folder / "few.yaml"))


@pytest.fixture(scope="module")
def made(part):
    return plan_part_contact(part)


@pytest.fixture(scope="module")
def document(part, made):
    return contact_document(made, part)


@pytest.fixture(scope="module")
def ran(part, tmp_path_factory):
    out = tmp_path_factory.mktemp("out")
    result = CliRunner().invoke(APP, [str(part.source), "--json", "--out", str(out)])
    return result, out


def test_the_document_says_what_was_planned(part, made, document):
    assert document["part"] == "engine" and document["mesh_sha256"] == part.mesh_sha256
    assert document["measured"] == document["count"] == 15
    assert document["motions_not_held"] == [] and document["missed"] == []
    assert document["motion_count"] == 15 - len(document["stations"])
    assert sorted(p for s in document["stations"] for p in s["points"]) == list(range(15))
    for station, entry in zip(made.stations, document["stations"], strict=True):
        assert entry["x_m"] == pytest.approx(entry["start_x_m"] + 0.2 * entry["k"], abs=2e-6)
        assert entry["reached"] == station.reached.sum() == max(entry["counts"])
    assert document["reached_sum"] == sum(entry["reached"] for entry in document["stations"])


def test_places_in_the_shop_are_those_of_the_axial_frame(document):
    T = np.array(document["T_map_axial"])
    tracker = document["tracker"]
    np.testing.assert_allclose(
        apply(T, np.array([tracker["position_m"]]))[0], tracker["position_in_map_m"], atol=3e-6
    )
    for station in document["stations"]:
        place = apply(T, np.array([[station["x_m"], station["y_m"], 0.0]]))[0]
        np.testing.assert_allclose(station["arm_in_map"]["position_m"], place, atol=3e-6)
        assert place[2] == pytest.approx(0.752)
        assert place[1] < 0.0  # on the tracker's side of the engine


def test_every_point_is_touched_where_the_file_says(part, document):
    for entry, target, normal in zip(
        document["points"], part.points.targets, part.points.normals, strict=True
    ):
        np.testing.assert_allclose(entry["target_m"], target, atol=1e-6)
        # The axial frame of the engine is its own but for the turn in the shop.
        np.testing.assert_allclose(entry["probe_m"], target + 0.003 * normal, atol=3e-6)


def test_the_same_part_gives_the_same_document(part, made, document, ran):
    result, out = ran
    assert result.exit_code == 0, result.output
    assert json.loads((out / "contact.json").read_text()) == document
    moved = part.points.targets.copy()
    moved[0, 1] += 1e-4
    points = InspectionPoints(moved, part.points.normals, part.points.groups)
    other = contact_document(made, dataclasses.replace(part, points=points))
    assert other["hash"] != document["hash"]


def test_the_command_prints_the_figures_alone_as_json(ran, document):
    printed = json.loads(ran[0].stdout)
    assert printed["hash"] == document["hash"]
    assert "points" not in printed and "motions" not in printed
    assert printed["stations"] == document["stations"]


def test_the_tables_have_what_a_person_asks(document):
    rows = station_rows(document)
    assert [row[0] for row in rows] == list(range(1, len(rows) + 1))
    assert sum(row[5] for row in rows) == 15
    figures = dict(figure_rows(document))
    assert figures["measured"] == "15 of 15"
    assert figures["motions held"] == f"{document['motion_count']} of {document['motion_count']}"
    assert figures["largest incidence angle"].endswith("°")


def test_what_failed_is_in_the_table(part, made):
    broken = dataclasses.replace(made.motions[0], problem="beam broken by the arm")
    plan = dataclasses.replace(
        made, motions=(broken, *made.motions[1:]), missed=(MissedPoint(4, "joint limits"),)
    )
    figures = dict(figure_rows(contact_document(plan, part)))
    assert figures[f"not held, {broken.start} to {broken.end}"] == "beam broken by the arm"
    assert figures["not measured, 4"] == "joint limits"
    assert figures["motions held"].startswith(f"{len(made.motions) - 1} of")


def test_a_part_without_points_is_refused(part, tmp_path):
    bare = dataclasses.replace(part, points=None)
    with pytest.raises(InspectionPointsError, match="gives no measuring points"):
        plan_part_contact(bare)
    file = save_part(bare, tmp_path / "part.yaml")
    result = CliRunner().invoke(APP, [str(file), "--json"])
    assert result.exit_code == 2
    assert json.loads(result.stdout)["error"]["kind"] == "InspectionPointsError"


def test_an_unknown_part_is_refused():
    result = CliRunner().invoke(APP, ["motor", "--json"])
    assert result.exit_code == 2
    assert json.loads(result.stdout)["error"]["kind"] == "PartNotFoundError"
