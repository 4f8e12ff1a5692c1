"""The files of one bag while it is recorded: one after the other, each closed in order."""

import contextlib
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding

from skinplan.errors import BagNotWritableError, DiskFullError
from skinplan.recording.chunk import SealedChunk
from skinplan.recording.disk import require_space, sync_folder, write_error
from skinplan.recording.mcap_output import McapOutput, encoded
from skinplan.recording.metadata import (
    RECORD_NAME,
    FileFigures,
    metadata_document,
    metadata_text,
    write_metadata,
)
from skinplan.recording.model import BagTopic
from skinplan.recording.qos import QosProfile, qos_text


@dataclass
class RecordedTopic:
    """One topic of a bag that is recorded.

    Attributes:
        id: Number of its channel, the same in all files.
        topic: What is known about it.
        messages: Messages taken so far.
        lost: Of those that the disk did not take.
        last: Sequence, publish time [ns] and data of the last message, of a latched topic.
        latched: A publisher's last message is for late subscribers, too.
    """

    id: int
    topic: BagTopic
    messages: int = 0
    lost: int = 0
    last: tuple[int, int, bytes] | None = None

    def __post_init__(self) -> None:
        self.offer(self.topic.qos)

    def offer(self, qos: tuple[QosProfile, ...]) -> None:
        """Takes what the publishers offer by now.

        The recorded QoS stay those of the beginning, as rosbag2 has it: readers give a message to
        the topic of the metadata that has the QoS of the message's channel, or to none.
        """
        self.latched = any(profile.latched for profile in qos)


