"""Where in an MCAP file its messages are: from its summary, or by reading it through."""

import struct
import zlib
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Metadata, Schema, Statistics

from skinplan.errors import BagInvalidError
from skinplan.recording.storage import DAMAGE, decompressed, naming_damage

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
#: Channel, log time and publish time of a message record.
MESSAGE = struct.Struct("<H4xQQ")
_CHUNK = struct.Struct("<QQQII")
_FOOTER = struct.Struct("<QQI")
_FOOTER_BYTES = HEAD.size + _FOOTER.size + len(MAGIC)
_LARGEST_SUMMARY = 2**28
_LARGEST_RECORD = 2**30
# Messages outside of chunks are read in blocks of about this size [B].
_RAW_BLOCK = 2**22


@dataclass(frozen=True)
class Block:
    """A piece of the file that is read at once: a chunk, or a row of records outside of chunks.

    Attributes:
        offset: Of its first record [B].
        length: With the heads of its records [B].
        start_ns: Log time of its first message [ns].
        end_ns: Log time of its last message [ns].
        channels: Numbers of the channels that have messages in it; None = not known.
        is_chunk: It is one chunk record.
    """

    offset: int
    length: int
    start_ns: int
    end_ns: int
    channels: frozenset[int] | None
    is_chunk: bool


@dataclass
class McapMap:
    """What is where in one file.

    Attributes:
        path: The file.
        blocks: By log time of their first message, equal ones as in the file.
        channels: Channels by number.
        schemas: Schemas by number.
        counts: Messages by channel number.
        start_ns: Log time of the first message [ns]; 0 without messages.
        end_ns: Log time of the last message [ns]; 0 without messages.
        metadata: Text of the newest rosbag2 metadata; empty = none.
        complete: Closed in order.
    """

    path: Path
    blocks: list[Block] = field(default_factory=list)
    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    start_ns: int = 0
    end_ns: int = 0
    metadata: str = ""
    complete: bool = True


def read_map(path: Path, stream: BinaryIO) -> McapMap:
    """Finds out what is where in a file.

    Args:
        path: Its name, for errors.
        stream: The file.

    Raises:
        BagInvalidError: No MCAP file, or nothing in it is readable.
    """
    with naming_damage(path):
        stream.seek(0)
        if stream.read(len(MAGIC)) != MAGIC:
            raise BagInvalidError(f"{path}: an MCAP file is accepted, but its first bytes differ")
        summary = _summary_bytes(stream)
        found = None if summary is None else _from_summary(path, stream, summary)
        if found is None:
            found = _Scan(path, stream).run(complete=summary is not None)
    found.blocks.sort(key=lambda block: (block.start_ns, block.offset))
    return found


def chunk_data(body: memoryview) -> bytes | memoryview:
    """Returns the records inside a chunk record.

    Args:
        body: The record without its head.

    Raises:
        ValueError: It is damaged.
    """
    _, _, size, checksum, named = _CHUNK.unpack_from(body)
    begin = _CHUNK.size + named
    compression = bytes(body[_CHUNK.size : begin]).decode()
    (length,) = struct.unpack_from("<Q", body, begin)
    packed = body[begin + 8 : begin + 8 + length]
    if len(packed) != length:
        raise ValueError(f"a chunk of {length} bytes was announced, found {len(packed)}")
    records = decompressed(compression, packed, size)
    if checksum and zlib.crc32(records) != checksum:
        raise ValueError("the checksum of a chunk differs")
    return records


def _summary_bytes(stream: BinaryIO) -> bytes | None:
    """Returns the summary section; None when the file was not closed or it is damaged."""
    size = stream.seek(0, 2)
    if size < len(MAGIC) + _FOOTER_BYTES:
        return None
    stream.seek(size - _FOOTER_BYTES)
    end = stream.read(_FOOTER_BYTES)
    if end[-len(MAGIC) :] != MAGIC or end[0] != Opcode.FOOTER:
        return None
    start, _, checksum = _FOOTER.unpack_from(end, HEAD.size)
    length = size - _FOOTER_BYTES - start
    if start == 0 or not 0 <= length <= _LARGEST_SUMMARY:
        return b"" if start == 0 else None
    stream.seek(start)
    found = stream.read(length)
    if checksum and zlib.crc32(found + end[: HEAD.size + 16]) != checksum:
        return None
    return found


def _from_summary(path: Path, stream: BinaryIO, summary: bytes) -> McapMap | None:
    """Reads the map from the summary; None when that does not say where the messages are."""
    found, statistics = McapMap(path), None
    size = stream.seek(0, 2)
    places: list[int] = []
    for opcode, begin, end in records_in(summary):
        data = ReadDataStream(BytesIO(summary[begin:end]))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(data)
            found.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(data)
            found.channels[channel.id] = channel
        elif opcode == Opcode.STATISTICS:
            statistics = Statistics.read(data)
        elif opcode == Opcode.CHUNK_INDEX:
            found.blocks.append(_indexed_block(ChunkIndex.read(data), size))
        elif opcode == Opcode.METADATA_INDEX:
            places.append(struct.unpack_from("<Q", summary, begin)[0])
    if statistics is None or not set(statistics.channel_message_counts) <= set(found.channels):
        return None
    listed = len(found.blocks)
    if statistics.message_count and (listed == 0 or listed != statistics.chunk_count):
        return None
    found.counts = dict(statistics.channel_message_counts)
    found.start_ns, found.end_ns = statistics.message_start_time, statistics.message_end_time
    for place in places:
        found.metadata = _metadata_at(stream, place, size) or found.metadata
    return found


