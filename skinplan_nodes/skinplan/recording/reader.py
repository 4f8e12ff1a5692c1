"""Opens rosbag2 bags of any storage, version and compression.

A folder with or without ``metadata.yaml``, split or not, or a single storage file; MCAP or SQLite.
"""

import heapq
from collections.abc import Collection, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import yaml

from skinplan.errors import BagInvalidError
from skinplan.recording.bag_folder import PACKED, BagFiles, bag_files, compression_of, kind_of
from skinplan.recording.mcap_storage import McapStorage
from skinplan.recording.model import BagInfo, BagMessage, BagTopic
from skinplan.recording.qos import qos_profiles
from skinplan.recording.sqlite_storage import SqliteStorage
from skinplan.recording.storage import Storage
from skinplan.recording.unpack import UnpackedFile, UnpackedMessages


class BagReader:
    """One open bag; a context manager, for one thread.

    Args:
        path: Bag folder or storage file.

    Attributes:
        info: What is in it.

    Raises:
        BagNotFoundError: Nothing is there, or a file that ``metadata.yaml`` names is missing.
        BagInvalidError: No readable bag.
    """

    def __init__(self, path: Path | str) -> None:
        files = bag_files(path)
        self._unpacked: list[UnpackedFile] = []
        self._storages: list[Storage] = []
        try:
            for file in files.paths:
                self._storages.append(self._opened(file))
            metadata = files.metadata or _inner_metadata(self._storages)
            packed = files.message_compression or compression_of(metadata)
            if packed:
                self._storages = [UnpackedMessages(inner, packed) for inner in self._storages]
            self.info = _info(files, self._storages, metadata)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Closes the files."""
        for storage in self._storages:
            storage.close()
        for unpacked in self._unpacked:
            unpacked.close()

    def messages(
        self,
        topics: Collection[str] | None = None,
        start_ns: int | None = None,
        end_ns: int | None = None,
    ) -> Iterator[BagMessage]:
        """Iterates over the messages by log time, equal times in the order of recording.

        Args:
            topics: Topics to read; None = all.
            start_ns: Messages before this log time are left out [ns since the epoch]; None = all.
            end_ns: Messages from this log time on are left out [ns since the epoch]; None = all.

        Yields:
            Messages, still serialised.

        Raises:
            BagInvalidError: A file is damaged.
        """
        chosen = None if topics is None else frozenset(topics)
        filled = sorted(
            (storage for storage in self._storages if storage.info.messages),
            key=lambda storage: storage.info.start_ns,
        )
        for group in _overlapping(filled):
            sources = [storage.messages(chosen, start_ns, end_ns) for storage in group]
            if len(sources) == 1:
                yield from sources[0]
            else:
                yield from heapq.merge(*sources, key=lambda message: message.log_time_ns)

    def last(self, topic: str, at_ns: int, count: int = 1) -> list[BagMessage]:
        """Returns the last messages of a topic up to a log time, that time included, in order.

        Args:
            topic: The topic.
            at_ns: The log time [ns since the epoch].
            count: So many at most.

        Raises:
            BagInvalidError: A file is damaged.
        """
        found: list[BagMessage] = []
        for storage in sorted(self._storages, key=lambda s: s.info.end_ns, reverse=True):
            if storage.info.messages == 0 or storage.info.start_ns > at_ns:
                continue
            if len(found) >= count and storage.info.end_ns < found[-count].log_time_ns:
                break
            if any(t.name == topic and t.messages for t in storage.info.topics):
                found = [*storage.last(topic, at_ns, count), *found]
                found = sorted(found, key=lambda message: message.log_time_ns)[-count:]
        return found

    def _opened(self, file: Path) -> Storage:
        kind = kind_of(file)
        if file.name.endswith(PACKED):
            self._unpacked.append(UnpackedFile(file))
            file = self._unpacked[-1].path
        return McapStorage(file) if kind == "mcap" else SqliteStorage(file)


def open_bag(path: Path | str) -> BagInfo:
    """Reads what is in a bag.

    Args:
        path: Bag folder or storage file.

    Returns:
        Topics, counts and times, counted in the files themselves. A recording that was cut off is
        opened up to its last complete chunk and says so (``complete``).

    Raises:
        BagNotFoundError: Nothing is there, or a file that ``metadata.yaml`` names is missing.
        BagInvalidError: No readable bag.
    """
    with BagReader(path) as reader:
        return reader.info


def read_messages(
    bag: BagInfo,
    topics: Collection[str] | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> Iterator[BagMessage]:
    """Opens a bag anew and iterates over its messages, see `BagReader.messages`."""
    with BagReader(bag.path) as reader:
        yield from reader.messages(topics, start_ns, end_ns)


def _overlapping(storages: list[Storage]) -> Iterator[list[Storage]]:
    """Groups storages, sorted by their start, whose times overlap; mostly each is alone."""
    group: list[Storage] = []
    until_ns = 0
    for storage in storages:
        if group and storage.info.start_ns > until_ns:
            yield group
            group = []
        until_ns = max(until_ns, storage.info.end_ns) if group else storage.info.end_ns
        group.append(storage)
    if group:
        yield group


def _info(files: BagFiles, storages: list[Storage], metadata: dict[str, Any] | None) -> BagInfo:
    infos = [storage.info for storage in storages]
    filled = [info for info in infos if info.messages]
    return BagInfo(
        path=files.place,
        files=files.paths,
        topics=_topics([topic for info in infos for topic in info.topics], metadata),
        messages=sum(info.messages for info in infos),
        start_ns=min((info.start_ns for info in filled), default=0),
        end_ns=max((info.end_ns for info in filled), default=0),
        bytes=sum(file.stat().st_size for file in files.paths),
        complete=all(info.complete for info in infos),
        custom_data=_custom_data(metadata),
    )


def _topics(topics: list[BagTopic], metadata: dict[str, Any] | None) -> tuple[BagTopic, ...]:
    found: dict[str, BagTopic] = {}
    listed = {topic.name: topic for topic in _listed_topics(metadata)}
    for topic in topics:
        known = found.get(topic.name)
        also = listed.get(topic.name)
        found[topic.name] = BagTopic(
            name=topic.name,
            type_name=topic.type_name or (also.type_name if also else ""),
            messages=topic.messages + (known.messages if known else 0),
            type_hash=topic.type_hash or (also.type_hash if also else ""),
            # Each file of a split bag has the same ones again.
            qos=max((topic.qos, known.qos if known else (), also.qos if also else ()), key=len),
            schema_text=topic.schema_text or (known.schema_text if known else ""),
            encoding=topic.encoding,
        )
    # Topics that only the metadata know, because nothing was ever published on them.
    for topic in listed.values():
        found.setdefault(topic.name, topic)
    return tuple(found[name] for name in sorted(found))


def _listed_topics(metadata: dict[str, Any] | None) -> list[BagTopic]:
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


def _inner_metadata(storages: list[Storage]) -> dict[str, Any] | None:
    """Returns the metadata that the last file carries in itself; None = none that is readable."""
    text = storages[-1].info.metadata if storages else ""
    try:
        found = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError):
        return None
    if not isinstance(found, dict):
        return None
    inner = found.get("rosbag2_bagfile_information", found)
    return inner if isinstance(inner, dict) else None


def _custom_data(metadata: dict[str, Any] | None) -> dict[str, str]:
    custom = (metadata or {}).get("custom_data")
    return (
        {str(key): str(value) for key, value in custom.items()} if isinstance(custom, dict) else {}
    )
