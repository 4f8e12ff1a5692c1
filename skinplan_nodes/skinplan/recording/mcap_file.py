"""Reads one MCAP file.

By its index when it was closed in order, else chunk by chunk up to the last complete one.
"""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, Message, Metadata, Schema
from mcap.stream_reader import breakup_chunk
from zstandard import ZstdError

from skinplan.errors import BagInvalidError

MAGIC = b"\x89MCAP0\r\n"
# Larger chunks than this are no recording, but a damaged length or a decompression bomb.
_LARGEST_CHUNK = 2**30
# Whatever the parsers of damaged bytes raise.
_DAMAGE = (
    McapError,
    ZstdError,
    struct.error,
    ValueError,
    LookupError,
    EOFError,
    OverflowError,
    RuntimeError,
    OSError,
)
Result = TypeVar("Result")


@dataclass
class FileIndex:
    """What is in one MCAP file.

    Attributes:
        path: The file.
        channels: Channels by number.
        schemas: Schemas by number.
        counts: Messages by channel number.
        start_ns: Log time of the first message [ns]; 0 without messages.
        end_ns: Log time of the last message [ns]; 0 without messages.
        metadata: The newest ``rosbag2`` record; empty = none.
        complete: Closed in order.
    """

    path: Path
    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    start_ns: int = 0
    end_ns: int = 0
    metadata: dict[str, str] = field(default_factory=dict)
    complete: bool = True

    @property
    def messages(self) -> int:
        """Number of messages."""
        return sum(self.counts.values())

    def count(self, message: Message) -> None:
        """Takes one more message into the figures."""
        self.start_ns = min(self.start_ns, message.log_time) if self.counts else message.log_time
        self.end_ns = max(self.end_ns, message.log_time)
        self.counts[message.channel_id] = self.counts.get(message.channel_id, 0) + 1


def read_index(path: Path) -> FileIndex:
    """Reads what is in a file, from its index or, where it has none, from its chunks.

    Raises:
        BagInvalidError: No MCAP file, or nothing in it is readable.
    """
    with _open(path) as stream:
        if not _closed(stream):
            return _scan(path, stream)
        index = _guarded(path, lambda: _summary(path, stream))
        return index if index is not None else _scan(path, stream)


def iterate(
    index: FileIndex, start_ns: int | None, end_ns: int | None
) -> Iterator[tuple[Channel, Message]]:
    """Iterates over the messages of a file, by log time (an unfinished file.

    By log time within each chunk).

    Args:
        index: From `read_index`.
        start_ns: Messages before this log time are left out [ns]; None = all.
        end_ns: Messages from this log time on are left out [ns]; None = all.

    Yields:
        Channel and message.

    Raises:
        BagInvalidError: The file is damaged.
    """
    with _open(index.path) as stream:
        source = _indexed(stream, start_ns, end_ns) if index.complete else _scanned(index, stream)
        while True:
            found = _guarded(index.path, lambda: next(source, None))
            if found is None:
                return
            channel, message = found
            after = start_ns is None or message.log_time >= start_ns
            if after and (end_ns is None or message.log_time < end_ns):
                yield channel, message


def _open(path: Path) -> BinaryIO:
    try:
        stream = path.open("rb")
    except OSError as error:
        raise BagInvalidError(f"{path}: a readable file is accepted ({error.strerror})") from error
    if stream.read(len(MAGIC)) != MAGIC:
        stream.close()
        raise BagInvalidError(f"{path}: an MCAP file is accepted, but its first bytes are others")
    return stream


def _closed(stream: BinaryIO) -> bool:
    size = stream.seek(0, 2)
    stream.seek(max(0, size - len(MAGIC)))
    return size > 2 * len(MAGIC) and stream.read(len(MAGIC)) == MAGIC


def _guarded(path: Path, work: Callable[[], Result]) -> Result:
    try:
        return work()
    except (*_DAMAGE, MemoryError) as error:
        raise BagInvalidError(
            f"{path}: the file is damaged ({type(error).__name__}: {error})"
        ) from error


