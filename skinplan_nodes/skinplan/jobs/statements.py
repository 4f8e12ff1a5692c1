"""What the job store asks of its tables inside a transaction."""

import sqlite3
from dataclasses import asdict

from skinplan.errors import JobConflictError, JobUnknownError
from skinplan.jobs.model import Job, JobRecord
from skinplan.jobs.rows import FIELDS, content_of, job_of, record_of, values_of
from skinplan.jobs.states import is_over


def known_job(row: sqlite3.Row | None, job: Job) -> JobRecord | None:
    """Returns the record of a row, when it is the same job; None without a row.

    Raises:
        JobConflictError: It has other content.
    """
    if row is None:
        return None
    # As jobs, not as texts: those of an older version lack fields.
    known = job_of(row["content"])
    if content_of(known) != content_of(job):
        raise JobConflictError(_conflict(job, known))
    return record_of(row)


def _conflict(asked: Job, known: Job) -> str:
    names = [name for name, value in asdict(asked).items() if value != asdict(known)[name]]
    return (
        f"job {asked.job_id} was submitted again with another {', '.join(names)}; "
        "the same content or a new job id is accepted"
    )


def readable(job_id: str) -> str:
    """Returns an id that SQLite can be asked for, whatever somebody has sent."""
    return job_id.encode("utf-8", "replace").decode()


def row_of(database: sqlite3.Connection, job_id: str) -> sqlite3.Row | None:
    """Returns the row of a job inside a transaction; None = there is none."""
    query = "SELECT * FROM jobs WHERE job_id = ?"
    found: sqlite3.Row | None = database.execute(query, (readable(job_id),)).fetchone()
    return found


def stored(database: sqlite3.Connection, job_id: str) -> JobRecord:
    """Returns a job inside a transaction.

    Raises:
        JobUnknownError: There is none of that id.
    """
    row = row_of(database, job_id)
    return record_of(first_of([] if row is None else [row], job_id))


def first_of(rows: list[sqlite3.Row], job_id: str) -> sqlite3.Row:
    """Returns the first row.

    Raises:
        JobUnknownError: There is none.
    """
    if not rows:
        raise JobUnknownError(f"job {job_id[:80]!a} was asked for; there is none of that id")
    return rows[0]


def finished(record: JobRecord, what: str) -> JobRecord:
    """Returns a record that is over.

    Raises:
        JobConflictError: It is not.
    """
    if not is_over(record.state):
        raise JobConflictError(
            f"job {record.job.job_id} was to be {what}, but is {record.state.title}; one that is "
            "over is accepted"
        )
    return record


def write(database: sqlite3.Connection, record: JobRecord) -> None:
    """Writes how far a job is."""
    assignments = ", ".join(f"{name} = ?" for name in FIELDS)
    database.execute(
        f"UPDATE jobs SET {assignments} WHERE job_id = ?",  # noqa: S608
        (*values_of(record), record.job.job_id),
    )


def remember(database: sqlite3.Connection, record: JobRecord, reason: str) -> None:
    """Adds an entry to the history of a job."""
    database.execute(
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
