import dataclasses

import numpy as np
import pytest
import yaml

from skinplan.errors import (
    MeshHashError,
    MeshNotFoundError,
    PartInvalidError,
    PartNotFoundError,
)
from skinplan.part.files import load_part, save_part
from skinplan.part.model import ScanSettings
from skinplan.part.samples import write_sample
from skinplan.part.settings import check_settings


@pytest.fixture
def part(tmp_path):
    return write_sample("scene2", tmp_path, triangles=2000)


def edited(part, edit):
    values = yaml.safe_load(part.source.read_text())
    edit(values)
    part.source.write_text(yaml.safe_dump(values))
    return part.source


def test_what_is_written_is_read_again(part, tmp_path):
    scan = dataclasses.replace(
        part.scan,
        standoff_m=0.31,
        row_direction=(0.6, 0.8, 0.0),
        field_of_view="cone",
        least_views=5,
        optimise_passes=True,
    )
    changed = dataclasses.replace(part, id="other-1", scan=scan)
    again = load_part(save_part(changed, tmp_path / "other.yaml"))
    assert (again.id, again.scan, again.mesh_path, again.mesh_sha256) == (
        "other-1", scan, part.mesh_path, part.mesh_sha256,
    )  # fmt: skip
    np.testing.assert_allclose(again.T_map_workpiece, part.T_map_workpiece, atol=1e-11)
    np.testing.assert_allclose(
        again.fixture.T_workpiece_fixture, part.fixture.T_workpiece_fixture, atol=1e-11
    )
    assert [marker.id for marker in again.fixture.markers] == [0, 1]
    assert again.fixture.T_workpiece_marker(1)[1, 3] == pytest.approx(-0.5)


def test_writing_what_was_read_gives_the_same_bytes(part, tmp_path):
    assert save_part(part, tmp_path / "again.yaml").read_bytes() == part.source.read_bytes()


def test_fixture_placement_and_scan_may_be_left_out(part):
    def edit(values):
        for key in ("fixture", "placement", "scan"):
            del values[key]

    again = load_part(edited(part, edit))
    assert again.scan == ScanSettings()
    np.testing.assert_allclose(again.T_map_workpiece, part.T_map_workpiece, atol=1e-11)
    assert len(again.fixture.markers) == len(part.fixture.markers)


def test_a_fixture_may_have_no_markers(part, tmp_path):
    def edit(values):
        pose = values["fixture"]["pose_in_workpiece"]
        values["fixture"] = {"markers": "none", "pose_in_workpiece": pose}

    bare = load_part(edited(part, edit))
    assert bare.fixture.markers == () and bare.fixture.dictionary == ""
    again = load_part(save_part(bare, tmp_path / "again.yaml"))
    assert again.fixture.markers == () and "dictionary" not in again.source.read_text()
    np.testing.assert_allclose(
        again.fixture.T_workpiece_fixture, part.fixture.T_workpiece_fixture, atol=1e-11
    )


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda v: v["scan"].update(standof_m=0.3), ["scan.standof_m", "did you mean standoff_m"]),
        (lambda v: v.update(colour="red"), ["unknown key colour", "placement"]),
        (
            lambda v: v["fixture"]["markers"][1].pop("size_m"),
            ["fixture.markers[1].size_m", "nothing"],
        ),
        (lambda v: v["scan"].update(standoff_m=-0.3), ["scan.standoff_m", "-0.3", "0.01"]),
        (lambda v: v["scan"].update(standoff_m=0.9), ["scan.standoff_m", "0.9", "0.2 to 0.4"]),
        (lambda v: v["scan"].update(overlap_ratio="much"), ["scan.overlap_ratio", "'much'"]),
        (lambda v: v["scan"].update(sensitivity=float("nan")), ["scan.sensitivity", "nan"]),
        (lambda v: v["scan"].update(row_direction=[0, 0, 0]), ["scan.row_direction"]),
        (lambda v: v["scan"].update(range_min_m=0.5), ["scan.range_min_m"]),
        (lambda v: v["scan"].update(clearance_m=0.3), ["scan.clearance_m", "standoff_m"]),
        (lambda v: v["scan"].update(field_margin_m=0.12), ["scan.field_margin_m", "0.1"]),
        (
            lambda v: v["scan"].update(incidence_margin_rad=0.5, incidence_max_rad=0.3),
            ["scan.incidence_margin_rad", "incidence_max_rad, 0.3"],
        ),
        (lambda v: v["scan"].update(field_of_view="box"), ["scan.field_of_view", "'box'", "cone"]),
        (lambda v: v["scan"].update(field_of_view=2), ["scan.field_of_view", "cylinder or cone"]),
        (lambda v: v["scan"].update(least_views=0), ["scan.least_views", "0", "from 1 to 1000"]),
        (lambda v: v["scan"].update(least_views=2.5), ["scan.least_views", "2.5", "whole number"]),
        (lambda v: v["scan"].update(optimise_passes=1), ["scan.optimise_passes", "true or false"]),
        (lambda v: v.update(scan=[1, 2]), ["scan", "[1, 2]"]),
        (lambda v: v.update(id="a b"), ["id", "'a b'"]),
        (lambda v: v["mesh"].update(unit="yard"), ["mesh.unit", "yard", "inch"]),
        (lambda v: v["fixture"].update(dictionary="DICT_9X9_3"), ["DICT_9X9_3", "DICT_5X5_100"]),
        (lambda v: v["fixture"].update(markers=[]), ["fixture.markers", "at least one"]),
        (lambda v: v["fixture"].update(markers=None), ["fixture.markers", "nothing", "word none"]),
        (lambda v: v["fixture"].update(markers="no"), ["fixture.markers", "'no'", "word none"]),
        (
            lambda v: v["fixture"].update(markers="none"),
            ["fixture.dictionary", "'DICT_5X5_100' beside markers: none", "or neither of them"],
        ),
        (lambda v: v["fixture"]["markers"][1].update(id=0), ["[0, 0]", "every id once"]),
        (lambda v: v["fixture"]["markers"][0].update(id=100), ["markers[0].id", "100"]),
        (lambda v: v["placement"].update(rotation_xyzw=[0, 0, 0, 2]), ["placement.rotation_xyzw"]),
        (lambda v: v["placement"].update(translation_m=[0, 0]), ["placement.translation_m"]),
        (lambda v: v.pop("mesh"), ["mesh"]),
    ],
)
def test_a_mistake_is_named_with_its_place(part, edit, words):
    with pytest.raises(PartInvalidError) as caught:
        load_part(edited(part, edit))
    for word in words:
        assert word in str(caught.value)


