"""The document ``metadata.yaml`` of a bag, version 9, as rosbag2 0.26 writes it."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from skinplan.errors import BagInvalidError
from skinplan.recording.model import BagTopic
from skinplan.recording.qos import qos_document
from skinplan.whole_file import whole_file

VERSION = 9
FILE_NAME = "metadata.yaml"
RECORD_NAME = "rosbag2"
# What rosbag2 writes as the start of a bag without messages.
_NO_START = 2**63 - 1
_LARGEST = 64 * 2**20


@dataclass(frozen=True)
class FileFigures:
    """One storage file of a bag.

    Attributes:
        name: File name inside the bag folder.
        messages: Number of messages.
        start_ns: Log time of the first [ns]; any value without messages.
        end_ns: Log time of the last [ns]; any value without messages.
    """

    name: str
    messages: int
    start_ns: int
    end_ns: int


def metadata_document(
    files: Sequence[FileFigures],
    topics: Sequence[BagTopic],
    custom_data: Mapping[str, str],
    ros_distro: str,
) -> dict[str, Any]:
    """Returns the fields below ``rosbag2_bagfile_information``, in rosbag2's order."""
    filled = [file for file in files if file.messages]
    start = min((file.start_ns for file in filled), default=_NO_START)
    end = max((file.end_ns for file in filled), default=_NO_START)
    return {
        "version": VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": end - start},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": sum(file.messages for file in files),
        "topics_with_message_count": [_topic(topic) for topic in topics],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [_file(file) for file in files],
        "custom_data": dict(custom_data) or None,
        "ros_distro": ros_distro,
    }


def metadata_text(document: Mapping[str, Any]) -> str:
    """Returns a document as YAML in the layout that rosbag2 writes."""
    return str(
        yaml.dump(document, Dumper=_Dumper, sort_keys=False, width=10**6, allow_unicode=True)
    )


def write_metadata(folder: Path, document: Mapping[str, Any]) -> None:
    """Writes ``metadata.yaml`` in one step, and brings it to the disk.

    Raises:
        OSError: The disk does not take it; what was there before is still there.
    """
    text = metadata_text({"rosbag2_bagfile_information": document})
    path = folder / FILE_NAME
    with whole_file(path) as temporary, temporary.open("w", encoding="utf-8") as stream:
        stream.write(text)
        stream.flush()
        os.fsync(stream.fileno())


def read_metadata(folder: Path) -> dict[str, Any] | None:
    """Reads the fields below ``rosbag2_bagfile_information``.

    Args:
        folder: Bag folder.

    Returns:
        The fields, or None when there is no ``metadata.yaml``.

    Raises:
        BagInvalidError: The file is no metadata of rosbag2.
    """
    path = folder / FILE_NAME
    try:
        if not path.exists():
            return None
        if path.stat().st_size > _LARGEST:
            raise BagInvalidError(
                f"{path}: metadata up to {_LARGEST} bytes is accepted, found {path.stat().st_size}"
            )
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        raise BagInvalidError(
            f"{path}: YAML as rosbag2 writes it is accepted, found {error}"
        ) from error
    found = document.get("rosbag2_bagfile_information") if isinstance(document, dict) else None
    if not isinstance(found, dict):
        raise BagInvalidError(
            f"{path}: the key rosbag2_bagfile_information is accepted, it is missing"
        )
    return found


class _Dumper(yaml.SafeDumper):
    """Sequences indented below their key, no aliases, ~ for nothing: the layout of yaml-cpp."""

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> None:
        super().increase_indent(flow, False)

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _nothing(dumper: yaml.SafeDumper, _: None) -> yaml.Node:
    return dumper.represent_scalar("tag:yaml.org,2002:null", "~")


def _text(dumper: yaml.SafeDumper, value: str) -> yaml.Node:
    return dumper.represent_scalar("tag:yaml.org,2002:str", value, style=None if value else '"')


_Dumper.add_representer(type(None), _nothing)
_Dumper.add_representer(str, _text)


def _topic(topic: BagTopic) -> dict[str, Any]:
    return {
        "topic_metadata": {
            "name": topic.name,
            "type": topic.type_name,
            "serialization_format": topic.encoding,
            "offered_qos_profiles": qos_document(topic.qos),
            "type_description_hash": topic.type_hash,
        },
        "message_count": topic.messages,
    }


def _file(file: FileFigures) -> dict[str, Any]:
    start = file.start_ns if file.messages else _NO_START
    return {
        "path": file.name,
        "starting_time": {"nanoseconds_since_epoch": start},
        "duration": {"nanoseconds": file.end_ns - start if file.messages else 0},
        "message_count": file.messages,
    }
