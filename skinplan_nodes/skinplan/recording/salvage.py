"""Finds what is intact in a damaged MCAP file, in bounded memory.

Every record is checked before it is believed: a chunk by its CRC, the others by their own lengths.
Behind damage the next intact chunk is searched for.
"""

import os
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from types import TracebackType
from typing import Any, BinaryIO, Self, cast

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

MAGIC = b"\x89MCAP0\r\n"
#: A description larger than this is damage.
LARGEST_DESCRIPTION = 64 * 2**20
BLOCK_BYTES = 2**20
#: What the parsers of damaged records raise.
DAMAGE = (McapError, struct.error, ValueError, LookupError, EOFError, OverflowError)
_DECODING = (zstandard.ZstdError, RuntimeError, ValueError, EOFError)
_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQI")
# A chunk whose length is below 2^40: enough for every file, rare enough by accident.
_CHUNK_PATTERN = re.compile(rb"\x06[\s\S]{5}\x00\x00\x00")
_KINDS: dict[int, Any] = {
    int(Opcode.HEADER): Header,
    int(Opcode.FOOTER): Footer,
    int(Opcode.SCHEMA): Schema,
    int(Opcode.CHANNEL): Channel,
    int(Opcode.CHUNK_INDEX): ChunkIndex,
    int(Opcode.ATTACHMENT): Attachment,
    int(Opcode.ATTACHMENT_INDEX): AttachmentIndex,
    int(Opcode.STATISTICS): Statistics,
    int(Opcode.METADATA): Metadata,
    int(Opcode.METADATA_INDEX): MetadataIndex,
    int(Opcode.SUMMARY_OFFSET): SummaryOffset,
    int(Opcode.DATA_END): DataEnd,
}
_LAST_OPCODE = int(Opcode.DATA_END)


class Source:
    """Random access to a file.

    Args:
        handle: File descriptor; stays open.
    """

    def __init__(self, handle: int) -> None:
        self._handle = handle
        self.size = os.fstat(handle).st_size

    def read(self, place: int, count: int) -> bytes:
        """Returns up to ``count`` bytes from a place."""
        parts = []
        while count > 0:
            part = os.pread(self._handle, min(count, 2**30), place)
            if not part:
                break
            parts.append(part)
            place, count = place + len(part), count - len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def blocks(self, place: int, count: int) -> Iterator[bytes]:
        """Iterates over a stretch in pieces."""
        while count > 0:
            part = self.read(place, min(count, BLOCK_BYTES))
            if not part:
                return
            yield part
            place, count = place + len(part), count - len(part)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        os.close(self._handle)


@dataclass(frozen=True)
class ChunkHead:
    """What stands before the stored records of a chunk.

    Attributes:
        start_ns: Log time of the first message [ns].
        end_ns: Log time of the last message [ns].
        raw_bytes: Size of the records [B].
        crc: Of the records; 0 = none.
        compression: MCAP's name.
        place: Of the stored records in the file [B].
        stored_bytes: Size of the stored records [B].
    """

    start_ns: int
    end_ns: int
    raw_bytes: int
    crc: int
    compression: str
    place: int
    stored_bytes: int


@dataclass(frozen=True)
class Found:
    """One stretch of a file.

    Attributes:
        place: Where it begins [B].
        size: Its size [B].
        opcode: Of an intact record; 0 = damage; of a record that the end of the file cuts off.
        cut: The end of the file cuts it off.
        mended: A damaged chunk whose CRC proves its records.
        unfinished: One of these that can't be copied: its compressed frame has no end.
    """

    place: int
    size: int
    opcode: int
    cut: bool = False
    mended: bool = False
    unfinished: bool = False


def chunk_head(source: Source, place: int) -> ChunkHead | None:
    """Reads the head of the chunk record at a place; None = there is none."""
    data = source.read(place, 64)
    if len(data) < _HEAD.size + _CHUNK.size + 4:
        return None
    opcode, length = _HEAD.unpack_from(data)
    start, end, raw, crc = _CHUNK.unpack_from(data, _HEAD.size)
    at = _HEAD.size + _CHUNK.size
    (name_size,) = struct.unpack_from("<I", data, at)
    name = data[at + 4 : at + 4 + name_size]
    at += 4 + name_size
    if name not in (b"", b"zstd", b"lz4") or len(data) < at + 8:
        return None
    (stored,) = struct.unpack_from("<Q", data, at)
    at += 8
    whole = opcode == Opcode.CHUNK and at - _HEAD.size + stored == length and start <= end
    # A damaged opcode, length or time is of no account where the CRC proves the records.
    if not whole and (crc == 0 or place + at + stored > source.size):
        return None
    return ChunkHead(start, end, raw, crc, name.decode(), place + at, stored)


class UnfinishedFrameError(ValueError):
    """All records of a chunk are there, but the mark that ends its compressed frame is not."""


def raw_records(source: Source, head: ChunkHead) -> Iterator[bytes]:
    """Iterates over the uncompressed records of a chunk in pieces.

    Raises:
        UnfinishedFrameError: All are there, but most readers will refuse the chunk.
        ValueError: They are not what the head says, or damaged.
    """
    total, crc, available = 0, 0, min(head.stored_bytes, source.size - head.place)
    ended = _Ended()
    try:
        for piece in _decoded(head, source.blocks(head.place, available), ended):
            total += len(piece)
            if total > head.raw_bytes:
                raise ValueError("more records than the chunk says")
            crc = zlib.crc32(piece, crc)
            yield piece
    except _DECODING as error:
        raise ValueError(str(error)) from error
    if total != head.raw_bytes or (head.crc and crc != head.crc):
        raise ValueError("the records are not those of the chunk's CRC")
    if not ended.well:
        raise UnfinishedFrameError("the compressed frame has no end")


