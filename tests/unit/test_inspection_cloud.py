"""PLY files: what is written is read back, and what is damaged is named."""

from pathlib import Path

import numpy as np
import pytest

from skinplan.errors import CloudInvalidError
from skinplan.inspection.cloud import read_ply, write_ply

POINTS = np.random.default_rng(0).normal(size=(1000, 3)) * 3


def test_round_trip(tmp_path: Path) -> None:
    values = {"deviation": POINTS[:, 0] * 1e-4, "intensity": np.arange(1000.0)}
    values["deviation"][3] = np.nan
    write_ply(tmp_path / "cloud.ply", POINTS, "tracker", values)
    cloud = read_ply(tmp_path / "cloud.ply")
    assert cloud.frame == "tracker"
    assert np.array_equal(cloud.points, POINTS.astype(np.float32))
    assert list(cloud.values) == ["deviation", "intensity"]
    assert np.array_equal(
        cloud.values["deviation"], values["deviation"].astype(np.float32), equal_nan=True
    )
    assert list(tmp_path.iterdir()) == [tmp_path / "cloud.ply"]


def test_another_library_reads_the_same(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    write_ply(tmp_path / "cloud.ply", POINTS, values={"deviation": POINTS[:, 1]})
    assert np.array_equal(
        np.asarray(trimesh.load(tmp_path / "cloud.ply").vertices), POINTS.astype(np.float32)
    )


def test_a_cloud_without_points_is_a_file(tmp_path: Path) -> None:
    write_ply(tmp_path / "cloud.ply", np.zeros((0, 3)), "workpiece")
    assert read_ply(tmp_path / "cloud.ply").points.shape == (0, 3)


def test_big_endian_doubles_of_others_are_read(tmp_path: Path) -> None:
    header = (
        "ply\nformat binary_big_endian 1.0\ncomment made elsewhere\nelement vertex 2\nproperty "
        "double x\n"
        "property float64 y\nproperty float z\nproperty uchar red\nelement face 0\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    kind = np.dtype([("x", ">f8"), ("y", ">f8"), ("z", ">f4"), ("red", "u1")])
    table = np.array([(1.5, 2.5, 3.5, 7), (-1, 0, 1, 255)], dtype=kind)
    (tmp_path / "c.ply").write_bytes(header.encode() + table.tobytes())
    cloud = read_ply(tmp_path / "c.ply")
    assert cloud.points.tolist() == [[1.5, 2.5, 3.5], [-1, 0, 1]]
    assert cloud.values["red"].tolist() == [7, 255]
    assert cloud.frame == ""


HEADER = "ply\nformat binary_little_endian 1.0\nelement vertex {n}\n{p}end_header\n"
XYZ = "property float x\nproperty float y\nproperty float z\n"


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "ply"),
        (b"solid cube\n", "'ply'"),
        (
            b"ply\nformat ascii 1.0\nelement vertex 0\n" + XYZ.encode() + b"end_header\n",
            "binary_little_endian",
        ),
        (b"ply\n" + b"x" * 100_000, "header"),
        (HEADER.format(n=10, p=XYZ).encode() + bytes(50), "50 bytes follow"),
        (HEADER.format(n=10**18, p=XYZ).encode(), "2000000000"),
        (HEADER.format(n=-1, p=XYZ).encode(), "'-1'"),
        (HEADER.format(n=0, p="property float x\n").encode(), "x, y and z"),
        (HEADER.format(n=0, p=XYZ + "property float x\n").encode(), "once"),
        (HEADER.format(n=0, p=XYZ + "property list uchar int i\n").encode(), "plain numbers"),
        (b"ply\nformat binary_little_endian 1.0\nelement face 1\nend_header\n", "vertex"),
        (HEADER.format(n=1, p=XYZ).encode() + np.array([1, np.nan, 2], "<f4").tobytes(), "finite"),
    ],
)
def test_what_is_no_cloud_is_named(tmp_path: Path, content: bytes, says: str) -> None:
    (tmp_path / "bad.ply").write_bytes(content)
    with pytest.raises(CloudInvalidError, match=says) as raised:
        read_ply(tmp_path / "bad.ply")
    assert "bad.ply" in str(raised.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(CloudInvalidError, match=r"none\.ply"):
        read_ply(tmp_path / "none.ply")


def test_what_can_t_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(CloudInvalidError, match="shape"):
        write_ply(tmp_path / "c.ply", np.zeros((4, 2)))
    for name, value in (("a b", np.zeros(1000)), ("x", np.zeros(1000)), ("short", np.zeros(3))):
        with pytest.raises(CloudInvalidError, match=name):
            write_ply(tmp_path / "c.ply", POINTS, values={name: value})
    with pytest.raises(CloudInvalidError, match="can't be written"):
        write_ply(tmp_path / "no folder" / "c.ply", POINTS)
    assert not any(tmp_path.iterdir())