@dataclass
class BagFiles:
    """Writes the files.

    Attributes:
        folder: Bag folder.
        custom_data: Facts about the run; may be added to until the end.
        ros_distro: Distribution whose types are recorded.
        least_free_bytes: So much stays free on the disk [B].
        topics: Topics by name.
        done: Files that are closed.
        bytes_done: Their size [B].
    """

    folder: Path
    custom_data: dict[str, str]
    ros_distro: str
    least_free_bytes: int = 0
    topics: dict[str, RecordedTopic] = field(default_factory=dict)
    done: list[FileFigures] = field(default_factory=list)
    bytes_done: int = 0

    def __post_init__(self) -> None:
        self._schemas: dict[tuple[str, str], int] = {}
        self._complete = True

    @property
    def current(self) -> McapOutput:
        """The file that is written."""
        return self._file

    @property
    def content_bytes(self) -> int:
        """What was written to the current file behind its descriptions [B]."""
        return self._file.size_bytes - self._head_bytes

    def begin(self) -> None:
        """Makes the folder and the first file, or leaves nothing behind.

        Raises:
            BagNotWritableError: The folder is not empty, or the disk does not take it.
        """
        created = _create_folder(self.folder)
        try:
            self.open_next()
        except BaseException:
            # A folder without a bag would be taken for a bag that was lost.
            if not self._complete:
                self._file.close()
                self._file.path.unlink(missing_ok=True)
            if created:
                with contextlib.suppress(OSError):
                    self.folder.rmdir()
            raise

    def open_next(self) -> None:
        """Begins a file, with all topics known so far.

        Raises:
            BagNotWritableError: The disk does not take it.
        """
        path = self.folder / f"{self.folder.name}_{len(self.done)}.mcap"
        try:
            require_space(self.folder, 0, self.least_free_bytes)
            self._file = _created(path)
            self._complete = False
            sync_folder(self.folder)
            self._add_record(self._document())
            for known in self.topics.values():
                self._describe(known)
            self._head_bytes = self._file.size_bytes
        except OSError as error:
            raise write_error(path, error) from error

    def add_topic(self, topic: BagTopic) -> None:
        """Writes a topic's channel.

        Raises:
            BagNotWritableError: The disk does not take it.
        """
        known = RecordedTopic(len(self.topics) + 1, topic)
        try:
            self._describe(known)
        except OSError as error:
            raise write_error(self._file.path, error) from error
        self.topics[topic.name] = known

    def add_chunk(self, chunk: SealedChunk) -> None:
        """Writes a chunk; after an error its messages count as lost.

        Raises:
            BagNotWritableError: The disk does not take it, or would have too little left.
        """
        try:
            require_space(self.folder, chunk.size_bytes, self.least_free_bytes)
            self._file.add_chunk(chunk)
        except (OSError, BagNotWritableError) as error:
            self._lose(chunk.counts)
            if isinstance(error, OSError):
                raise write_error(self._file.path, error) from error
            raise

    def end_file(self) -> None:
        """Closes the file in order; on a full disk the last chunks make room for the index.

        Raises:
            BagNotWritableError: The disk does not take it all the same.
        """
        self._end(last=False)

    def end(self) -> None:
        """Closes the last file, and writes ``metadata.yaml``.

        Raises:
            BagNotWritableError: The disk does not take it.
        """
        self._end(last=True)

    def _end(self, last: bool) -> None:
        while True:
            try:
                self._try_end(last)
                break
            except OSError as error:
                failure = write_error(self._file.path, error)
                if not isinstance(failure, DiskFullError) or not self._make_room():
                    raise failure from error
        self._file.close()

    def _make_room(self) -> bool:
        """Gives up the last chunk, or a last file that holds nothing; False = nothing is left."""
        lost = None if self._complete else self._file.drop_last_chunk()
        if lost is not None:
            self._lose(lost)
            return True
        if self._complete or not self.done:
            return False
        self._file.close()
        self._file.path.unlink()
        self._complete = True
        return True

    def _try_end(self, last: bool) -> None:
        document = self._document()
        if last:
            # First, since it can't be taken back: the file's own end is, by cutting it off.
            write_metadata(self.folder, document)
        if self._complete:
            return
        figures = self._figures()
        self._add_record(document)
        self._file.end()
        self.done.append(figures)
        self.bytes_done += self._file.size_bytes
        self._complete = True
        if last:
            sync_folder(self.folder)

    def description(self, known: RecordedTopic) -> bytes:
        """Returns the records that describe a topic."""
        return b"".join(encoded(record) for record in self._records(known))

    def _describe(self, known: RecordedTopic) -> None:
        schema, channel = self._records(known)
        self._file.add_schema(schema)
        self._file.add_channel(channel)

    def _records(self, known: RecordedTopic) -> tuple[Schema, Channel]:
        topic = known.topic
        key = (topic.type_name, topic.schema_text)
        number = self._schemas.setdefault(key, len(self._schemas) + 1)
        facts = {"offered_qos_profiles": qos_text(topic.qos), "topic_type_hash": topic.type_hash}
        schema = Schema(
            id=number,
            name=topic.type_name,
            encoding=str(SchemaEncoding.ROS2),
            data=topic.schema_text.encode(),
        )
        channel = Channel(
            id=known.id,
            schema_id=number,
            topic=topic.name,
            message_encoding=str(MessageEncoding.CDR),
            metadata=facts,
        )
        return schema, channel

    def _add_record(self, document: Mapping[str, object]) -> None:
        self._file.add_metadata(RECORD_NAME, {"serialized_metadata": metadata_text(document)})

    def _figures(self) -> FileFigures:
        file = self._file
        return FileFigures(file.path.name, sum(file.counts.values()), file.start_ns, file.end_ns)

    def _document(self) -> dict[str, object]:
        files = [*self.done] if self._complete else [*self.done, self._figures()]
        topics = [
            replace(known.topic, messages=known.messages - known.lost)
            for known in self.topics.values()
        ]
        return metadata_document(files, topics, self.custom_data, self.ros_distro)

    def _lose(self, counts: Mapping[int, int]) -> None:
        for known in self.topics.values():
            known.lost += counts.get(known.id, 0)


def _create_folder(folder: Path) -> bool:
    """Makes the folder of a new bag.

    Returns:
        False when it was there, and empty.

    Raises:
        BagNotWritableError: It is not empty, or can't be created.
    """
    created = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        found = sorted(os.listdir(folder))
    except OSError as error:
        raise BagNotWritableError(
            f"a bag in {folder} was asked for, but it can't be created ({error.strerror or error})"
        ) from error
    if found:
        raise BagNotWritableError(
            f"a bag in {folder} was asked for, but the folder is not empty; a new or empty "
            "folder is accepted"
        )
    return created


def names(topics: Iterable[RecordedTopic]) -> str:
    """Returns the topics' names for a message."""
    return ", ".join(known.topic.name for known in topics) or "none"


def _created(path: Path) -> McapOutput:
    try:
        return McapOutput(path)
    except OSError as error:
        if not isinstance(error, FileExistsError):
            # Not even its head fits: a file of no use.
            path.unlink(missing_ok=True)
        raise