@dataclass
class _Ended:
    well: bool = True


def _decoded(head: ChunkHead, blocks: Iterator[bytes], ended: _Ended) -> Iterator[bytes]:
    if head.compression == "":
        yield from blocks
    elif head.compression == "lz4":
        frame = lz4.frame.LZ4FrameDecompressor()
        for block in blocks:
            data = block
            while not frame.eof and (data or not frame.needs_input):
                yield frame.decompress(data, BLOCK_BYTES)
                data = b""
        ended.well = frame.eof
    else:
        stream = zstandard.ZstdDecompressor(max_window_size=2**27).stream_reader(
            cast(BinaryIO, _Reader(blocks)), read_across_frames=False
        )
        # What could be decoded comes out before the error about what could not.
        while piece := stream.read1(BLOCK_BYTES):
            yield piece


class _Reader:
    def __init__(self, blocks: Iterator[bytes]) -> None:
        self._blocks = blocks

    def read(self, count: int) -> bytes:
        return next(self._blocks, b"")


def walk(source: Source) -> Iterator[Found]:
    """Iterates over all stretches of a file behind its magic, intact or not, up to its end."""
    place = len(MAGIC)
    while place < source.size:
        if source.size - place == len(MAGIC) and source.read(place, len(MAGIC)) == MAGIC:
            return
        size = _intact(source, place)
        if size is not None:
            yield Found(place, size, source.read(place, 1)[0])
            place += size
            continue
        proven = _proven_chunk(source, place)
        if proven is not None:
            yield proven
            place += proven.size
            continue
        following = _next_chunk(source, place + 1)
        cut = following is None and _is_cut(source, place)
        end = source.size if following is None else following
        yield Found(place, end - place, source.read(place, 1)[0] if cut else 0, cut)
        place = end


def _intact(source: Source, place: int) -> int | None:
    """Returns the size of the record at a place; None = it is damaged or cut off."""
    head = source.read(place, _HEAD.size)
    if len(head) < _HEAD.size:
        return None
    opcode, length = _HEAD.unpack(head)
    if not 1 <= opcode <= _LAST_OPCODE or place + _HEAD.size + length > source.size:
        return None
    try:
        good = _checked(source, place, opcode, length)
    except DAMAGE:
        return None
    return _HEAD.size + length if good else None


def _checked(source: Source, place: int, opcode: int, length: int) -> bool:
    if opcode == Opcode.CHUNK:
        found = chunk_head(source, place)
        if found is None or found.start_ns > found.end_ns:
            return False
        whole = found.place + found.stored_bytes == place + _HEAD.size + length
        return whole and sum(map(len, raw_records(source, found))) >= 0
    body = place + _HEAD.size
    if opcode == Opcode.MESSAGE_INDEX:
        return length >= 6 and struct.unpack("<I", source.read(body + 2, 4))[0] == length - 6
    if opcode == Opcode.MESSAGE:
        return length >= 22
    if length > LARGEST_DESCRIPTION and opcode != Opcode.ATTACHMENT:
        return False
    stream = ReadDataStream(BytesIO(source.read(body, length)))
    _KINDS[opcode].read(stream)
    return bool(stream.count == length)


def _proven_chunk(source: Source, place: int) -> Found | None:
    """Returns a chunk that is damaged, but whose records are as its CRC says."""
    head = chunk_head(source, place)
    if head is None or head.crc == 0 or head.place + head.stored_bytes > source.size:
        return None
    unfinished = False
    try:
        for _ in raw_records(source, head):
            pass
    except UnfinishedFrameError:
        unfinished = True
    except ValueError:
        return None
    size = head.place + head.stored_bytes - place
    return Found(place, size, int(Opcode.CHUNK), mended=True, unfinished=unfinished)


def _is_cut(source: Source, place: int) -> bool:
    head = source.read(place, _HEAD.size)
    if len(head) < _HEAD.size:
        return True
    opcode, length = _HEAD.unpack(head)
    return 1 <= opcode <= _LAST_OPCODE and place + _HEAD.size + length > source.size


def _next_chunk(source: Source, place: int) -> int | None:
    """Searches for the next intact chunk."""
    while place < source.size:
        block = source.read(place, BLOCK_BYTES + _HEAD.size)
        for match in _CHUNK_PATTERN.finditer(block):
            at = place + match.start()
            head = chunk_head(source, at)
            if head is not None and _intact(source, at) is not None:
                return at
        place += BLOCK_BYTES
    return None


def attachment(source: Source, found: Found) -> Attachment:
    """Reads an attachment."""
    body = source.read(found.place + _HEAD.size, found.size - _HEAD.size)
    return Attachment.read(ReadDataStream(BytesIO(body)))


def body(source: Source, found: Found) -> bytes:
    """Returns what stands behind the head of a record."""
    return source.read(found.place + _HEAD.size, found.size - _HEAD.size)
