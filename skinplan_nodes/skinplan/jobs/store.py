"""Keeps jobs in an SQLite file (WAL): the order, how far it is, and the history of its states.

Every change is one transaction: a process that is killed leaves the state before or after it,
nothing between.
"""

import sqlite3
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from skinplan.errors import InputError, JobConflictError, JobUnknownError
from skinplan.jobs.checks import check_job
from skinplan.jobs.model import Job, JobRecord, JobState
from skinplan.jobs.rows import (
    FIELDS,
    MIGRATIONS,
    TABLES,
    content_of,
    job_of,
    place_of,
    record_of,
    values_of,
)
from skinplan.jobs.states import check_transition, is_over

SCHEMA_VERSION = 2
# Reason of history entries that the store makes itself.
_SUBMITTED = "submitted"


@dataclass(frozen=True)
class HistoryEntry:
    """One change of a job.

    Attributes:
        at_ns: When [ns since the epoch].
        state: State from then on.
        sub_state: Sub-state from then on.
        station: Station from then on, from 1; 0 = none.
        reason: Why, or the error; may be empty.
    """

    at_ns: int
    state: JobState
    sub_state: str
    station: int
    reason: str


class JobStore:
    """The jobs of a cell. All methods may be called from any thread of one process.

    Args:
        path: SQLite file; created with its folder.
        clock: Returns the time of changes [ns since the epoch].

    Raises:
        InputError: The file can't be opened, is no job store, or is one of a newer version.
    """

    def __init__(self, path: Path | str, clock: Callable[[], int] = time.time_ns) -> None:
        self.path = Path(path)
        self._clock = clock
        self._lock = threading.RLock()
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._database = sqlite3.connect(
                self.path, check_same_thread=False, isolation_level=None, timeout=5.0
            )
            self._prepare()
        except (OSError, sqlite3.Error) as error:
            raise InputError(
                f"job store {self.path}: an SQLite file that can be written is accepted ({error})"
            ) from error

    def close(self) -> None:
        """Closes the file; a second call does nothing."""
        with self._lock:
            self._database.close()

    def submit(self, job: Job, allowed_to_start: bool = True) -> JobRecord:
        """Puts a job into the queue; the same id with the same content again gives the same job.

        Args:
            job: The order.
            allowed_to_start: False = waits for the command START.

        Returns:
            The job as it is now.

        Raises:
            JobInvalidError: A field can't be accepted.
            JobConflictError: The id exists with other content.
        """
        content = content_of(check_job(job))
        with self._transaction():
            row = self._row(job.job_id)
            if row is not None:
                if row["content"] != content:
                    raise JobConflictError(_conflict(job, job_of(row["content"])))
                return record_of(row)
            state = JobState.ALLOWED_TO_START if allowed_to_start else JobState.NOT_ALLOWED_TO_START
            record = JobRecord(job, state, changed_ns=self._clock())
            columns = ("job_id", "content", "priority", *FIELDS)
            self._database.execute(
                f"INSERT INTO jobs ({', '.join(columns)}) VALUES ({', '.join('?' * len(columns))})",  # noqa: S608
                (job.job_id, content, job.priority, *values_of(record)),
            )
            self._remember(record, _SUBMITTED)
            return record

    def get(self, job_id: str) -> JobRecord:
        """Returns a job.

        Raises:
            JobUnknownError: There is none of that id.
        """
        with self._lock:
            row = self._row(job_id)
        if row is None:
            raise JobUnknownError(f"job {job_id[:80]!a} was asked for; there is none of that id")
        return record_of(row)

    def list(self, limit: int = 0) -> tuple[JobRecord, ...]:
        """Returns jobs, newest first.

        Args:
            limit: At most so many; 0 = all.
        """
        with self._lock:
            rows = self._database.execute(
                "SELECT * FROM jobs ORDER BY number DESC LIMIT ?", (limit if limit > 0 else -1,)
            ).fetchall()
        return tuple(record_of(row) for row in rows)

    def update(self, record: JobRecord, reason: str = "") -> JobRecord:
        """Stores how far a job is; a change of state, sub-state or station goes into its history.

        Args:
            record: The job as it is now; the order itself can't be changed.
            reason: Why, for the history; empty = the record's error.

        Returns:
            The record with the time of the change.

        Raises:
            JobUnknownError: There is no such job.
            JobCommandError: Its state does not follow on the one stored.
        """
        with self._transaction():
            before = self.get(record.job.job_id)
            check_transition(record.job.job_id, before.state, record.state)
            after = replace(record, job=before.job, changed_ns=self._clock())
            assignments = ", ".join(f"{name} = ?" for name in FIELDS)
            self._database.execute(
                f"UPDATE jobs SET {assignments} WHERE job_id = ?",  # noqa: S608
                (*values_of(after), after.job.job_id),
            )
            if place_of(before) != place_of(after):
                self._remember(after, reason or after.error)
            return after

    def remove(self, job_id: str) -> None:
        """Forgets a job that is over, with its history.

        Raises:
            JobUnknownError: There is no such job.
            JobConflictError: It is not over.
        """
        with self._transaction():
            record = self.get(job_id)
            if not is_over(record.state):
                raise JobConflictError(
                    f"job {job_id} was to be removed, but is {record.state.title}; one that is "
                    "over is accepted"
                )
            self._database.execute("DELETE FROM jobs WHERE job_id = ?", (job_id,))

    def history(self, job_id: str) -> tuple[HistoryEntry, ...]:
        """Returns the changes of a job in their order.

        Raises:
            JobUnknownError: There is no such job.
        """
        self.get(job_id)
        with self._lock:
            rows = self._database.execute(
                "SELECT * FROM history WHERE job_id = ? ORDER BY number", (job_id,)
            ).fetchall()
        return tuple(
            HistoryEntry(
                row["at_ns"],
                JobState(row["state"]),
                row["sub_state"],
                row["station"],
                row["reason"],
            )
            for row in rows
        )

    def current(self) -> JobRecord | None:
        """Returns the job that is Running or Interrupted; None = the cell is free."""
        return self._first(
            "state IN (?, ?) ORDER BY number", JobState.RUNNING, JobState.INTERRUPTED
        )

    def next_to_run(self) -> JobRecord | None:
        """Returns the job to start now.

        Highest priority, then first come; None = none waits, or one is on the cell.
        """
        with self._lock:
            if self.current() is not None:
                return None
            return self._first(
                "state = ? ORDER BY priority DESC, number", JobState.ALLOWED_TO_START
            )

    def _prepare(self) -> None:
        self._database.row_factory = sqlite3.Row
        self._database.execute("PRAGMA journal_mode = WAL")
        self._database.execute("PRAGMA synchronous = FULL")
        self._database.execute("PRAGMA foreign_keys = ON")
        version = self._database.execute("PRAGMA user_version").fetchone()[0]
        if version > SCHEMA_VERSION:
            raise InputError(
                f"job store {self.path}: versions up to {SCHEMA_VERSION} are accepted, found "
                f"version {version}"
            )
        older = [MIGRATIONS[number] for number in range(version, SCHEMA_VERSION) if version]
        script = [*older, TABLES, f"PRAGMA user_version = {SCHEMA_VERSION};"]
        self._database.executescript(f"BEGIN IMMEDIATE; {' '.join(script)} COMMIT;")

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        with self._lock:
            if self._database.in_transaction:  # part of a larger one
                yield
                return
            self._database.execute("BEGIN IMMEDIATE")
            try:
                yield
            except BaseException:
                self._database.execute("ROLLBACK")
                raise
            self._database.execute("COMMIT")

    def _row(self, job_id: str) -> sqlite3.Row | None:
        found: sqlite3.Row | None = self._database.execute(
            "SELECT * FROM jobs WHERE job_id = ?", (job_id.encode("utf-8", "replace").decode(),)
        ).fetchone()
        return found

    def _first(self, condition: str, *values: int) -> JobRecord | None:
        with self._lock:
            row = self._database.execute(
                f"SELECT * FROM jobs WHERE {condition} LIMIT 1", values
            ).fetchone()  # noqa: S608
        return None if row is None else record_of(row)

    def _remember(self, record: JobRecord, reason: str) -> None:
        self._database.execute(
            "INSERT INTO history (job_id, at_ns, state, sub_state, station, reason) VALUES (?, "
            "?, ?, ?, ?, ?)",
            (
                record.job.job_id,
                record.changed_ns,
                int(record.state),
                record.sub_state,
                record.station,
                reason,
            ),
        )


def _conflict(asked: Job, known: Job) -> str:
    names = [name for name, value in asdict(asked).items() if value != asdict(known)[name]]
    return (
        f"job {asked.job_id} was submitted again with another {', '.join(names)}; "
        "the same content or a new job id is accepted"
    )
