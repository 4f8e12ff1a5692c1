"""Heals one MCAP file: what is intact in it goes to a new file with an index."""

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from io import BytesIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Channel, Header, Metadata, Schema

from skinplan.errors import BagInvalidError
from skinplan.recording.chunk import (
    ChunkBuilder,
    MessageIndex,
    chunk_head,
    compressor,
    sealed,
)
from skinplan.recording.mcap_output import McapOutput
from skinplan.recording.qos import qos_profiles
from skinplan.recording.salvage import (
    DAMAGE,
    LARGEST_DESCRIPTION,
    MAGIC,
    ChunkHead,
    Found,
    Source,
    attachment,
    body,
    raw_records,
    walk,
)
from skinplan.recording.salvage import chunk_head as read_chunk_head

_QOS = "offered_qos_profiles"
_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_CHUNK_BYTES = 2**20
# Records that are made anew: nothing is lost with them.
_REBUILT = (
    Opcode.HEADER,
    Opcode.MESSAGE_INDEX,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
    Opcode.STATISTICS,
    Opcode.SUMMARY_OFFSET,
    Opcode.DATA_END,
    Opcode.FOOTER,
)
# A message of a cut chunk is held in memory as a whole.
_LARGEST_MESSAGE = 2**28


@dataclass
class Salvaged:
    """What came out of one file.

    Attributes:
        bytes_lost: Bytes of records that could not be used [B].
        damaged: Places in the middle of the file: begin and size [B].
        messages_undescribed: Messages whose channel is described nowhere any more.
        metadata: The newest ``rosbag2`` record.
    """

    bytes_lost: int = 0
    damaged: list[tuple[int, int]] = field(default_factory=list)
    messages_undescribed: int = 0
    metadata: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class _Record:
    """A record inside of a chunk; ``data`` is empty where only the place counts."""

    opcode: int
    place: int
    length: int
    data: bytes


class Salvage:
    """Copies what is intact from one file to another.

    Args:
        source: The damaged file.
        output: The new one.
    """

    def __init__(self, source: Source, output: McapOutput) -> None:
        self._source = source
        self._output = output
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._waiting: list[Found] = []
        self._loose = ChunkBuilder()
        self._undecodable = 0
        # A file that was closed: what is missing at its end was damaged, not cut off.
        end = max(len(MAGIC), source.size - len(MAGIC))
        self._closed = source.read(end, len(MAGIC)) == MAGIC
        # Writers put messages into chunks or beside none; only chunks have a CRC.
        self._chunked = any(found.opcode == Opcode.CHUNK for found in walk(source))
        self.result = Salvaged()

    def run(self) -> Salvaged:
        """Copies everything; the caller ends the new file.

        Raises:
            OSError: The disk does not take it.
        """
        for found in walk(self._source):
            self._take(found)
        # Chunks whose channels were described only behind them, as in an index.
        for found in self._waiting:
            if found.opcode == Opcode.CHUNK and self._copy_chunk(found):
                continue
            self._rescue(found)
        self._seal()
        for channel in self._channels.values():
            # Topics without messages.
            self._describe(channel.id)
        return self.result

    def _take(self, found: Found) -> None:
        if found.opcode == Opcode.CHUNK:
            if not self._copy_chunk(found):
                self._waiting.append(found)
        elif found.opcode == Opcode.MESSAGE and not found.cut and not self._chunked:
            self._add_loose(body(self._source, found), found)
        elif found.opcode in (0, Opcode.MESSAGE) or found.cut:
            if found.opcode not in _REBUILT:
                self.result.bytes_lost += found.size
            if self._closed or (not found.cut and found.place + found.size < self._source.size):
                self.result.damaged.append((found.place, found.size))
        elif found.opcode == Opcode.ATTACHMENT:
            self._copy_attachment(found)
        elif found.opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA):
            self._learn(found.opcode, body(self._source, found))

    def _learn(self, opcode: int, data: bytes, covered: bool = False) -> None:
        """Takes a description; one that a chunk's CRC covers is believed before others."""
        stream = ReadDataStream(BytesIO(data))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            if covered or schema.id not in self._schemas:
                self._schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = _believable(Channel.read(stream))
            if covered or channel.id not in self._channels:
                self._channels[channel.id] = channel
        else:
            record = Metadata.read(stream)
            if record.name == "rosbag2":
                self.result.metadata = dict(record.metadata)
            else:
                self._output.add_metadata(record.name, record.metadata)

    def _copy_chunk(self, found: Found) -> bool:
        """Copies a chunk as it is; False = its messages are to be taken one by one, or later."""
        if found.cut or found.unfinished:
            return False
        head = read_chunk_head(self._source, found.place)
        if head is None:
            return False
        index = MessageIndex()
        damaged, end = self._undecodable, 0
        for record in self._records(head, with_data=False):
            end = record.place + record.length
            if record.opcode == Opcode.MESSAGE:
                channel, _, log_time_ns, _ = _MESSAGE.unpack_from(record.data)
                index.add(channel, log_time_ns, record.place)
        counts = index.counts
        if not counts:
            return True
        if self._undecodable > damaged or (head.crc == 0 and end != head.raw_bytes):
            # As it is it would stop every reader: its messages are taken one by one.
            return False
        if not all(self._describe(channel) for channel in counts):
            return False
        start = chunk_head(
            index.start_ns,
            index.end_ns,
            head.raw_bytes,
            head.crc,
            head.compression,
            head.stored_bytes,
        )
        chunk = sealed(start, (), index, head.compression, head.stored_bytes, head.raw_bytes)
        self._output.copy_chunk(chunk, self._source.blocks(head.place, head.stored_bytes))
        return True

    def _rescue(self, found: Found) -> None:
        """Takes the messages of a chunk one by one, as far as it goes."""
        head = read_chunk_head(self._source, found.place)
        used = 0
        if head is not None:
            for record in self._records(head, with_data=True):
                if record.opcode == Opcode.MESSAGE:
                    self._add_loose(record.data, found)
                used = record.place + record.length
        if head is None or not used:
            self.result.bytes_lost += found.size
        elif found.cut:
            # Of what is there; what the process had not written yet nobody knows.
            there = self._source.size - head.place
            kept = used if head.compression == "" else there
            self.result.bytes_lost += max(0, there - kept)

    def _records(self, head: ChunkHead, with_data: bool) -> Iterator[_Record]:
        """Iterates over the records of a chunk, and learns what they describe."""
        for record in _parsed(raw_records(self._source, head), with_data):
            if record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                try:
                    self._learn(record.opcode, record.data, covered=head.crc != 0)
                except DAMAGE:
                    # A chunk without a CRC: nothing else tells that it is damaged.
                    self._undecodable += 1
            yield record

    def _add_loose(self, data: bytes, found: Found) -> None:
        channel, sequence, log_time_ns, publish_time_ns = _MESSAGE.unpack_from(data)
        if not self._describe(channel):
            self.result.messages_undescribed += 1
            if found.opcode == Opcode.MESSAGE:
                self.result.bytes_lost += found.size
                self.result.damaged.append((found.place, found.size))
            return
        self._loose.add(channel, sequence, log_time_ns, publish_time_ns, data[_MESSAGE.size :])
        if self._loose.size >= _CHUNK_BYTES:
            self._seal()

    def _seal(self) -> None:
        if self._loose.size:
            name, compress = compressor("zstd")
            chunk, self._loose = self._loose, ChunkBuilder()
            self._output.add_chunk(chunk.seal(name, compress))

    def _describe(self, number: int) -> bool:
        """Writes a channel and its schema, once; False when one of them is not known."""
        channel = self._channels.get(number)
        if channel is None:
            return False
        if channel.schema_id:
            schema = self._schemas.get(channel.schema_id)
            if schema is None:
                return False
            self._output.add_schema(schema)
        self._output.add_channel(channel)
        return True

    def _copy_attachment(self, found: Found) -> None:
        read = attachment(self._source, found)
        index = AttachmentIndex(
            offset=0,
            length=found.size,
            create_time=read.create_time,
            log_time=read.log_time,
            data_size=len(read.data),
            name=read.name,
            media_type=read.media_type,
        )
        self._output.add_attachment(index, self._source.read(found.place, found.size))


