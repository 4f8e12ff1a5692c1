"""The SQLite file of the jobs: opened, brought up to date, changed by whole transactions.

WAL with ``synchronous = FULL``: what a transaction has written is there after the end of the
process or of the machine; what it has not finished is not there.
"""

import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from skinplan.errors import InputError, JobStoreError
from skinplan.jobs.rows import MIGRATIONS, SCHEMA_VERSION, TABLES

# Another process may hold the file for a moment [s].
_BUSY_S = 5.0


class JobDatabase:
    """The file, with one connection that writes and one that reads.

    Who reads does not wait for the disk of who writes. All methods may be called from any thread.

    Args:
        path: SQLite file; created with its folder.
        copy: Work on a copy in memory of a file that exists, and leave it alone.

    Raises:
        InputError: The file can't be opened, is no job store, or is one of a newer version.
    """

    def __init__(self, path: Path, copy: bool = False) -> None:
        self.path = path
        self._lock = threading.RLock()
        self._read_lock = threading.RLock()
        try:
            self._writer = _copied(path) if copy else _opened(path)
            self._prepare(in_file=not copy)
            self._reader = self._writer
            if copy:
                self._read_lock = self._lock
            else:
                self._reader = _connected(path)
                self._reader.execute("PRAGMA query_only = ON")
        except (OSError, sqlite3.Error) as error:
            raise InputError(
                f"job store {path}: an SQLite file of jobs is accepted ({error})"
            ) from error

    def close(self) -> None:
        """Closes the file; a second call does nothing."""
        with self._lock, self._read_lock:
            self._reader.close()
            self._writer.close()

    @contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """Gives the connection that writes; all that the body does is kept, or nothing.

        Raises:
            JobStoreError: The disk is full, or another process holds the file.
        """
        with self._lock:
            if self._writer.in_transaction:  # part of a larger one
                yield self._writer
                return
            try:
                self._writer.execute("BEGIN IMMEDIATE")
                yield self._writer
                self._writer.execute("COMMIT")
            except BaseException as error:
                if self._writer.in_transaction:
                    self._writer.execute("ROLLBACK")
                if isinstance(error, sqlite3.Error):
                    raise JobStoreError(f"job store {self.path}: {error}") from error
                raise

    def read(self, query: str, *values: object) -> list[sqlite3.Row]:
        """Returns rows of what was committed.

        Raises:
            JobStoreError: They can't be read.
        """
        with self._read_lock:
            try:
                return self._reader.execute(query, values).fetchall()
            except sqlite3.Error as error:
                raise JobStoreError(f"job store {self.path}: {error}") from error

    def _prepare(self, in_file: bool) -> None:
        database = self._writer
        if in_file:
            database.execute("PRAGMA journal_mode = WAL")
            database.execute("PRAGMA synchronous = FULL")
        database.execute("PRAGMA foreign_keys = ON")
        version = database.execute("PRAGMA user_version").fetchone()[0]
        if version > SCHEMA_VERSION:
            raise InputError(
                f"job store {self.path}: versions up to {SCHEMA_VERSION} are accepted, found "
                f"version {version}"
            )
        older = [MIGRATIONS[number] for number in range(version, SCHEMA_VERSION) if version]
        if version < SCHEMA_VERSION:
            script = [*older, TABLES, f"PRAGMA user_version = {SCHEMA_VERSION};"]
            database.executescript(f"BEGIN IMMEDIATE; {' '.join(script)} COMMIT;")


def _opened(path: Path) -> sqlite3.Connection:
    path.parent.mkdir(parents=True, exist_ok=True)
    return _connected(path)


def _copied(path: Path) -> sqlite3.Connection:
    """Returns a copy in memory: one moment of the file, even while another process writes."""
    if not path.is_file():
        raise InputError(f"job store {path}: there is no such file; that of a cell is accepted")
    memory = _connected(":memory:")
    source = sqlite3.connect(path, timeout=_BUSY_S)
    try:
        source.backup(memory)
    finally:
        source.close()
    return memory


def _connected(path: Path | str) -> sqlite3.Connection:
    found = sqlite3.connect(path, check_same_thread=False, isolation_level=None, timeout=_BUSY_S)
    found.row_factory = sqlite3.Row
    return found
