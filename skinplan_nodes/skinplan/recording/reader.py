"""Opens rosbag2 bags.

A folder with or without ``metadata.yaml``, split or not, or a single MCAP file.
"""

from collections.abc import Collection, Iterator
from pathlib import Path, PurePosixPath
from typing import Any

import yaml

from skinplan.errors import BagInvalidError, BagNotFoundError
from skinplan.recording.mcap_file import FileIndex, iterate, read_index
from skinplan.recording.metadata import read_metadata
from skinplan.recording.model import BagInfo, BagMessage, BagTopic
from skinplan.recording.qos import qos_profiles


def open_bag(path: Path | str) -> BagInfo:
    """Reads what is in a bag.

    Args:
        path: Bag folder or MCAP file.

    Returns:
        Topics, counts and times, counted in the files themselves. A recording that was cut off is
        opened up to its last
        complete chunk and says so (``complete``).

    Raises:
        BagNotFoundError: Nothing is there, or a file that ``metadata.yaml`` names is missing.
        BagInvalidError: No readable bag.
    """
    place = Path(path).absolute()
    if not place.exists():
        raise BagNotFoundError(
            f"bag {place} was asked for; a bag folder or an MCAP file is accepted, nothing is there"
        )
    metadata = read_metadata(place) if place.is_dir() else None
    files = _storage_files(place, metadata)
    indexes = [read_index(file) for file in files]
    filled = [index for index in indexes if index.messages]
    return BagInfo(
        path=place,
        files=tuple(files),
        topics=_topics(indexes, metadata),
        messages=sum(index.messages for index in indexes),
        start_ns=min((index.start_ns for index in filled), default=0),
        end_ns=max((index.end_ns for index in filled), default=0),
        bytes=sum(file.stat().st_size for file in files),
        complete=all(index.complete for index in indexes),
        custom_data=_custom_data(indexes, metadata),
    )


def read_messages(
    bag: BagInfo,
    topics: Collection[str] | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> Iterator[BagMessage]:
    """Iterates over the messages, file after file, in each by log time.

    Args:
        bag: From `open_bag`.
        topics: Topics to read; None = all.
        start_ns: Messages before this log time are left out [ns since the epoch]; None = all.
        end_ns: Messages from this log time on are left out [ns since the epoch]; None = all.

    Yields:
        Messages, still serialised.

    Raises:
        BagInvalidError: A file is damaged.
    """
    for file in bag.files:
        index = read_index(file)
        for channel, message in iterate(index, start_ns, end_ns):
            if topics is None or channel.topic in topics:
                schema = index.schemas.get(channel.schema_id)
                yield BagMessage(
                    channel.topic,
                    schema.name if schema else "",
                    message.data,
                    message.log_time,
                    message.publish_time,
                )


def _storage_files(place: Path, metadata: dict[str, Any] | None) -> list[Path]:
    if place.is_file():
        return [place]
    if metadata is None:
        files = sorted(place.glob("*.mcap"), key=_split_number)
        if not files:
            raise BagInvalidError(
                f"{place}: a folder with metadata.yaml or MCAP files is accepted, it has neither"
            )
        return files
    storage = metadata.get("storage_identifier")
    if storage != "mcap":
        raise BagInvalidError(f"{place}: storage mcap is accepted, found {storage!r}")
    names = metadata.get("relative_file_paths")
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise BagInvalidError(
            f"{place}: metadata.yaml with relative_file_paths is accepted, found {names!r}"
        )
    # Older versions put the bag's folder before the name; never follow a name out of the folder.
    files = [place / PurePosixPath(name).name for name in names]
    for file in files:
        if not file.is_file():
            raise BagNotFoundError(
                f"{place}: metadata.yaml names {file.name}, but the file is missing"
            )
    return files


def _split_number(path: Path) -> tuple[int, str]:
    tail = path.stem.rsplit("_", 1)[-1]
    return (int(tail) if tail.isdecimal() else -1, path.name)


def _topics(indexes: list[FileIndex], metadata: dict[str, Any] | None) -> tuple[BagTopic, ...]:
    found: dict[str, BagTopic] = {}
    for index in indexes:
        for number, channel in index.channels.items():
            known = found.get(channel.topic)
            schema = index.schemas.get(channel.schema_id)
            found[channel.topic] = BagTopic(
                name=channel.topic,
                type_name=schema.name if schema else "",
                messages=index.counts.get(number, 0) + (known.messages if known else 0),
                type_hash=channel.metadata.get("topic_type_hash", ""),
                qos=qos_profiles(channel.metadata.get("offered_qos_profiles", "")),
                schema_text=schema.data.decode("utf-8", "replace") if schema else "",
                encoding=channel.message_encoding,
            )
    for topic in _silent_topics(metadata):
        found.setdefault(topic.name, topic)
    return tuple(found[name] for name in sorted(found))


def _silent_topics(metadata: dict[str, Any] | None) -> list[BagTopic]:
    """Topics that only ``metadata.yaml`` knows, because nothing was ever published on them."""
    try:
        listed = [
            item["topic_metadata"]
            for item in (metadata or {}).get("topics_with_message_count") or []
        ]
        return [
            BagTopic(
                name=str(item["name"]),
                type_name=str(item["type"]),
                messages=0,
                type_hash=str(item.get("type_description_hash", "")),
                qos=qos_profiles(item.get("offered_qos_profiles", "")),
                encoding=str(item.get("serialization_format", "cdr")),
            )
            for item in listed
        ]
    except (KeyError, TypeError, AttributeError) as error:
        raise BagInvalidError(
            f"metadata.yaml: topics as rosbag2 writes them are accepted ({error!r})"
        ) from error


def _custom_data(indexes: list[FileIndex], metadata: dict[str, Any] | None) -> dict[str, str]:
    found = metadata
    if found is None and indexes:
        try:
            found = yaml.safe_load(indexes[-1].metadata.get("serialized_metadata", ""))
        except (yaml.YAMLError, ValueError, RecursionError):
            found = None
    custom = found.get("custom_data") if isinstance(found, dict) else None
    return (
        {str(key): str(value) for key, value in custom.items()} if isinstance(custom, dict) else {}
    )
