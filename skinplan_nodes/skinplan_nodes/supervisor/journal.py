"""The journal of a run: what a new supervisor has to know to go on after the old one was killed.

One line of JSON per entry with a checksum, on disk before the job goes on. A line that was cut off
at the end is none; anything else that does not fit is named. Needs no ROS.
"""

import hashlib
import json
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skinplan.errors import InputError
from skinplan.plan_record import plain

_SUM_DIGITS = 16


class JournalError(InputError):
    """A journal, or a file that it names, is damaged or missing."""


@dataclass(frozen=True)
class Entry:
    """One entry.

    Attributes:
        kind: What happened.
        at_ns: When [ns since the epoch].
        values: The rest, by name.
    """

    kind: str
    at_ns: int
    values: dict[str, Any]


class Journal:
    """Appends to a journal.

    Args:
        path: The file; what stands in it is kept.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._cut_off()

    def add(self, kind: str, **values: Any) -> None:
        """Adds an entry; it is on disk when this returns.

        Raises:
            OSError: The disk does not take it.
        """
        text = json.dumps({"kind": kind, "at_ns": time.time_ns(), **plain(values)}, allow_nan=False)
        line = f"{_sum(text)} {text}\n".encode()
        descriptor = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        try:
            _write_all(descriptor, line)
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

    def store(self, name: str, content: bytes) -> dict[str, str]:
        """Writes a file beside the journal, to be named in the next entry.

        Args:
            name: Name of the file.
            content: What it holds.

        Returns:
            ``file`` and ``sha256`` for the entry.
        """
        path = self.path.parent / name
        temporary = path.with_name(f".{name}.new")
        with temporary.open("wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(path)
        return {"file": name, "sha256": hashlib.sha256(content).hexdigest()}

    def _cut_off(self) -> None:
        """Takes off a last line that was never finished, so that the next one stands alone."""
        if not self.path.is_file():
            return
        content = self.path.read_bytes()
        whole = content.rfind(b"\n") + 1
        if whole < len(content):
            os.truncate(self.path, whole)


def read_journal(path: Path) -> tuple[Entry, ...]:
    """Returns the entries of a journal.

    Raises:
        JournalError: There is none, or a line is not what was written.
    """
    try:
        lines = path.read_bytes().split(b"\n")
    except OSError as error:
        raise JournalError(f"journal {path}: a file that can be read is accepted ({error})") from (
            error
        )
    # What follows the last line break was cut off.
    return tuple(_entry(path, number, line) for number, line in enumerate(lines[:-1], 1))


def read_stored(folder: Path, values: dict[str, Any]) -> bytes:
    """Returns the content of a file that an entry names.

    Args:
        folder: Folder of the journal.
        values: The entry's values ``file`` and ``sha256``.

    Raises:
        JournalError: It is missing, or not what was written.
    """
    path = folder / Path(str(values["file"])).name
    try:
        content = path.read_bytes()
    except OSError as error:
        raise JournalError(f"{path}: the journal names it, but it can't be read: {error}") from (
            error
        )
    if hashlib.sha256(content).hexdigest() != values["sha256"]:
        raise JournalError(f"{path}: its SHA-256 is not the one that stands in the journal")
    return content


def _entry(path: Path, number: int, line: bytes) -> Entry:
    found, _, text = line.decode("utf-8", "replace").partition(" ")
    if found != _sum(text):
        raise JournalError(f"journal {path}: line {number} is not what was written")
    values = json.loads(text)
    return Entry(values.pop("kind"), values.pop("at_ns"), values)


def _sum(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:_SUM_DIGITS]


def _write_all(descriptor: int, content: bytes) -> None:
    while content:
        content = content[os.write(descriptor, content) :]
