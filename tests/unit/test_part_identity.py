"""What a part file says about itself, without loading its mesh."""

import os
from pathlib import Path

import pytest

from skinplan.errors import MeshNotFoundError, PartInvalidError, PartNotFoundError
from skinplan.mesh.load import file_sha256
from skinplan.part.identity import PartIdentities
from skinplan.part.samples import write_sample


@pytest.fixture
def part_file(tmp_path: Path) -> Path:
    source = write_sample("scene2", tmp_path).source
    assert source is not None
    return source


def test_id_and_hash_are_those_of_the_part(part_file: Path) -> None:
    found = PartIdentities().of(part_file)
    assert found.id == "scene2"
    assert found.mesh_sha256 == file_sha256(part_file.with_name("scene2.stl"))


def test_another_mesh_under_the_same_name_is_noticed(part_file: Path) -> None:
    identities, mesh = PartIdentities(), part_file.with_name("scene2.stl")
    before = identities.of(part_file).mesh_sha256
    mesh.write_bytes(mesh.read_bytes() + b" ")
    after = identities.of(part_file).mesh_sha256
    assert after == file_sha256(mesh) != before


def test_what_is_missing_or_no_part_is_named(part_file: Path, tmp_path: Path) -> None:
    identities = PartIdentities()
    identities.of(part_file)
    part_file.with_name("scene2.stl").unlink()
    with pytest.raises(MeshNotFoundError):
        identities.of(part_file)
    part_file.write_text("id: 'a b'\nmesh: {file: x.stl}")
    with pytest.raises(PartInvalidError, match="letters"):
        identities.of(part_file)
    part_file.write_text("[1, 2")
    with pytest.raises(PartInvalidError):
        identities.of(part_file)
    with pytest.raises((PartNotFoundError, MeshNotFoundError)):
        identities.of(tmp_path / "none.yaml")


def test_large_files_are_left_to_those_who_load_them(part_file: Path) -> None:
    mesh = part_file.with_name("scene2.stl")
    os.truncate(mesh, 70_000_000)
    assert PartIdentities().of(part_file).mesh_sha256 == ""
    part_file.write_text(part_file.read_text() + "#" * 200_000)
    assert PartIdentities().of(part_file).id == ""
