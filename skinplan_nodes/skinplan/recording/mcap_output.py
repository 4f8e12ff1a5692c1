"""One MCAP file being written: only whole records, and closed in order on a full disk, too."""

import os
import struct
import threading
import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from skinplan.errors import BagNotWritableError
from skinplan.recording.chunk import SealedChunk
from skinplan.recording.disk import lock_file, write_all

MAGIC = b"\x89MCAP0\r\n"
PROFILE, LIBRARY = "ros2", "skinplan"
_FOOTER = struct.Struct("<BQQQ")


@dataclass(frozen=True)
class _Placed:
    offset: int
    chunk: SealedChunk


class McapOutput:
    """Appends records to one file.

    Schemas and channels stand outside of the chunks, so that a damaged chunk takes none of them
    with it; whoever makes the chunks may put them into one of those, too, where a CRC covers them.
    The file is locked while it is written: `heal` leaves it alone.

    Args:
        path: The file; must not exist.
        profile: Profile in its header.
        library: Library in its header.

    Raises:
        OSError: It can't be created.
        BagNotWritableError: Another process holds it.
    """

    def __init__(self, path: Path, profile: str = PROFILE, library: str = LIBRARY) -> None:
        self.path = path
        self._handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        self._chunks: list[_Placed] = []
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._metadata: list[MetadataIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._end = 0
        self._closing = threading.Lock()
        try:
            if not lock_file(self._handle):
                raise BagNotWritableError(f"{path}: another process holds the file")
            self._append((MAGIC, encoded(Header(profile=profile, library=library))))
        except BaseException:
            os.close(self._handle)
            raise

    @property
    def size_bytes(self) -> int:
        """Size of the file so far [B]."""
        return self._end

    @property
    def counts(self) -> dict[int, int]:
        """Messages by channel, of the chunks so far."""
        total: dict[int, int] = {}
        for placed in self._chunks:
            for channel, count in placed.chunk.counts.items():
                total[channel] = total.get(channel, 0) + count
        return total

    @property
    def described(self) -> list[tuple[Channel, Schema | None]]:
        """Channels with their schemas."""
        return [(c, self._schemas.get(c.schema_id)) for c in self._channels.values()]

    @property
    def start_ns(self) -> int:
        """Log time of the first message [ns]; 0 without messages."""
        return min((placed.chunk.start_ns for placed in self._chunks), default=0)

    @property
    def end_ns(self) -> int:
        """Log time of the last message [ns]; 0 without messages."""
        return max((placed.chunk.end_ns for placed in self._chunks), default=0)

    def add_schema(self, schema: Schema) -> None:
        """Writes a schema, once for each id."""
        if schema.id not in self._schemas:
            self._append((encoded(schema),))
            self._schemas[schema.id] = schema

    def add_channel(self, channel: Channel) -> None:
        """Writes a channel, once for each id."""
        if channel.id not in self._channels:
            self._append((encoded(channel),))
            self._channels[channel.id] = channel

    def add_chunk(self, chunk: SealedChunk) -> None:
        """Writes a chunk with its index."""
        offset = self._end
        self._append(chunk.parts)
        self._chunks.append(_Placed(offset, replace(chunk, parts=())))

    def copy_chunk(self, chunk: SealedChunk, stored: Iterable[bytes]) -> None:
        """Writes a chunk whose stored records come in pieces.

        Args:
            chunk: `parts` are what stands before the stored records, and the index.
            stored: The pieces.
        """
        offset = self._end
        head, index = chunk.parts
        try:
            write_all(self._handle, (head,))
            for piece in stored:
                write_all(self._handle, (piece,))
            write_all(self._handle, (index,))
        except OSError:
            self._cut(offset)
            raise
        self._end = offset + chunk.size_bytes
        self._chunks.append(_Placed(offset, replace(chunk, parts=())))

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Writes a metadata record."""
        record = encoded(Metadata(name=name, metadata=dict(values)))
        offset = self._end
        self._append((record,))
        self._metadata.append(MetadataIndex(offset=offset, length=len(record), name=name))

    def add_attachment(self, index: AttachmentIndex, record: bytes) -> None:
        """Writes an attachment record as it is; ``index`` gets its place."""
        placed = replace(index, offset=self._end, length=len(record))
        self._append((record,))
        self._attachments.append(placed)

    def drop_last_chunk(self) -> dict[int, int] | None:
        """Cuts off the last chunk and all behind it, which makes room on a full disk.

        Returns:
            Messages lost with it by channel; None when there is no chunk any more.
        """
        if not self._chunks:
            return None
        placed = self._chunks.pop()
        self._cut(placed.offset)
        self._metadata = [index for index in self._metadata if index.offset < placed.offset]
        self._attachments = [index for index in self._attachments if index.offset < placed.offset]
        return placed.chunk.counts

    def sync(self) -> None:
        """Brings all that was written to the disk."""
        # Not while it is closed: the handle's number could be another file's by then.
        with self._closing:
            if self._handle >= 0:
                os.fdatasync(self._handle)

    def end(self) -> None:
        """Writes the index and the end of the file; it can't be added to any more.

        After an error the file ends with its last whole record, and this may be called again.

        Raises:
            OSError: The disk does not take it.
        """
        data_end = encoded(DataEnd(0))
        summary, offsets = self._summary(self._end + len(data_end))
        before = self._end
        try:
            self._append((data_end, summary + offsets[0], offsets[1], MAGIC))
            os.fsync(self._handle)
        except OSError:
            self._cut(before)
            raise

    def close(self) -> None:
        """Lets go of the file, ended or not; a second call does nothing."""
        with self._closing:
            if self._handle >= 0:
                os.close(self._handle)
                self._handle = -1

    def _append(self, parts: tuple[bytes, ...]) -> None:
        try:
            write_all(self._handle, parts)
        except OSError:
            self._cut(self._end)
            raise
        self._end += sum(len(part) for part in parts)

    def _cut(self, end: int) -> None:
        os.ftruncate(self._handle, end)
        os.lseek(self._handle, end, os.SEEK_SET)
        self._end = end

    def _summary(self, start: int) -> tuple[bytes, tuple[bytes, bytes]]:
        groups: list[tuple[int, list[McapRecord]]] = [
            (Opcode.SCHEMA, list(self._schemas.values())),
            (Opcode.CHANNEL, list(self._channels.values())),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, [_chunk_index(placed) for placed in self._chunks]),
            (Opcode.ATTACHMENT_INDEX, list(self._attachments)),
            (Opcode.METADATA_INDEX, list(self._metadata)),
        ]
        summary, offsets = bytearray(), bytearray()
        for opcode, records in groups:
            begin = len(summary)
            for record in records:
                summary += encoded(record)
            if records:
                offsets += encoded(_offset(opcode, start + begin, len(summary) - begin))
        offsets_start = start + len(summary)
        head = _FOOTER.pack(Opcode.FOOTER, 20, start, offsets_start)
        crc = zlib.crc32(head, zlib.crc32(bytes(summary + offsets)))
        footer = encoded(
            Footer(summary_start=start, summary_offset_start=offsets_start, summary_crc=crc)
        )
        return bytes(summary), (bytes(offsets), footer)

    def _statistics(self) -> Statistics:
        counts = self.counts
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=counts,
            chunk_count=len(self._chunks),
            message_count=sum(counts.values()),
            message_end_time=self.end_ns,
            message_start_time=self.start_ns,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )


def _chunk_index(placed: _Placed) -> ChunkIndex:
    chunk = placed.chunk
    return ChunkIndex(
        chunk_length=chunk.chunk_bytes,
        chunk_start_offset=placed.offset,
        compression=chunk.compression,
        compressed_size=chunk.compressed_bytes,
        message_end_time=chunk.end_ns,
        message_index_length=chunk.index_bytes,
        message_index_offsets={
            channel: placed.offset + offset for channel, offset in chunk.index_offsets.items()
        },
        message_start_time=chunk.start_ns,
        uncompressed_size=chunk.raw_bytes,
    )


def _offset(opcode: int, start: int, length: int) -> SummaryOffset:
    return SummaryOffset(group_opcode=opcode, group_start=start, group_length=length)


def encoded(record: McapRecord) -> bytes:
    """Returns the bytes of a record."""
    builder = RecordBuilder()
    write: Callable[[RecordBuilder], None] = record.write
    write(builder)
    return bytes(builder.end())
