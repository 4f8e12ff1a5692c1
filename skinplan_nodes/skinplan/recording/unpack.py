"""Storage files that rosbag2 compressed as a whole, and messages that it compressed one by one."""

import shutil
from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from zstandard import ZstdDecompressor

from skinplan.errors import BagInvalidError
from skinplan.recording.model import BagMessage
from skinplan.recording.storage import Storage, StorageInfo, decompressed, naming_damage

_STEP = 2**22
# So much of the disk stays free whatever a damaged file unpacks to [B].
_KEPT_FREE = 2**30


class UnpackedFile:
    """A storage file compressed as a whole, unpacked into a temporary folder until `close`.

    Args:
        path: File whose name ends in ``.zstd``.

    Raises:
        BagInvalidError: It is damaged, or the disk has no room for what it unpacks to.
    """

    def __init__(self, path: Path) -> None:
        self._folder = TemporaryDirectory(prefix="skinplan-bag-")
        self.path = Path(self._folder.name) / path.stem
        try:
            with naming_damage(path), path.open("rb") as packed, self.path.open("wb") as out:
                source = ZstdDecompressor().stream_reader(packed, read_across_frames=True)
                while piece := source.read(_STEP):
                    if shutil.disk_usage(self.path.parent).free < _KEPT_FREE + len(piece):
                        raise BagInvalidError(
                            f"{path}: it unpacks to more than the disk has room for"
                        )
                    out.write(piece)
        except BagInvalidError:
            self.close()
            raise

    def close(self) -> None:
        """Deletes what was unpacked."""
        self._folder.cleanup()


class UnpackedMessages:
    """A storage file whose messages are compressed one by one, see `Storage`.

    Args:
        inner: The file.
        compression: ``zstd`` or ``lz4``.
    """

    def __init__(self, inner: Storage, compression: str) -> None:
        self._inner = inner
        self._compression = compression

    @property
    def info(self) -> StorageInfo:
        """What is in it."""
        return self._inner.info

    def messages(
        self, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None
    ) -> Iterator[BagMessage]:
        """See `Storage`."""
        return map(self._unpacked, self._inner.messages(topics, start_ns, end_ns))

    def last(self, topic: str, at_ns: int, count: int) -> list[BagMessage]:
        """See `Storage`."""
        return [self._unpacked(message) for message in self._inner.last(topic, at_ns, count)]

    def close(self) -> None:
        """Closes the file."""
        self._inner.close()

    def _unpacked(self, message: BagMessage) -> BagMessage:
        with naming_damage(self.info.path):
            return replace(message, data=bytes(decompressed(self._compression, message.data)))
