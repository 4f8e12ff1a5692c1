"""What every kind of storage file offers, and how damage in one is named."""

import struct
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from lz4.frame import LZ4FrameDecompressor
from mcap.exceptions import McapError
from zstandard import ZstdDecompressor, ZstdError, frame_content_size

from skinplan.errors import BagInvalidError
from skinplan.recording.model import BagMessage, BagTopic

#: Larger pieces than this are no recording, but a damaged length or a decompression bomb [B].
LARGEST_PIECE = 2**30
# Up to here a claimed size is believed; memory for more is taken as the data come [B].
_BELIEVED = 2**24
_STEP = 2**22
#: Whatever the parsers of damaged bytes raise.
DAMAGE = (
    McapError,
    ZstdError,
    struct.error,
    ValueError,
    LookupError,
    EOFError,
    OverflowError,
    RuntimeError,
    OSError,
    MemoryError,
)


@dataclass(frozen=True)
class StorageInfo:
    """What is in one storage file.

    Attributes:
        path: The file.
        topics: Topics with their counts.
        messages: Number of messages.
        start_ns: Log time of the first message [ns]; 0 without messages.
        end_ns: Log time of the last message [ns]; 0 without messages.
        complete: Closed in order.
        metadata: Text of the rosbag2 metadata inside the file; empty = none.
    """

    path: Path
    topics: tuple[BagTopic, ...]
    messages: int
    start_ns: int
    end_ns: int
    complete: bool = True
    metadata: str = field(default="", repr=False)


class Storage(Protocol):
    """One open storage file; for one thread."""

    @property
    def info(self) -> StorageInfo:
        """What is in it."""

    def messages(
        self, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None
    ) -> Iterator[BagMessage]:
        """Iterates by log time, equal times in the order of recording.

        Args:
            topics: Topics to read; None = all.
            start_ns: Messages before this log time are left out [ns]; None = all.
            end_ns: Messages from this log time on are left out [ns]; None = all.

        Raises:
            BagInvalidError: The file is damaged.
        """

    def last(self, topic: str, at_ns: int, count: int) -> list[BagMessage]:
        """Returns the last messages of a topic up to a log time, that time included, in order.

        Args:
            topic: The topic.
            at_ns: The log time [ns].
            count: So many at most.

        Raises:
            BagInvalidError: The file is damaged.
        """

    def close(self) -> None:
        """Closes the file."""


@contextmanager
def naming_damage(path: Path) -> Iterator[None]:
    """Turns whatever damaged bytes raise into a `BagInvalidError` with the file's name."""
    try:
        yield
    except BagInvalidError as error:
        if str(path) in str(error):
            raise
        raise BagInvalidError(f"{path}: {error}") from error
    except DAMAGE as error:
        raise BagInvalidError(
            f"{path}: the file is damaged ({type(error).__name__}: {error})"
        ) from error


def decompressed(
    compression: str, data: bytes | memoryview, size: int | None = None
) -> bytes | memoryview:
    """Decompresses a piece without taking more memory than it really needs.

    Args:
        compression: ``zstd``, ``lz4``, or empty = none.
        data: The piece.
        size: Size that it has to have [B]; None = any.

    Raises:
        ValueError: Another compression, another size, or too large a piece.
        ZstdError: Damaged.
        RuntimeError: Damaged (lz4).
    """
    if size is not None and size > LARGEST_PIECE:
        raise ValueError(f"a piece of {size} bytes; up to {LARGEST_PIECE} are accepted")
    if compression == "":
        found: bytes | memoryview = data
    elif compression == "zstd":
        found = _zstd(data, LARGEST_PIECE if size is None else size)
    elif compression == "lz4":
        found = _lz4(data, LARGEST_PIECE if size is None else size)
    else:
        raise ValueError(f"compression zstd, lz4 or none is accepted, found {compression!r}")
    if size is not None and len(found) != size:
        raise ValueError(f"a piece of {size} bytes was announced, found {len(found)}")
    return found


def _zstd(data: bytes | memoryview, most: int) -> bytes:
    claimed = frame_content_size(data)
    if claimed > most:
        raise ValueError(f"a piece of {claimed} bytes; up to {most} are accepted")
    if 0 <= claimed <= _BELIEVED:
        # Of the library's own type; no copy.
        return ZstdDecompressor().decompress(data, max_output_size=max(claimed, 1))
    pieces = bytearray()
    with ZstdDecompressor().stream_reader(data) as stream:
        while piece := stream.read(_STEP):
            pieces += piece
            if len(pieces) > most:
                raise ValueError(f"a piece of more than {most} bytes")
    return bytes(pieces)


def _lz4(data: bytes | memoryview, most: int) -> bytes:
    stream, pieces = LZ4FrameDecompressor(), bytearray()
    piece = stream.decompress(data, max_length=_STEP)
    while piece or not (stream.eof or stream.needs_input):
        pieces += piece
        if len(pieces) > most:
            raise ValueError(f"a piece of more than {most} bytes")
        if stream.eof:
            break
        piece = stream.decompress(b"", max_length=_STEP)
    if not stream.eof:
        raise EOFError("the compressed piece breaks off")
    return bytes(pieces)
