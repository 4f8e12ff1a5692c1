"""Builds ``metadata.yaml`` anew from the files of a bag."""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import yaml
from mcap.records import Channel, Schema

from skinplan.errors import BagInvalidError
from skinplan.recording.mcap_storage import McapStorage
from skinplan.recording.metadata import (
    FileFigures,
    metadata_document,
    read_metadata,
    write_metadata,
)
from skinplan.recording.model import BagTopic
from skinplan.recording.qos import QosProfile, qos_profiles
from skinplan.recording.storage import StorageInfo

_DISTRO = "jazzy"


def rebuild_metadata(folder: Path, files: Sequence[Path], healed: str) -> None:
    """Writes ``metadata.yaml`` from what is in the files.

    Args:
        folder: Bag folder.
        files: Its files in the order of recording.
        healed: Sentence about what was lost, kept in ``custom_data``; empty = nothing.

    Raises:
        BagInvalidError: A file can't be read.
        OSError: The disk does not take it.
    """
    infos = [storage_info(file) for file in files]
    facts: dict[str, str] = {}
    distro = _DISTRO
    for info in infos:
        document = recorded_document(info.metadata)
        facts.update(custom_data(document))
        distro = str(document.get("ros_distro") or distro)
    if healed:
        facts["healed"] = healed
    figures = [FileFigures(i.path.name, i.messages, i.start_ns, i.end_ns) for i in infos]
    topics = merged_topics(info.topics for info in infos)
    write_metadata(folder, metadata_document(figures, topics, facts, distro))


def metadata_fits(folder: Path, files: Sequence[Path]) -> bool:
    """Tells whether ``metadata.yaml`` is there, readable, and names these files."""
    try:
        found = read_metadata(folder)
    except BagInvalidError:
        return False
    named = (found or {}).get("relative_file_paths")
    if not isinstance(named, list):
        return False
    return sorted(Path(str(name)).name for name in named) == sorted(file.name for file in files)


def storage_info(path: Path) -> StorageInfo:
    """Returns what is in one MCAP file.

    Raises:
        BagInvalidError: It can't be read.
    """
    with closing(McapStorage(path)) as storage:
        return storage.info


def recorded_document(text: str) -> dict[str, Any]:
    """Reads the text of a ``rosbag2`` record; empty when there is none that can be read."""
    try:
        found = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def custom_data(document: Mapping[str, Any]) -> dict[str, str]:
    """Returns the facts about the run in a document."""
    found = document.get("custom_data")
    return {str(k): str(v) for k, v in found.items()} if isinstance(found, dict) else {}


def described_topics(
    described: Iterable[tuple[Channel, Schema | None]], counts: Mapping[int, int]
) -> list[BagTopic]:
    """Returns the topics of one file.

    Args:
        described: Channels with their schemas.
        counts: Messages by channel.
    """
    return merged_topics(
        [_topic(channel, schema, counts.get(channel.id, 0))] for channel, schema in described
    )


def merged_topics(parts: Iterable[Sequence[BagTopic]]) -> list[BagTopic]:
    """Adds up topics of the same name; the last one's QoS counts, as it knew most publishers."""
    merged: dict[str, BagTopic] = {}
    for part in parts:
        for topic in part:
            before = merged.get(topic.name)
            messages = topic.messages + (before.messages if before else 0)
            merged[topic.name] = BagTopic(
                topic.name,
                topic.type_name,
                messages,
                topic.type_hash,
                topic.qos,
                topic.schema_text,
                topic.encoding,
            )
    return list(merged.values())


def _topic(channel: Channel, schema: Schema | None, messages: int) -> BagTopic:
    return BagTopic(
        name=channel.topic,
        type_name=schema.name if schema is not None else "",
        messages=messages,
        type_hash=channel.metadata.get("topic_type_hash", ""),
        qos=_qos(channel.metadata.get("offered_qos_profiles", "")),
        schema_text=schema.data.decode(errors="replace") if schema is not None else "",
        encoding=channel.message_encoding,
    )


def _qos(text: str) -> tuple[QosProfile, ...]:
    try:
        return qos_profiles(text)
    except BagInvalidError:
        return ()
