"""Where a device stands, on disk: a device does not go home because its driver was restarted."""

import os
import struct
import zlib
from pathlib import Path

import numpy as np

from skinplan.errors import InputError
from skinplan.transforms import Array

_HEAD = struct.Struct("<Id")  # checksum of what follows, time [s]


class KeptState:
    """A few numbers in a file, written again and again.

    Args:
        path: Absolute path of the file; empty = nothing is kept.
        count: How many numbers.

    Raises:
        InputError: The file can't be written.
    """

    def __init__(self, path: str, count: int) -> None:
        self._count = count
        self._file = -1
        self._last = b""
        if not path:
            return
        try:
            self._file = os.open(Path(path), os.O_RDWR | os.O_CREAT, 0o644)
        except OSError as error:
            raise InputError(
                f"state_file {path!r}: a file that can be written is accepted ({error.strerror})"
            ) from error

    def read(self, now_s: float) -> Array | None:
        """Returns the numbers, shape (count,); None = none, damaged, or of a later time than now.

        A time later than now [s] is that of another run, whose clock began anew.
        """
        if self._file < 0:
            return None
        size = _HEAD.size + 8 * self._count
        data = os.pread(self._file, size + 1, 0)
        if len(data) != size:
            return None
        checksum, time_s = _HEAD.unpack_from(data)
        values = np.frombuffer(data, dtype="<f8", offset=_HEAD.size)
        if checksum != zlib.crc32(data[4:]) or time_s > now_s or not np.all(np.isfinite(values)):
            return None
        return values.copy()

    def write(self, now_s: float, values: Array) -> None:
        """Writes the numbers, shape (count,), when they have changed."""
        body = np.asarray(values, dtype="<f8").tobytes()
        if self._file < 0 or body == self._last:
            return
        self._last = body
        rest = struct.pack("<d", now_s) + body
        os.pwrite(self._file, struct.pack("<I", zlib.crc32(rest)) + rest, 0)

    def close(self) -> None:
        """Ends keeping; what is on disk stays."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1
