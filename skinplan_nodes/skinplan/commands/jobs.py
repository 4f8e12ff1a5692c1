"""``skinplan jobs``: what a cell has measured, measures and is to measure, from its job store.

The store is looked at as a copy of one moment: the cell may run meanwhile, and a store of an older
version stays as it is.
"""

import csv
import json
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from skinplan import console
from skinplan.errors import InputError
from skinplan.jobs.documents import TABLE_COLUMNS, job_document, job_row
from skinplan.jobs.model import JobRecord, JobState
from skinplan.jobs.store import JobStore
from skinplan.json_file import write_json

jobs_app = typer.Typer(no_args_is_help=True, help="List, show and export the jobs of a cell.")

STORE = "jobs.sqlite"
_TITLES = {state.title.lower(): state for state in JobState}

RunsOption = Annotated[
    Path, typer.Option("--runs", help="Folder of the runs with jobs.sqlite, or a job store.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout.")]
JobArgument = Annotated[str, typer.Argument(help="Id of the job.", show_default=False)]
StateOption = Annotated[
    list[str] | None, typer.Option("--state", help="Only jobs in this state, e.g. Ended.")
]


@jobs_app.command("list")
def list_jobs(
    runs: RunsOption = Path("runs"),
    state: StateOption = None,
    limit: Annotated[int, typer.Option(min=0, help="At most so many; 0 = all.")] = 50,
    as_json: JsonOption = False,
) -> None:
    """List jobs, newest first."""
    with console.command(as_json), _opened(runs) as store:
        found = store.list(limit, states=_states(state))
        if as_json:
            console.print_json({"jobs": [job_row(record) for record in found]})
            return
        rows = [
            (
                record.job.job_id,
                record.job.serial_number,
                _state(record),
                f"{record.progress:.0%}",
                _time(record.changed_ns),
                record.error,
            )
            for record in found
        ]
        header = ("job", "serial number", "state", "done", "last change (UTC)", "error")
        console.print_table(f"Jobs of {store.path}", header, rows)


@jobs_app.command()
def show(job_id: JobArgument, runs: RunsOption = Path("runs"), as_json: JsonOption = False) -> None:
    """Show a job: the order, its history, what it came to."""
    with console.command(as_json), _opened(runs) as store:
        document = job_document(store, job_id)
        if as_json:
            console.print_json(document)
            return
        order = [(key, _text(value)) for key, value in document["job"].items()]
        console.print_table(f"Job {job_id}", ("field", "value"), order)
        now = [(key, _text(value)) for key, value in document["status"].items()]
        console.print_table("Now", ("field", "value"), now)
        rows = [
            (entry["time"], entry["state"], entry["sub_state"], entry["station"], entry["reason"])
            for entry in document["history"]
        ]
        header = ("time (UTC)", "state", "step", "station", "reason")
        console.print_table("History", header, rows)
        result = document["result"] or {}
        for key in ("measured", "timing_s"):
            if isinstance(result.get(key), dict):
                facts = [(name, _text(value)) for name, value in result[key].items()]
                console.print_table(key, ("figure", "value"), facts)
        calibrations = [
            (fact["name"], fact["state"], fact["date"], fact["due"], _text(fact["residual"]))
            for fact in result.get("calibration", [])
        ]
        if calibrations:
            header = ("calibration", "state", "date", "due", "residual")
            console.print_table("Calibration", header, calibrations)


@jobs_app.command()
def export(
    out: Annotated[Path, typer.Argument(help="File to write: .json or .csv.", show_default=False)],
    runs: RunsOption = Path("runs"),
    state: StateOption = None,
    as_json: JsonOption = False,
) -> None:
    """Write jobs to a file: JSON with histories and results, or CSV with a line for each job."""
    with console.command(as_json), _opened(runs) as store:
        if out.suffix.lower() not in (".json", ".csv"):
            raise InputError(f"{out} was to be written; .json and .csv are accepted")
        found = store.list(states=_states(state))[::-1]
        out.parent.mkdir(parents=True, exist_ok=True)
        if out.suffix.lower() == ".json":
            documents = [job_document(store, record.job.job_id) for record in found]
            write_json(out, {"version": 1, "jobs": documents})
        else:
            _write_csv(out, found)
        if as_json:
            console.print_json({"file": str(out), "jobs": len(found)})
        else:
            typer.echo(f"{out}: {len(found)} jobs")


@contextmanager
def _opened(runs: Path) -> Iterator[JobStore]:
    store = JobStore(runs / STORE if runs.is_dir() else runs, copy=True)
    try:
        yield store
    finally:
        store.close()


def _states(names: list[str] | None) -> list[JobState]:
    unknown = [name for name in names or [] if name.lower() not in _TITLES]
    if unknown:
        accepted = ", ".join(state.title for state in JobState)
        raise InputError(f"state {unknown[0]!r} was asked for; accepted are {accepted}")
    return [_TITLES[name.lower()] for name in names or []]


def _write_csv(out: Path, records: tuple[JobRecord, ...]) -> None:
    with out.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, TABLE_COLUMNS)
        writer.writeheader()
        for record in records:
            writer.writerow({key: _cell(value) for key, value in job_row(record).items()})


def _cell(value: Any) -> Any:
    """A text that a spreadsheet would take for a formula is written as text."""
    return f"'{value}" if isinstance(value, str) and value[:1] in ("=", "+", "-", "@") else value


def _state(record: JobRecord) -> str:
    title = record.state.title
    if record.sub_state:
        title += f", {record.sub_state}"
    return f"{title}, cleared" if record.cleared else title


def _time(at_ns: int) -> str:
    return datetime.fromtimestamp(at_ns / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S")


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
