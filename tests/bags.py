"""Bags for tests in the forms that rosbag2 writes: SQLite of several versions, packed, split."""

import sqlite3
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml
import zstandard
from mcap.reader import make_reader

QOS = {
    "history": 1,
    "depth": 1,
    "reliability": 1,
    "durability": 2,
    "deadline": {"sec": 9223372036, "nsec": 854775807},
    "lifespan": {"sec": 9223372036, "nsec": 854775807},
    "liveliness": 1,
    "liveliness_lease_duration": {"sec": 9223372036, "nsec": 854775807},
    "avoid_ros_namespace_conventions": False,
}
LATCHED_TEXT = yaml.safe_dump([{**QOS, "durability": 1}])
VOLATILE_TEXT = yaml.safe_dump([QOS])


@dataclass(frozen=True)
class Row:
    """One message: topic, time [ns], data."""

    topic: str
    at_ns: int
    data: bytes


TYPE = "std_msgs/msg/String"


def write_sqlite(path: Path, rows: Sequence[Row], version: int = 9, packed: bool = False) -> None:
    """Writes a storage file as rosbag2 does with a metadata version."""
    base = sqlite3.connect(path)
    columns = "id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, "
    columns += "serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL"
    if version >= 7:
        columns += ", type_description_hash TEXT NOT NULL"
        base.execute(
            "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, "
            "encoding TEXT NOT NULL, encoded_message_definition TEXT NOT NULL, "
            "type_description_hash TEXT NOT NULL)"
        )
        base.execute(
            "INSERT INTO message_definitions VALUES(1, ?, 'ros2msg', 'string data', '')", (TYPE,)
        )
    base.execute(f"CREATE TABLE topics({columns})")
    base.execute(
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, "
        "timestamp INTEGER NOT NULL, data BLOB NOT NULL)"
    )
    base.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
    names = sorted({row.topic for row in rows})
    for number, name in enumerate(names, 1):
        qos = LATCHED_TEXT if name.startswith("/latched") else VOLATILE_TEXT
        values: list[Any] = [number, name, TYPE, "cdr", qos] + ([""] if version >= 7 else [])
        base.execute(f"INSERT INTO topics VALUES({','.join('?' * len(values))})", values)
    for row in rows:
        data = zstandard.compress(row.data) if packed else row.data
        base.execute(
            "INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)",
            (names.index(row.topic) + 1, row.at_ns, data),
        )
    base.commit()
    base.close()


def write_metadata(
    folder: Path, names: Sequence[str], rows: Sequence[Row], version: int, **more: str
) -> None:
    """Writes ``metadata.yaml`` of a version."""
    counts = {name: sum(row.topic == name for row in rows) for name in {r.topic for r in rows}}
    first, last = min(r.at_ns for r in rows), max(r.at_ns for r in rows)
    topics: list[dict[str, Any]] = []
    for name, count in counts.items():
        text = LATCHED_TEXT if name.startswith("/latched") else VOLATILE_TEXT
        fields: dict[str, Any] = {"name": name, "type": TYPE, "serialization_format": "cdr"}
        fields["offered_qos_profiles"] = yaml.safe_load(text) if version >= 9 else text
        if version >= 7:
            fields["type_description_hash"] = ""
        topics.append({"topic_metadata": fields, "message_count": count})
    found: dict[str, Any] = {
        "version": version,
        "storage_identifier": "sqlite3",
        "duration": {"nanoseconds": last - first},
        "starting_time": {"nanoseconds_since_epoch": first},
        "message_count": len(rows),
        "topics_with_message_count": topics,
        "compression_format": more.get("compression_format", ""),
        "compression_mode": more.get("compression_mode", ""),
        "relative_file_paths": list(names),
    }
    if version >= 5:
        found["files"] = [{"path": name} for name in names]
    if version >= 6:
        found["custom_data"] = {"job": "a"}
    if version >= 8:
        found["ros_distro"] = "jazzy"
    text = yaml.safe_dump({"rosbag2_bagfile_information": found})
    (folder / "metadata.yaml").write_text(text, encoding="utf-8")


def texts_of_rosbags(folder: Path) -> list[str]:
    """The texts of all messages of a bag of strings, decoded by rosbags."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    with rosbag2.Reader(folder) as reader:
        return [store.deserialize_cdr(data, c.msgtype).data for c, _, data in reader.messages()]


def texts_of_mcap(folder: Path) -> list[str]:
    """The same by mcap and mcap-ros2-support, CRCs checked."""
    decoder = pytest.importorskip("mcap_ros2.decoder")
    found = []
    for file in sorted(folder.glob("*.mcap")):
        with file.open("rb") as stream:
            reader = make_reader(
                stream, validate_crcs=True, decoder_factories=[decoder.DecoderFactory()]
            )
            found += [m.decoded_message.data for m in reader.iter_decoded_messages()]
    return found
