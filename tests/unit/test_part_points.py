"""Measuring points of a part: the file, and what is refused."""

import dataclasses
import logging

import numpy as np
import pytest
import yaml

from skinplan.errors import InspectionPointsError, PartInvalidError
from skinplan.mesh.model import SurfaceMesh
from skinplan.part.files import load_part, save_part
from skinplan.part.inspection_points import InspectionPoints
from skinplan.part.points_file import read_points, write_points
from skinplan.part.samples import write_sample

HEADING = "x,y,z,nx,ny,nz,group\n"


@pytest.fixture(scope="module")
def engine(tmp_path_factory):
    return write_sample("engine", tmp_path_factory.mktemp("engine"), triangles=5_000)


@pytest.fixture
def plate():
    """1 x 1 m in the plane z = 0."""
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    return SurfaceMesh(vertices, np.array([[0, 1, 2], [0, 2, 3]]))


def written(folder, text):
    path = folder / "points.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_what_is_written_is_read_again(engine, tmp_path):
    again = load_part(save_part(engine, tmp_path / "part.yaml"))
    np.testing.assert_allclose(again.points.targets, engine.points.targets, atol=1e-12)
    np.testing.assert_allclose(again.points.normals, engine.points.normals, atol=1e-12)
    assert np.array_equal(again.points.groups, engine.points.groups)
    assert (tmp_path / "points.csv").read_bytes() == engine.source.with_name(
        "points.csv"
    ).read_bytes()


def test_a_part_file_of_another_name_has_points_of_its_own(engine, tmp_path):
    few = dataclasses.replace(
        engine,
        points=InspectionPoints(
            engine.points.targets[:3], engine.points.normals[:3], engine.points.groups[:3]
        ),
    )
    assert len(load_part(save_part(few, tmp_path / "few.yaml")).points) == 3
    assert len(load_part(save_part(engine, tmp_path / "part.yaml")).points) == 150
    assert len(load_part(tmp_path / "few.yaml").points) == 3


@pytest.mark.parametrize(("unit", "scale"), [("m", 1.0), ("mm", 1e-3), ("cm", 1e-2)])
def test_lengths_are_in_the_unit_of_the_part_and_normals_of_any_length(
    plate, tmp_path, unit, scale
):
    places = np.array([[0.25, 0.5, 0.001], [0.75, 0.25, 0.0]]) / scale
    lines = [f"{x!r},{y!r},{z!r},0,0,{n},{g}" for (x, y, z), n, g in zip(
        places.tolist(), (3, 0.1), (2, 1), strict=True)]  # fmt: skip
    found = read_points(written(tmp_path, HEADING + "\n".join(lines) + "\n\n"), unit, plate)
    np.testing.assert_allclose(found.targets, places * scale, atol=1e-12)
    np.testing.assert_allclose(found.normals, [[0, 0, 1], [0, 0, 1]])
    assert found.groups.tolist() == [2, 1]
    write_points(found, tmp_path / "again.csv", unit)
    again = read_points(tmp_path / "again.csv", unit, plate)
    np.testing.assert_allclose(again.targets, found.targets, atol=1e-12)


