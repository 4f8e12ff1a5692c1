"""Messages are decoded by the definitions in the bag, and exported as tables, clouds and videos."""

import csv
import importlib.util
import itertools
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap_ros2._dynamic import generate_dynamic
from mcap_ros2.writer import serialize_dynamic

from skinplan.errors import BagInvalidError, InputError
from skinplan.inspection.cloud import read_ply
from skinplan.recording.bag import BagWriter
from skinplan.recording.cdr import CdrDecoder
from skinplan.recording.export import export_bag
from skinplan.recording.schema import SEPARATOR

HEADER = (
    f"\n{SEPARATOR}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{SEPARATOR}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)
IMAGE = (
    "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\n"
    "uint32 step\nuint8[] data" + HEADER
)
CLOUD = (
    "std_msgs/Header header\nuint32 height\nuint32 width\nPointField[] fields\nbool is_bigendian\n"
    "uint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense" + HEADER
    + f"{SEPARATOR}\nMSG: sensor_msgs/PointField\nuint8 FLOAT32 = 7\nstring name\nuint32 offset\n"
    "uint8 datatype\nuint32 count\n"
)  # fmt: skip
JOINTS = "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity" + HEADER
POSE = (
    "std_msgs/Header header\ngeometry_msgs/Pose pose" + HEADER
    + f"{SEPARATOR}\nMSG: geometry_msgs/Pose\nPoint position\nQuaternion orientation\n"
    f"{SEPARATOR}\nMSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
    f"{SEPARATOR}\nMSG: geometry_msgs/Quaternion\nfloat64 x 0\nfloat64 y 0\nfloat64 z 0\n"
    "float64 w 1\n"
)  # fmt: skip
MIXED = (
    "bool yes\nuint8 LIMIT=3\nint16 small # a comment\nfloat64[3] fixed\nuint64[<=4] some\n"
    "string<=10 name\nstring[] names\nInner inner\nInner[2] pair\nint8 last"
    f"\n{SEPARATOR}\nMSG: demo/Inner\nfloat32 value\nuint64[] more\nEmpty nothing\n"
    f"{SEPARATOR}\nMSG: demo/Empty\n"
)


def stamped(frame: str = "tracker", sec: int = 3) -> dict[str, object]:
    return {"stamp": {"sec": sec, "nanosec": 500_000_000}, "frame_id": frame}


def serialised(kind: str, schema: str, message: dict[str, object]) -> bytes:
    return bytes(serialize_dynamic(kind, schema)[kind](message))


@pytest.mark.parametrize("lengths", list(itertools.product((0, 1, 3), (0, 2), (0, 1, 4))))
def test_decoder_agrees_with_an_independent_one(lengths: tuple[int, int, int]) -> None:
    inner = {"value": 0.5, "more": list(range(lengths[0])), "nothing": {}}
    message = {
        "yes": True,
        "small": -7,
        "fixed": [1.0, 2.0, 3.0],
        "some": list(range(lengths[2])),
        "name": "n" * lengths[0],
        "names": ["äb"] * lengths[1],
        "inner": inner,
        "pair": [inner, inner],
        "last": -1,
    }
    schema = MIXED.replace("Empty nothing\n", "")
    for piece in (inner,):
        piece.pop("nothing")
    schema = schema[: schema.index(f"{SEPARATOR}\nMSG: demo/Empty")]
    data = serialised("demo/msg/Mixed", schema, message)
    found = CdrDecoder("demo/msg/Mixed", schema).decode(data)
    theirs = generate_dynamic("demo/msg/Mixed", schema)["demo/msg/Mixed"](data)
    assert found["name"] == theirs.name and found["names"] == theirs.names
    assert found["fixed"].tolist() == list(theirs.fixed)
    assert found["some"].tolist() == list(theirs.some)
    assert [p["more"].tolist() for p in found["pair"]] == [list(p.more) for p in theirs.pair]
    assert (found["yes"], found["small"], found["last"]) == (True, -7, -1)
    for cut in range(4, len(data) - 1):
        with pytest.raises(BagInvalidError, match="demo/msg/Mixed"):
            CdrDecoder("demo/msg/Mixed", schema).decode(data[:cut])


def test_definitions_that_can_t_be_used_are_named() -> None:
    for kind, text in (("demo/msg/A", ""), ("demo/msg/A", "demo/B b"), ("", "int8 a")):
        with pytest.raises(BagInvalidError, match="definition"):
            CdrDecoder(kind, text)
    endless = CdrDecoder("demo/msg/A", "A again")
    with pytest.raises(BagInvalidError, match="contain themselves"):
        endless.decode(bytes([0, 1, 0, 0, 0, 0]))
    empty = CdrDecoder("demo/msg/A", f"B b\nint8 last\n{SEPARATOR}\nMSG: demo/B\n")
    assert empty.decode(bytes([0, 1, 0, 0, 0, 7])) == {"b": {}, "last": 7}


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("export") / "bag"
    kinds = {
        "/camera/image": ("sensor_msgs/msg/Image", IMAGE),
        "/scanner/points": ("sensor_msgs/msg/PointCloud2", CLOUD),
        "/joint_states": ("sensor_msgs/msg/JointState", JOINTS),
        "/pose": ("geometry_msgs/msg/PoseStamped", POSE),
    }
    fields = [
        {"name": name, "offset": 4 * i, "datatype": 7, "count": 1}
        for i, name in enumerate(("x", "y", "z", "intensity"))
    ]
    with BagWriter(folder) as writer:
        for name, (kind, schema) in kinds.items():
            writer.add_topic(name, kind, schema)
        for number in range(10):
            points = np.full((50, 4), 0.1 * number, np.float32)
            points[:, 1] = np.arange(50) * 0.01
            points[0, 2] = np.nan
            pose = {"x": 1.0 * number, "y": 0.0, "z": 0.0}
            image = np.full((48, 64, 3), 20 * number, np.uint8)
            messages = {
                "/camera/image": {
                    "header": stamped(sec=number), "height": 48, "width": 64, "encoding": "rgb8",
                    "is_bigendian": 0, "step": 192, "data": image.tobytes(),
                },
                "/scanner/points": {
                    "header": stamped(), "height": 1, "width": 50, "fields": fields,
                    "is_bigendian": False, "point_step": 16, "row_step": 800,
                    "data": points.tobytes(), "is_dense": False,
                },
                "/joint_states": {
                    "header": stamped(), "name": ["a", "b"], "position": [1.0, 0.5 * number],
                    "velocity": [],
                },
                "/pose": {
                    "header": stamped("map"),
                    "pose": {"position": pose, "orientation": {**pose, "x": 0.0, "w": 1.0}},
                },
            }  # fmt: skip
            for topic, message in messages.items():
                data = serialised(*kinds[topic], message)
                writer.write(topic, data, 10**9 + number * 10**8)
    return folder


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_tables_cloud_and_camera(bag: Path, tmp_path: Path) -> None:
    found = {item.path.name: item.items for item in export_bag(bag, tmp_path)}
    assert found == {
        "joints.csv": 10,
        "poses.csv": 10,
        "scanner_points.tracker.ply": 490,
        "camera_image.mp4": 10,
    }
    assert [float(r["b_rad"]) for r in rows(tmp_path / "joints.csv")] == [
        0.5 * i for i in range(10)
    ]
    assert [float(r["x_m"]) for r in rows(tmp_path / "poses.csv")] == list(range(10))
    assert {r["parent"] for r in rows(tmp_path / "poses.csv")} == {"map"}
    cloud = read_ply(tmp_path / "scanner_points.tracker.ply")
    points = getattr(cloud, "points", cloud)
    assert np.allclose(points[:49, 1], np.arange(1, 50) * 0.01)
    video = cv2.VideoCapture(str(tmp_path / "camera_image.mp4"))
    assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(10.0)
    for number in range(10):
        is_there, image = video.read()
        assert is_there and abs(float(image.mean()) - 20 * number) < 4.0
    assert [float(r["stamp_s"]) for r in rows(tmp_path / "camera_image.csv")] == [
        i + 0.5 for i in range(10)
    ]


@pytest.mark.skipif(importlib.util.find_spec("pyarrow") is None, reason="make extras")
def test_parquet_has_what_csv_has(bag: Path, tmp_path: Path) -> None:
    import pyarrow.parquet

    export_bag(bag, tmp_path, ["joints"], table_format="parquet")
    table = pyarrow.parquet.read_table(tmp_path / "joints.parquet").to_pydict()
    assert table["b_rad"] == [0.5 * i for i in range(10)]


@pytest.mark.skipif(importlib.util.find_spec("laspy") is None, reason="make extras")
def test_laz_has_what_ply_has(bag: Path, tmp_path: Path) -> None:
    import laspy

    (found,) = export_bag(bag, tmp_path, ["cloud"], cloud_format="laz")
    cloud = laspy.read(found.path)
    assert len(cloud.points) == found.items == 490
    assert np.allclose(cloud.y[:49], np.arange(1, 50) * 0.01, atol=1e-5)
    assert np.allclose(cloud["recorded_intensity"][-1], 0.9)


def test_refusals_of_the_export(bag: Path, tmp_path: Path) -> None:
    for given, words in (
        ({"what": ["everything"]}, "trajectories, joints"),
        ({"table_format": "xlsx"}, "csv, parquet"),
        ({"cloud_format": "obj"}, "ply, laz"),
    ):
        with pytest.raises(InputError, match=words):
            export_bag(bag, tmp_path, **given)  # type: ignore[arg-type]
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="file"):
        export_bag(bag, tmp_path / "file")
