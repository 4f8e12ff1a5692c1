"""Scan frames on disk, so that a scan goes on after the program that collected it has ended.

An append-only file: a magic word, then records of a mark, their length, a checksum and their bytes.
The first record says whose frames they are. A record is written by one call, so that an end of the
program at any moment cuts at most the last one off; a cut tail is dropped, and a damaged record is
left out, when the file is read again.
"""

import json
import logging
import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from skinplan.errors import ResumeRefusedError
from skinplan.inspection.spool_records import Record, packed, unpacked

FILE_NAME = "frames.spool"
_MAGIC = b"skinplan frames 1\n"
_MARK = b"\xa5FR\x5a"
# Mark, number of bytes, checksum of the bytes.
_HEAD = struct.Struct("<4sII")
_MOST_BYTES = 1 << 30
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SpoolOwner:
    """Whose frames they are.

    Attributes:
        job_id: The job.
        part_id: The part.
        mesh_sha256: Of the part's mesh file.
    """

    job_id: str
    part_id: str
    mesh_sha256: str


class FrameSpool:
    """Appends records to the file; what can't be written is named once, and nothing is raised.

    Args:
        path: The file; it is there, and whole up to `end`.
        end: Number of its bytes that count.
    """

    def __init__(self, path: Path, end: int) -> None:
        self.path = path
        self.failure = ""
        self._end = end
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CLOEXEC)
        os.ftruncate(self._descriptor, end)
        os.lseek(self._descriptor, end, os.SEEK_SET)

    @classmethod
    def create(cls, folder: Path, owner: SpoolOwner) -> "FrameSpool":
        """Begins a new file.

        Raises:
            ResumeRefusedError: The folder holds frames of another job.
            OSError: The file can't be written.
        """
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / FILE_NAME
        if path.exists():
            _require_job(path, owner)
        whose = json.dumps(asdict(owner)).encode()
        temporary = path.with_name(f".{path.name}.{os.getpid()}")
        content = _MAGIC + _record(whose)
        temporary.write_bytes(content)
        temporary.replace(path)
        return cls(path, len(content))

    @classmethod
    def resume(cls, folder: Path, owner: SpoolOwner) -> tuple["FrameSpool", Iterator[Record]]:
        """Goes on with the file of a folder; begins one where there is none that says whose it is.

        Returns:
            The spool, and what was collected, to be read before anything is added.

        Raises:
            ResumeRefusedError: It holds frames of another job or part.
            OSError: The file can't be read or written.
        """
        path = folder / FILE_NAME
        found = owner_of(path)
        if found is None:
            if path.exists():
                _log.warning("%s: it does not say whose frames it holds; begun anew", path)
            return cls.create(folder, owner), iter(())
        if found != owner:
            raise ResumeRefusedError(
                f"frames of job {owner.job_id} and part {owner.part_id} with mesh "
                f"{owner.mesh_sha256[:12]} were asked for; {path} holds those of job "
                f"{found.job_id} and part {found.part_id} with mesh {found.mesh_sha256[:12]}; "
                f"those are accepted"
            )
        end = max((end for _, end in _payloads(path)), default=0)
        dropped = path.stat().st_size - end
        if dropped:
            _log.warning("%s: the last record was cut, %d bytes are dropped", path, dropped)
        return cls(path, end), read_records(path)

    def add(self, record: Record) -> None:
        """Appends a record."""
        if self.failure:
            return
        data = _record(packed(record))
        try:
            written = os.write(self._descriptor, data)
            if written != len(data):
                raise OSError(f"only {written} of {len(data)} bytes were taken")
        except OSError as error:
            self.failure = (
                f"{self.path}: scan frames can't be kept on disk ({error.strerror or error}); the "
                f"scan goes on in memory and can't be resumed by another process from here on"
            )
            _log.warning("%s", self.failure)
            # What was half written goes, so that the file ends with a whole record.
            os.ftruncate(self._descriptor, self._end)
            return
        self._end += len(data)

    def sync(self) -> None:
        """Brings the file to the disk: without it, only an end of the program is survived."""
        if self._descriptor >= 0 and not self.failure:
            os.fdatasync(self._descriptor)

    def close(self) -> None:
        """Ends writing; the file stays."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


def owner_of(path: Path) -> SpoolOwner | None:
    """Returns whose frames a file holds; None = no such file, or it does not say so.

    Raises:
        OSError: It can't be read.
    """
    if not path.exists():
        return None
    first = next(_payloads(path), None)
    try:
        return None if first is None else SpoolOwner(**json.loads(first[0]))
    except (ValueError, TypeError):
        return None


def read_records(path: Path) -> Iterator[Record]:
    """Reads what was collected, damaged records left out.

    Raises:
        OSError: The file can't be read.
    """
    payloads = _payloads(path)
    next(payloads, None)
    for payload, _ in payloads:
        record = unpacked(payload)
        if record is not None:
            yield record


def _require_job(path: Path, owner: SpoolOwner) -> None:
    found = owner_of(path)
    if found is not None and found.job_id != owner.job_id:
        raise ResumeRefusedError(
            f"frames of job {owner.job_id} were to be kept in {path.parent}, where those of job "
            f"{found.job_id} are; a folder of its own is accepted"
        )


def _record(payload: bytes) -> bytes:
    return _HEAD.pack(_MARK, len(payload), zlib.crc32(payload)) + payload


def _payloads(path: Path) -> Iterator[tuple[bytes, int]]:
    """Yields the bytes of each whole record and where it ends."""
    with path.open("rb") as stream:
        data = stream.read(len(_MAGIC))
        if data != _MAGIC:
            return
        at, size = len(_MAGIC), path.stat().st_size
        while at + _HEAD.size <= size:
            payload = _payload_at(stream.fileno(), at, size)
            if payload is None:
                found = _next_mark(stream.fileno(), at + 1, size)
                if found is None:
                    return
                _log.warning("%s: %d bytes at %d are damaged and left out", path, found - at, at)
                at = found
                continue
            at += _HEAD.size + len(payload)
            yield payload, at


def _payload_at(descriptor: int, at: int, size: int) -> bytes | None:
    head = os.pread(descriptor, _HEAD.size, at)
    if len(head) < _HEAD.size:
        return None
    mark, length, checksum = _HEAD.unpack(head)
    if mark != _MARK or length > min(_MOST_BYTES, size - at - _HEAD.size):
        return None
    payload = os.pread(descriptor, length, at + _HEAD.size)
    return payload if len(payload) == length and zlib.crc32(payload) == checksum else None


def _next_mark(descriptor: int, at: int, size: int) -> int | None:
    """Returns where the next whole record begins; marks may also stand in the bytes of a record."""
    step = 1 << 20
    while at < size:
        block = os.pread(descriptor, step + len(_MARK) - 1, at)
        place = block.find(_MARK)
        while place >= 0:
            if _payload_at(descriptor, at + place, size) is not None:
                return at + place
            place = block.find(_MARK, place + 1)
        at += step
    return None
