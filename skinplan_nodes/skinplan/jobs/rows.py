"""Jobs as rows of the store's tables."""

import json
import math
import sqlite3
from dataclasses import asdict, replace
from typing import Any

from skinplan.jobs.model import HistoryEntry, Job, JobRecord, JobState

TABLES = """
CREATE TABLE IF NOT EXISTS jobs (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    job_id TEXT NOT NULL UNIQUE,
    content TEXT NOT NULL,
    priority INTEGER NOT NULL,
    state INTEGER NOT NULL,
    sub_state TEXT NOT NULL,
    station INTEGER NOT NULL,
    station_count INTEGER NOT NULL,
    progress REAL NOT NULL,
    time_left_s REAL,
    run_folder TEXT NOT NULL,
    error_code INTEGER NOT NULL,
    error TEXT NOT NULL,
    changed_ns INTEGER NOT NULL,
    rescan INTEGER NOT NULL DEFAULT 0,
    step INTEGER NOT NULL DEFAULT 0,
    step_count INTEGER NOT NULL DEFAULT 0,
    earliest_start_ns INTEGER NOT NULL DEFAULT 0,
    cleared INTEGER NOT NULL DEFAULT 0
);
CREATE TABLE IF NOT EXISTS history (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    job_id TEXT NOT NULL REFERENCES jobs(job_id) ON DELETE CASCADE,
    at_ns INTEGER NOT NULL,
    state INTEGER NOT NULL,
    sub_state TEXT NOT NULL,
    station INTEGER NOT NULL,
    reason TEXT NOT NULL
);
CREATE TABLE IF NOT EXISTS results (
    job_id TEXT PRIMARY KEY REFERENCES jobs(job_id) ON DELETE CASCADE,
    at_ns INTEGER NOT NULL,
    document TEXT NOT NULL
);
CREATE INDEX IF NOT EXISTS history_of_job ON history(job_id, number);
CREATE INDEX IF NOT EXISTS jobs_by_state ON jobs(state, priority);
"""
SCHEMA_VERSION = 3
#: What makes a store of each older version one of the next version.
MIGRATIONS = {
    1: "ALTER TABLE jobs ADD COLUMN rescan INTEGER NOT NULL DEFAULT 0;",
    2: (
        "ALTER TABLE jobs ADD COLUMN step INTEGER NOT NULL DEFAULT 0;"
        "ALTER TABLE jobs ADD COLUMN step_count INTEGER NOT NULL DEFAULT 0;"
        "ALTER TABLE jobs ADD COLUMN earliest_start_ns INTEGER NOT NULL DEFAULT 0;"
        "ALTER TABLE jobs ADD COLUMN cleared INTEGER NOT NULL DEFAULT 0;"
    ),
}
# Columns of `jobs` that are fields of a record, in the order in which they are written.
FIELDS = (
    "state",
    "sub_state",
    "station",
    "station_count",
    "progress",
    "time_left_s",
    "run_folder",
    "error_code",
    "error",
    "changed_ns",
    "rescan",
    "step",
    "step_count",
    "cleared",
)


def content_of(job: Job) -> str:
    """Returns a job as text, which does not depend on the order of its attributes."""
    return json.dumps(
        asdict(replace(job, attributes=tuple(sorted(job.attributes)))), sort_keys=True
    )


def job_of(content: str) -> Job:
    """Returns the job of a text made by `content_of`, also by that of an older version."""
    fields: dict[str, Any] = json.loads(content)
    fields["attributes"] = tuple((key, value) for key, value in fields["attributes"])
    return Job(**fields)


def record_of(row: sqlite3.Row) -> JobRecord:
    """Returns the record of a row of `jobs`."""
    fields = {name: row[name] for name in FIELDS}
    fields["state"] = JobState(fields["state"])
    if fields["time_left_s"] is None:
        fields["time_left_s"] = math.nan
    fields["cleared"] = bool(fields["cleared"])
    return JobRecord(job=job_of(row["content"]), **fields)


def values_of(record: JobRecord) -> tuple[Any, ...]:
    """Returns the values of the columns `FIELDS`."""
    values = {name: getattr(record, name) for name in FIELDS}
    values["state"] = int(record.state)
    # SQLite has no NaN.
    values["time_left_s"] = record.time_left_s if math.isfinite(record.time_left_s) else None
    return tuple(values.values())


def place_of(record: JobRecord) -> tuple[JobState, str, int]:
    """Returns what the history keeps: state, sub-state, station."""
    return record.state, record.sub_state, record.station


def entry_of(row: sqlite3.Row) -> HistoryEntry:
    """Returns the entry of a row of `history`."""
    state = JobState(row["state"])
    return HistoryEntry(row["at_ns"], state, row["sub_state"], row["station"], row["reason"])