def read_header(source: Source) -> Header:
    """Returns the header of a file; of a file that is cut off within it, one of ours."""
    for found in walk(source):
        if found.opcode == Opcode.HEADER and not found.cut:
            return Header.read(ReadDataStream(BytesIO(body(source, found))))
        break
    return Header(profile="ros2", library="skinplan")


def _believable(channel: Channel) -> Channel:
    """Takes QoS that nobody could read off a channel: no CRC covers it outside of a chunk."""
    try:
        qos_profiles(channel.metadata.get(_QOS, ""))
    except BagInvalidError:
        return replace(channel, metadata={**channel.metadata, _QOS: ""})
    return channel


def _parsed(pieces: Iterator[bytes], with_data: bool) -> Iterator[_Record]:
    """Cuts the records of a chunk out of its pieces; ends at the first that is not whole."""
    cutter, place = _Cutter(pieces), 0
    while True:
        head = cutter.take(_RECORD.size)
        if head is None:
            return
        opcode, length = _RECORD.unpack(head)
        if opcode == Opcode.MESSAGE:
            wanted = length if with_data else _MESSAGE.size
            good = _MESSAGE.size <= length and wanted <= _LARGEST_MESSAGE
        else:
            wanted = length
            good = opcode in (Opcode.SCHEMA, Opcode.CHANNEL) and length <= LARGEST_DESCRIPTION
        data = cutter.take(wanted) if good else None
        if data is None or not cutter.skip(length - wanted):
            return
        yield _Record(opcode, place, _RECORD.size + length, data)
        place += _RECORD.size + length


class _Cutter:
    """Takes stretches off a stream of pieces; holds no more than one stretch and one piece."""

    def __init__(self, pieces: Iterator[bytes]) -> None:
        self._pieces = pieces
        self._buffer = bytearray()
        self._begin = 0

    def take(self, count: int) -> bytes | None:
        """Returns the next bytes; None = the stream ends before."""
        while len(self._buffer) - self._begin < count:
            if not self._fill():
                return None
        begin, self._begin = self._begin, self._begin + count
        return bytes(self._buffer[begin : self._begin])

    def skip(self, count: int) -> bool:
        """Leaves out the next bytes; False = the stream ends before."""
        while len(self._buffer) - self._begin < count:
            count -= len(self._buffer) - self._begin
            self._begin = len(self._buffer)
            if not self._fill():
                return False
        self._begin += count
        return True

    def _fill(self) -> bool:
        try:
            piece = next((piece for piece in self._pieces if piece), b"")
        except ValueError:
            # Damaged from here on: what came before is still good.
            return False
        del self._buffer[: self._begin]
        self._begin = 0
        self._buffer += piece
        return bool(piece)
