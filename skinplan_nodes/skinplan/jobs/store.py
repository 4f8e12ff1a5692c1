"""Keeps jobs in an SQLite file: the order, how far it is, the history of its states, the result.

Every change is one transaction: a process that is killed leaves the state before or after it,
nothing between.
"""

import json
import sqlite3
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from skinplan.errors import JobQueueFullError
from skinplan.jobs.checks import check_job
from skinplan.jobs.database import JobDatabase
from skinplan.jobs.model import HistoryEntry, Job, JobRecord, JobState
from skinplan.jobs.rows import FIELDS, content_of, entry_of, place_of, record_of, values_of
from skinplan.jobs.statements import (
    finished,
    first_of,
    known_job,
    readable,
    remember,
    row_of,
    stored,
    write,
)
from skinplan.jobs.states import check_transition, is_over
from skinplan.json_file import plain

# Reason of history entries that the store makes itself.
_SUBMITTED = "submitted"
_WAITING = (JobState.NOT_ALLOWED_TO_START, JobState.ALLOWED_TO_START)
_ON_CELL = (JobState.RUNNING, JobState.INTERRUPTED)
_OVER = tuple(state for state in JobState if is_over(state))


class JobStore:
    """The jobs of a cell. All methods may be called from any thread of one process.

    Args:
        path: SQLite file; created with its folder.
        clock: Returns the time of changes [ns since the epoch].
        copy: Look at a copy of a file that exists, of whatever version, and leave it alone.

    Raises:
        InputError: The file can't be opened, is no job store, or is one of a newer version.

    All methods raise `JobStoreError` where the file can't be read or written now.
    """

    def __init__(
        self, path: Path | str, clock: Callable[[], int] = time.time_ns, copy: bool = False
    ) -> None:
        self.path = Path(path)
        self._clock = clock
        self._database = JobDatabase(self.path, copy)

    def close(self) -> None:
        """Closes the file; a second call does nothing."""
        self._database.close()

    def submit(self, job: Job, allowed_to_start: bool = True, queue_max: int = 0) -> JobRecord:
        """Puts a job into the queue; the same id with the same content again gives the same job.

        Args:
            job: The order.
            allowed_to_start: False = waits for the command START.
            queue_max: No more jobs than this may wait; 0 = no limit.

        Returns:
            The job as it is now.

        Raises:
            JobInvalidError: A field can't be accepted.
            JobConflictError: The id exists with other content.
            JobQueueFullError: As many jobs as may wait do so.
        """
        content = content_of(check_job(job))
        with self._database.transaction() as database:
            known = known_job(row_of(database, job.job_id), job)
            if known is not None:
                return known
            self._check_room(database, queue_max)
            state = JobState.ALLOWED_TO_START if allowed_to_start else JobState.NOT_ALLOWED_TO_START
            record = JobRecord(job, state, changed_ns=self._clock())
            columns = ("job_id", "content", "priority", "earliest_start_ns", *FIELDS)
            database.execute(
                f"INSERT INTO jobs ({', '.join(columns)}) VALUES ({', '.join('?' * len(columns))})",  # noqa: S608
                (job.job_id, content, job.priority, job.earliest_start_ns, *values_of(record)),
            )
            remember(database, record, _SUBMITTED)
            return record

    def same(self, job: Job) -> JobRecord | None:
        """Returns the job that was submitted with the same id and content; None = there is none.

        Raises:
            JobConflictError: The id exists with other content.
        """
        rows = self._database.read("SELECT * FROM jobs WHERE job_id = ?", readable(job.job_id))
        return known_job(rows[0] if rows else None, job)

    def get(self, job_id: str) -> JobRecord:
        """Returns a job.

        Raises:
            JobUnknownError: There is none of that id.
        """
        rows = self._database.read("SELECT * FROM jobs WHERE job_id = ?", readable(job_id))
        return record_of(first_of(rows, job_id))

    def list(
        self,
        limit: int = 0,
        before: str = "",
        states: Iterable[int] = (),
        include_cleared: bool = True,
    ) -> tuple[JobRecord, ...]:
        """Returns jobs, newest first.

        Args:
            limit: At most so many; 0 = all.
            before: Only those submitted before this one; empty = from the newest on.
            states: Only those in these states; empty = in any.
            include_cleared: Also those whose result was acknowledged.

        Raises:
            JobUnknownError: There is no job `before`.
        """
        conditions, values = ["1"], []
        if before:
            self.get(before)
            conditions.append("number < (SELECT number FROM jobs WHERE job_id = ?)")
            values.append(before)
        wanted = tuple(dict.fromkeys(int(state) for state in states))[: len(JobState) + 1]
        if wanted:
            conditions.append(f"state IN ({', '.join(map(str, wanted))})")
        if not include_cleared:
            conditions.append("cleared = 0")
        query = f"SELECT * FROM jobs WHERE {' AND '.join(conditions)} ORDER BY number DESC LIMIT ?"  # noqa: S608
        rows = self._database.read(query, *values, limit if limit > 0 else -1)
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
        with self._database.transaction() as database:
            before = stored(database, record.job.job_id)
            check_transition(record.job.job_id, before.state, record.state)
            after = replace(record, job=before.job, changed_ns=self._clock())
            write(database, after)
            if place_of(before) != place_of(after):
                remember(database, after, reason or after.error)
            return after

    def finish(
        self, record: JobRecord, result: Mapping[str, Any] | None = None, reason: str = ""
    ) -> JobRecord:
        """Stores the end of a job and what it came to, both or nothing.

        Args:
            record: The job as it is now.
            result: What it came to; None = nothing.
            reason: Why, for the history; empty = the record's error.

        Raises:
            JobUnknownError, JobCommandError: As `update`.
        """
        with self._database.transaction() as database:
            after = self.update(record, reason)
            if result is not None:
                database.execute(
                    "INSERT OR REPLACE INTO results (job_id, at_ns, document) VALUES (?, ?, ?)",
                    (after.job.job_id, after.changed_ns, json.dumps(plain(result))),
                )
            return after

    def result(self, job_id: str) -> str:
        """Returns what a job came to as a JSON text; empty = nothing.

        Raises:
            JobUnknownError: There is no such job.
        """
        self.get(job_id)
        rows = self._database.read("SELECT document FROM results WHERE job_id = ?", job_id)
        return str(rows[0]["document"]) if rows else ""

    def clear(self, job_id: str, reason: str = "") -> JobRecord:
        """Notes that somebody has fetched the result of a job; a second time changes nothing.

        Raises:
            JobUnknownError: There is no such job.
            JobConflictError: It is not over.
        """
        with self._database.transaction() as database:
            record = finished(stored(database, job_id), "cleared")
            if not record.cleared:
                record = replace(record, cleared=True, changed_ns=self._clock())
                write(database, record)
                remember(database, record, reason or "cleared")
            return record

    def remove(self, job_id: str) -> None:
        """Forgets a job that is over, with its history and result.

        Raises:
            JobUnknownError: There is no such job.
            JobConflictError: It is not over.
        """
        with self._database.transaction() as database:
            finished(stored(database, job_id), "removed")
            database.execute("DELETE FROM jobs WHERE job_id = ?", (job_id,))

    def retain(self, most: int = 0, oldest_ns: int = 0) -> int:
        """Forgets jobs that are over: the old ones, and the oldest of too many.

        Args:
            most: So many of them are kept; those that were acknowledged go first; 0 = no limit.
            oldest_ns: Those that ended before are forgotten [ns since the epoch].

        Returns:
            How many were forgotten.
        """
        over = f"state IN ({', '.join(str(int(state)) for state in _OVER)})"
        with self._database.transaction() as database:
            gone = database.execute(
                f"DELETE FROM jobs WHERE {over} AND changed_ns < ?",
                (oldest_ns,),  # noqa: S608
            ).rowcount
            if most > 0:
                gone += database.execute(
                    f"DELETE FROM jobs WHERE number IN (SELECT number FROM jobs WHERE {over} "  # noqa: S608
                    "ORDER BY cleared, number DESC LIMIT -1 OFFSET ?)",
                    (most,),
                ).rowcount
            return int(gone)

    def history(self, job_id: str) -> tuple[HistoryEntry, ...]:
        """Returns the changes of a job in their order.

        Raises:
            JobUnknownError: There is no such job.
        """
        self.get(job_id)
        rows = self._database.read("SELECT * FROM history WHERE job_id = ? ORDER BY number", job_id)
        return tuple(entry_of(row) for row in rows)

    def current(self) -> JobRecord | None:
        """Returns the job that is Running or Interrupted; None = the cell is free."""
        return self._first("state IN (?, ?) ORDER BY number", *_ON_CELL)

    def next_to_run(self, now_ns: int | None = None) -> JobRecord | None:
        """Returns the job to start now.

        Of those that may start by now: highest priority, then earliest start, then first come.
        None = none waits, or one is on the cell.

        Args:
            now_ns: The time [ns since the epoch]; None = that of the store's clock.
        """
        if self.current() is not None:
            return None
        return self._first(
            "state = ? AND earliest_start_ns <= ? "
            "ORDER BY priority DESC, earliest_start_ns, number",
            JobState.ALLOWED_TO_START,
            self._clock() if now_ns is None else now_ns,
        )

    def _first(self, condition: str, *values: int) -> JobRecord | None:
        query = f"SELECT * FROM jobs WHERE {condition} LIMIT 1"  # noqa: S608
        rows = self._database.read(query, *map(int, values))
        return record_of(rows[0]) if rows else None

    @staticmethod
    def _check_room(database: sqlite3.Connection, queue_max: int) -> None:
        query = "SELECT COUNT(*) FROM jobs WHERE state IN (?, ?)"
        count = database.execute(query, tuple(map(int, _WAITING))).fetchone()[0]
        if 0 < queue_max <= count:
            raise JobQueueFullError(
                f"{count} jobs wait; {queue_max} are accepted: submit again when one has started"
            )
