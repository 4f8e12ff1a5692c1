"""A chunk of an MCAP file: gathers messages, then becomes the bytes of its records."""

import struct
import zlib
from array import array
from collections.abc import Callable
from dataclasses import dataclass

import lz4.frame
import zstandard
from mcap.opcode import Opcode

from skinplan.errors import BagNotWritableError

# opcode, length, channel, sequence, log time, publish time
_MESSAGE = struct.Struct("<BQHIQQ")
MESSAGE_HEADER_BYTES = _MESSAGE.size
_MESSAGE_FIELDS = MESSAGE_HEADER_BYTES - 9
# opcode, length, start, end, uncompressed size, CRC; then compression, then size of the records
_CHUNK = struct.Struct("<BQQQQI")
_INDEX = struct.Struct("<BQHI")
_NO_TIME = 2**64 - 1
# The fastest level: images hardly compress better on higher ones, and take twice the time.
_ZSTD_LEVEL = 1

Compressor = Callable[[bytes], bytes]


@dataclass(frozen=True)
class SealedChunk:
    """A chunk as it goes to the file.

    Attributes:
        parts: Chunk record, then message index records; one after the other in the file.
        chunk_bytes: Size of the chunk record [B].
        index_bytes: Size of the message index records [B].
        index_offsets: Place of each channel's index record, from the begin of the chunk [B].
        counts: Messages by channel.
        start_ns: Log time of the first message [ns].
        end_ns: Log time of the last message [ns].
        compression: MCAP's name of the compression; empty = none.
        compressed_bytes: Size of the records as stored [B].
        raw_bytes: Size of the records [B].
    """

    parts: tuple[bytes, ...]
    chunk_bytes: int
    index_bytes: int
    index_offsets: dict[int, int]
    counts: dict[int, int]
    start_ns: int
    end_ns: int
    compression: str
    compressed_bytes: int
    raw_bytes: int

    @property
    def size_bytes(self) -> int:
        """Size in the file [B]."""
        return self.chunk_bytes + self.index_bytes

    @property
    def messages(self) -> int:
        """Number of messages."""
        return sum(self.counts.values())


class MessageIndex:
    """Where the messages of one chunk are: by channel pairs of log time and place.

    Attributes:
        counts: Messages by channel.
        start_ns: Log time of the first message [ns].
        end_ns: Log time of the last message [ns].
    """

    def __init__(self) -> None:
        self._entries: dict[int, array[int]] = {}
        self.start_ns = _NO_TIME
        self.end_ns = 0

    @property
    def counts(self) -> dict[int, int]:
        """Messages by channel."""
        return {channel: len(entries) // 2 for channel, entries in self._entries.items()}

    def add(self, channel: int, log_time_ns: int, place: int) -> None:
        """Takes a message at a place in the uncompressed records [B]."""
        entries = self._entries.get(channel)
        if entries is None:
            entries = self._entries[channel] = array("Q")
        entries.append(log_time_ns)
        entries.append(place)
        if log_time_ns < self.start_ns:
            self.start_ns = log_time_ns
        if log_time_ns > self.end_ns:
            self.end_ns = log_time_ns

    def records(self, chunk_bytes: int) -> tuple[bytes, dict[int, int]]:
        """Returns the index records and the place of each, from the begin of the chunk [B]."""
        parts: list[bytes] = []
        offsets: dict[int, int] = {}
        place = chunk_bytes
        for channel, entries in self._entries.items():
            offsets[channel] = place
            size = 16 * (len(entries) // 2)
            parts.append(_INDEX.pack(Opcode.MESSAGE_INDEX, 6 + size, channel, size))
            parts.append(entries.tobytes())
            place += _INDEX.size + size
        return b"".join(parts), offsets


class ChunkBuilder:
    """Gathers messages until it is sealed.

    Attributes:
        size: Bytes of the records gathered so far.
    """

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._index = MessageIndex()
        self.size = 0

    @property
    def counts(self) -> dict[int, int]:
        """Messages by channel."""
        return self._index.counts

    @property
    def empty(self) -> bool:
        """Whether it holds no message."""
        return self._index.end_ns < self._index.start_ns

    def add_description(self, records: bytes) -> None:
        """Takes schema and channel records."""
        self._parts.append(records)
        self.size += len(records)

    def add(
        self, channel: int, sequence: int, log_time_ns: int, publish_time_ns: int, data: bytes
    ) -> None:
        """Takes one message."""
        length = len(data)
        self._parts.append(
            _MESSAGE.pack(
                Opcode.MESSAGE,
                _MESSAGE_FIELDS + length,
                channel,
                sequence & 0xFFFFFFFF,
                log_time_ns,
                publish_time_ns,
            )
        )
        self._parts.append(data)
        self._index.add(channel, log_time_ns, self.size)
        self.size += MESSAGE_HEADER_BYTES + length

    def seal(self, compression: str, compress: Compressor) -> SealedChunk:
        """Returns the chunk's records; at least one message must have been taken."""
        raw = b"".join(self._parts)
        stored = compress(raw)
        head = chunk_head(
            self._index.start_ns,
            self._index.end_ns,
            len(raw),
            zlib.crc32(raw),
            compression,
            len(stored),
        )
        return sealed(head, (stored,), self._index, compression, len(stored), len(raw))


def chunk_head(
    start_ns: int, end_ns: int, raw_bytes: int, crc: int, compression: str, stored_bytes: int
) -> bytes:
    """Returns what stands before the stored records of a chunk."""
    name = compression.encode()
    length = _CHUNK.size - 9 + 4 + len(name) + 8 + stored_bytes
    return (
        _CHUNK.pack(Opcode.CHUNK, length, start_ns, end_ns, raw_bytes, crc)
        + struct.pack("<I", len(name))
        + name
        + struct.pack("<Q", stored_bytes)
    )


def sealed(
    head: bytes,
    stored: tuple[bytes, ...],
    index: MessageIndex,
    compression: str,
    stored_bytes: int,
    raw_bytes: int,
) -> SealedChunk:
    """Puts a chunk together.

    Args:
        head: From `chunk_head`.
        stored: The stored records; empty when they are copied to the file by themselves.
        index: Its messages.
        compression: MCAP's name of the compression.
        stored_bytes: Size of the stored records [B].
        raw_bytes: Size of the records [B].
    """
    chunk_bytes = len(head) + stored_bytes
    records, offsets = index.records(chunk_bytes)
    return SealedChunk(
        parts=(head, *stored, records),
        chunk_bytes=chunk_bytes,
        index_bytes=len(records),
        index_offsets=offsets,
        counts=index.counts,
        start_ns=index.start_ns,
        end_ns=index.end_ns,
        compression=compression,
        compressed_bytes=stored_bytes,
        raw_bytes=raw_bytes,
    )


def compressor(name: str) -> tuple[str, Compressor]:
    """Returns MCAP's name of a compression and the function that does it.

    Args:
        name: ``zstd``, ``lz4`` or ``none``.

    Raises:
        BagNotWritableError: The name is another.
    """
    if name == "zstd":
        return name, zstandard.ZstdCompressor(level=_ZSTD_LEVEL).compress
    if name == "lz4":
        return name, lambda data: bytes(lz4.frame.compress(data))
    if name == "none":
        return "", lambda data: data
    raise BagNotWritableError(
        f"compression {name!r} was asked for; one of zstd, lz4, none is accepted"
    )