def _indexed_block(index: ChunkIndex, size: int) -> Block:
    if index.chunk_start_offset + index.chunk_length > size:
        raise ValueError("a chunk lies behind the end of the file")
    channels = frozenset(index.message_index_offsets) or None
    return Block(
        index.chunk_start_offset,
        index.chunk_length,
        index.message_start_time,
        index.message_end_time,
        channels,
        True,
    )


def _metadata_at(stream: BinaryIO, place: int, size: int) -> str:
    if place + HEAD.size > size:
        raise ValueError("a metadata record lies behind the end of the file")
    stream.seek(place)
    opcode, length = HEAD.unpack(stream.read(HEAD.size))
    if opcode != Opcode.METADATA or length > _LARGEST_SUMMARY or place + length > size:
        raise ValueError("the index of the metadata records is wrong")
    return rosbag2_text(stream.read(length))


def rosbag2_text(body: bytes) -> str:
    """Returns the text of a rosbag2 metadata record; empty for others."""
    record = Metadata.read(ReadDataStream(BytesIO(body)))
    return record.metadata.get("serialized_metadata", "") if record.name == "rosbag2" else ""


def records_in(data: bytes) -> list[tuple[int, int, int]]:
    """Returns opcode, begin and end of the body of each record in a piece.

    Raises:
        ValueError: The last record is cut off.
    """
    found, place, size = [], 0, len(data)
    while place < size:
        opcode, length = HEAD.unpack_from(data, place)
        begin = place + HEAD.size
        place = begin + length
        if place > size:
            raise ValueError("a record breaks off")
        found.append((opcode, begin, place))
    return found


class _Scan:
    """Reads a file through, up to its last complete record."""

    def __init__(self, path: Path, stream: BinaryIO) -> None:
        self._stream = stream
        self._map = McapMap(path)
        # The row of records outside of chunks that is being collected.
        self._begin = self._until = 0
        self._times: list[int] = []
        self._channels: set[int] = set()

    def run(self, complete: bool) -> McapMap:
        """Returns the map.

        Args:
            complete: The file was closed in order; it only has no index.

        Raises:
            BagInvalidError: Nothing is readable.
        """
        found = self._map
        found.complete = complete and self._walk()
        if not complete:
            self._walk()
        self._end_row()
        if not found.channels and not found.metadata and not found.complete:
            raise BagInvalidError(
                f"{found.path}: the file breaks off before its first complete record; nothing "
                "can be read"
            )
        return found

    def _walk(self) -> bool:
        """Takes all records in; False = it breaks off."""
        size = self._stream.seek(0, 2)
        place = len(MAGIC)
        while place + HEAD.size <= size:
            self._stream.seek(place)
            opcode, length = HEAD.unpack(self._stream.read(HEAD.size))
            end = place + HEAD.size + length
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                return True
            if opcode == 0 or end > size or length > _LARGEST_RECORD:
                return False
            try:
                self._take(opcode, place, end)
            except DAMAGE:
                return False  # what follows a damaged record can't be trusted
            place = end
        return False

    def _take(self, opcode: int, place: int, end: int) -> None:
        wanted = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA, Opcode.MESSAGE, Opcode.CHUNK)
        if opcode not in wanted:
            return
        body = self._stream.read(end - place - HEAD.size)
        if opcode == Opcode.CHUNK:
            self._take_chunk(body, place, end)
        elif opcode == Opcode.METADATA:
            self._map.metadata = rosbag2_text(body) or self._map.metadata
        elif opcode == Opcode.MESSAGE:
            self._take_row(body, place, end)
        else:
            self._describe(opcode, body)

    def _take_chunk(self, body: bytes, place: int, end: int) -> None:
        self._end_row()
        data = bytes(chunk_data(memoryview(body)))
        times, channels = [], set()
        for opcode, begin, stop in records_in(data):
            if opcode == Opcode.MESSAGE:
                channel, log_ns, _ = MESSAGE.unpack_from(data, begin)
                if channel in self._map.channels:
                    times.append(log_ns)
                    channels.add(channel)
                    self._count(channel)
            else:
                self._describe(opcode, data[begin:stop])
        self._add(place, end, times, channels, True)

    def _take_row(self, body: bytes, place: int, end: int) -> None:
        channel, log_ns, _ = MESSAGE.unpack_from(body)
        if channel not in self._map.channels:
            return
        if not self._times:
            self._begin = place
        self._times.append(log_ns)
        self._channels.add(channel)
        self._until = end
        self._count(channel)
        if end - self._begin > _RAW_BLOCK:
            self._end_row()

    def _end_row(self) -> None:
        self._add(self._begin, self._until, self._times, self._channels, False)
        self._times, self._channels = [], set()

    def _count(self, channel: int) -> None:
        self._map.counts[channel] = self._map.counts.get(channel, 0) + 1

    def _add(
        self, place: int, end: int, times: list[int], channels: set[int], is_chunk: bool
    ) -> None:
        if not times:
            return
        first, last, found = min(times), max(times), self._map
        found.start_ns = min(found.start_ns, first) if found.blocks else first
        found.end_ns = max(found.end_ns, last)
        found.blocks.append(Block(place, end - place, first, last, frozenset(channels), is_chunk))

    def _describe(self, opcode: int, body: bytes) -> None:
        data = ReadDataStream(BytesIO(body))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(data)
            self._map.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(data)
            self._map.channels[channel.id] = channel