def test_the_mesh_must_be_the_stated_one(part):
    part.mesh_path.write_bytes(part.mesh_path.read_bytes()[:-1] + b"\1")
    with pytest.raises(MeshHashError, match=part.mesh_sha256[:12]):
        load_part(part.source)
    part.mesh_path.unlink()
    with pytest.raises(MeshNotFoundError):
        load_part(part.source)


@pytest.mark.parametrize("text", ["id: [", "\tid: 3", "just words", "", "- 1\n- 2", "\x00"])
def test_text_that_is_no_part_file(tmp_path, text):
    (tmp_path / "part.yaml").write_text(text)
    with pytest.raises(PartInvalidError, match=r"part\.yaml"):
        load_part(tmp_path / "part.yaml")


def test_a_file_that_is_missing_or_no_text(tmp_path):
    with pytest.raises(PartNotFoundError, match=r"part\.yaml"):
        load_part(tmp_path / "part.yaml")
    with pytest.raises(PartNotFoundError):
        load_part(tmp_path)
    (tmp_path / "part.yaml").write_bytes(b"\xff\xfe\xff" * 10)
    with pytest.raises(PartInvalidError):
        load_part(tmp_path / "part.yaml")


def test_settings_are_checked_without_a_file_too():
    settings = ScanSettings(row_direction=(3.0, 0.0, 4.0))
    assert check_settings(settings).row_direction == pytest.approx((0.6, 0.0, 0.8))
    with pytest.raises(PartInvalidError, match="tilt_max_rad"):
        check_settings(dataclasses.replace(settings, tilt_max_rad=-1.0))


def test_tolerances_and_characteristics_are_read_and_written(part, tmp_path):
    asked = {
        "deviation_max_m": 0.0005,
        "area_ratio_min": 0.9,
        "characteristics": [
            {"id": "skin", "kind": "profile", "tolerance_m": 0.001},
            {"id": "knob", "kind": "sphere_diameter", "nominal_m": 0.06, "tolerance_m": 0.0001,
             "centre_m": [0.4, 0.1, 0.03], "radius_m": 0.04},
        ],
    }  # fmt: skip
    found = load_part(edited(part, lambda values: values.update(inspection=asked)))
    assert found.inspection.deviation_max_m == 0.0005
    kinds = [each.kind for each in found.inspection.characteristics]
    assert kinds == ["profile", "sphere_diameter"]
    again = load_part(save_part(found, tmp_path / "again.yaml"))
    assert again.inspection == found.inspection


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"deviation_max_m": -1.0}, "inspection.deviation_max_m"),
        ({"area_ratio_min": 95}, "share from 0 to 1"),
        ({"tolerance": 1}, "unknown key inspection.tolerance"),
        ({"characteristics": {"id": "a"}}, "a list of up to"),
        ({"characteristics": [{"id": "<b>", "kind": "profile", "tolerance_m": 1e-3}]}, "letters"),
        ({"characteristics": [{"id": "a", "kind": "size", "tolerance_m": 1e-3}]}, "profile, flat"),
        ({"characteristics": [{"id": "a", "kind": "profile"}]}, "tolerance_m: found nothing"),
        (
            {"characteristics": [{"id": "a", "kind": "sphere_diameter", "tolerance_m": 1e-3}]},
            "nominal_m",
        ),
        ({"characteristics": 2 * [{"id": "a", "kind": "profile", "tolerance_m": 1e-3}]}, "twice"),
    ],
)
def test_a_wrong_inspection_is_named(part, asked, said):
    with pytest.raises(PartInvalidError, match=said):
        load_part(edited(part, lambda values: values.update(inspection=asked)))