def _reader(stream: BinaryIO) -> SeekingReader:
    size = stream.seek(0, 2)
    stream.seek(0)
    return SeekingReader(stream, validate_crcs=True, record_size_limit=size)


def _summary(path: Path, stream: BinaryIO) -> FileIndex | None:
    reader = _reader(stream)
    reader.get_header()
    summary = reader.get_summary()
    if summary is None or summary.statistics is None:
        return None
    for chunk in summary.chunk_indexes:
        if chunk.uncompressed_size > _LARGEST_CHUNK:
            raise ValueError(f"a chunk of {chunk.uncompressed_size} bytes")
    statistics = summary.statistics
    index = FileIndex(path, dict(summary.channels), dict(summary.schemas))
    index.counts = dict(statistics.channel_message_counts)
    index.start_ns, index.end_ns = statistics.message_start_time, statistics.message_end_time
    for record in reader.iter_metadata():
        if record.name == "rosbag2":
            index.metadata = dict(record.metadata)
    unknown = [i for i in index.counts if i not in index.channels]
    if unknown:
        raise ValueError(f"messages on channels {unknown} that are not described")
    return index


def _scan(path: Path, stream: BinaryIO) -> FileIndex:
    index = FileIndex(path, complete=False)
    for _, message in _scanned(index, stream):
        index.count(message)
    if not index.channels and not index.metadata:
        raise BagInvalidError(
            f"{path}: the file breaks off before its first complete record; nothing can be read"
        )
    return index


def _indexed(
    stream: BinaryIO, start_ns: int | None, end_ns: int | None
) -> Iterator[tuple[Channel, Message]]:
    messages = _reader(stream).iter_messages(starting_at=start_ns, ending_before=end_ns)
    return ((channel, message) for _, channel, message in messages)


def _scanned(index: FileIndex, stream: BinaryIO) -> Iterator[tuple[Channel, Message]]:
    for opcode, body in _records(stream):
        try:
            messages = _take(index, opcode, body)
        except _DAMAGE:
            return  # what follows a damaged record can't be trusted
        for message in messages:
            yield index.channels[message.channel_id], message


def _take(index: FileIndex, opcode: int, body: bytes) -> list[Message]:
    data = ReadDataStream(BytesIO(body))
    if opcode == Opcode.SCHEMA:
        schema = Schema.read(data)
        index.schemas[schema.id] = schema
    elif opcode == Opcode.CHANNEL:
        channel = Channel.read(data)
        index.channels[channel.id] = channel
    elif opcode == Opcode.METADATA:
        record = Metadata.read(data)
        if record.name == "rosbag2":
            index.metadata = record.metadata
    elif opcode == Opcode.MESSAGE:
        message = Message.read(data, len(body))
        return [message] if message.channel_id in index.channels else []
    elif opcode == Opcode.CHUNK:
        return _chunk_messages(index, Chunk.read(data))
    return []


def _chunk_messages(index: FileIndex, chunk: Chunk) -> list[Message]:
    if chunk.uncompressed_size > _LARGEST_CHUNK:
        raise ValueError(f"a chunk of {chunk.uncompressed_size} bytes")
    messages = []
    for record in breakup_chunk(chunk, validate_crc=True):
        if isinstance(record, Schema):
            index.schemas[record.id] = record
        elif isinstance(record, Channel):
            index.channels[record.id] = record
        elif isinstance(record, Message) and record.channel_id in index.channels:
            messages.append(record)
    return sorted(messages, key=lambda message: message.log_time)


def _records(stream: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Iterates over the complete records of the data section.

    Stops at the first that is cut off.
    """
    size = stream.seek(0, 2)
    position = len(MAGIC)
    while position + 9 <= size:
        stream.seek(position)
        opcode, length = struct.unpack("<BQ", stream.read(9))
        position += 9 + length
        if position > size or opcode in (0, Opcode.DATA_END, Opcode.FOOTER):
            return
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA, Opcode.MESSAGE, Opcode.CHUNK):
            yield opcode, stream.read(length)