def test_points_given_twice_are_noted_and_stay(plate, tmp_path, caplog):
    text = HEADING + "0.5,0.5,0,0,0,1,1\n0.2,0.2,0,0,0,1,1\n0.5,0.5,0,0,0,1,1\n"
    with caplog.at_level(logging.WARNING):
        found = read_points(written(tmp_path, text), "m", plate)
    assert len(found) == 3 and found.repeated().tolist() == [2]
    assert "1 points are given twice, the first in line 4" in caplog.text


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "first line"),
        ("x,y,z\n0.5,0.5,0\n", "x,y,z,nx,ny,nz,group is accepted"),
        ("0.5,0.5,0,0,0,1,1\n", "first line"),
        (HEADING, "0 points were found"),
        (HEADING + "0.5,0.5,0,0,0,1\n", "line 2"),
        (HEADING + "0.5,0.5,0,0,0,1,1,7\n", "line 2"),
        (HEADING + "0.5,0.5,nan,0,0,1,1\n", "finite"),
        (HEADING + "0.5,0.5,inf,0,0,1,1\n", "finite"),
        (HEADING + "0.5,0.5,zero,0,0,1,1\n", "finite"),
        (HEADING + "0.5,0.5,0,0,0,1,1\n0.5,0.5,0,0,0,0,1\n", "normal of line 3 is zero"),
        (HEADING + "0.5,0.5,0,0,0,1,0\n", "group 0"),
        (HEADING + "0.5,0.5,0,0,0,1,1.5\n", "group 1.5"),
        (HEADING + "0.5,0.5,0.03,0,0,1,1\n", "30.0 mm from the part's surface"),
        (HEADING + "500,500,0,0,0,1,1\n", "read in mm they are: is the unit wrong"),
        (HEADING + "50,50,0,0,0,1,1\n", "outside of the part's box"),
        (HEADING + "1e300,0,0,0,0,1,1\n", "outside of the part's box"),
        (HEADING + "0.5,0.5,0,0,0,1,1\n" * 20_001, "20001 points"),
    ],
)
def test_what_can_not_be_used_is_named(plate, tmp_path, text, words):
    with pytest.raises(InspectionPointsError, match=words):
        read_points(written(tmp_path, text), "m", plate)


def test_a_file_that_is_no_text_too_large_or_not_there_is_named(plate, tmp_path):
    path = tmp_path / "points.csv"
    with pytest.raises(InspectionPointsError, match=r"no file with measuring points at .*points"):
        read_points(path, "m", plate)
    path.write_bytes(b"\xff\xfe\x00\x01" * 10)
    with pytest.raises(InspectionPointsError, match="can't be read"):
        read_points(path, "m", plate)
    path.write_bytes(b"1" * 10_000_001)
    with pytest.raises(InspectionPointsError, match="10000001 bytes"):
        read_points(path, "m", plate)


@pytest.mark.parametrize("name", [7, "", ["points.csv"], "a\0b"])
def test_the_key_of_the_part_file_is_checked(engine, tmp_path, name):
    values = yaml.safe_load(save_part(engine, tmp_path / "part.yaml").read_text())
    values["points"] = name
    (tmp_path / "part.yaml").write_text(yaml.safe_dump(values))
    with pytest.raises(PartInvalidError, match="points"):
        load_part(tmp_path / "part.yaml")


def test_a_part_file_of_another_unit_is_noticed(engine, tmp_path):
    """The mesh in metres taken as inch: the box of the points no longer fits."""
    values = yaml.safe_load(save_part(engine, tmp_path / "part.yaml").read_text())
    points = (tmp_path / "points.csv").read_text().splitlines()
    scaled = [points[0]]
    for line in points[1:]:
        cells = line.split(",")
        scaled.append(",".join([*(repr(1000.0 * float(c)) for c in cells[:3]), *cells[3:]]))
    (tmp_path / "points.csv").write_text("\n".join(scaled))
    (tmp_path / "part.yaml").write_text(yaml.safe_dump(values))
    with pytest.raises(InspectionPointsError, match="read in mm they are"):
        load_part(tmp_path / "part.yaml")


@pytest.mark.parametrize(
    ("targets", "normals", "groups", "words"),
    [
        (np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, dtype=int), "none were found"),
        (np.zeros((2, 2)), np.eye(3)[:2], np.ones(2, dtype=int), "shape"),
        (np.full((1, 3), np.nan), np.eye(3)[:1], np.ones(1, dtype=int), "finite"),
        (np.diag([100.0, 0.0, 0.0]), np.eye(3), np.ones(3, dtype=int), "millimetres"),
        (np.zeros((1, 3)), np.full((1, 3), 2.0), np.ones(1, dtype=int), "unit length"),
        (np.zeros((1, 3)), np.eye(3)[:1], np.zeros(1, dtype=int), "whole numbers from 1"),
        (np.zeros((1, 3)), np.eye(3)[:1], np.ones(1), "whole numbers from 1"),
        (np.zeros((1, 3)), np.eye(3)[:1], np.ones(2, dtype=int), "whole numbers from 1"),
    ],
)
def test_no_such_points_can_be_made(targets, normals, groups, words):
    with pytest.raises(InspectionPointsError, match=words):
        InspectionPoints(targets, normals, groups)
