"""``skinplan jobs``: lists, shows and exports what a job store has, hostile texts included."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from skinplan.cli import app
from skinplan.jobs.model import Job, JobState
from skinplan.jobs.store import JobStore

runner = CliRunner()
HOSTILE = "[red]<b>=1+1</b>"


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    store = JobStore(tmp_path / "jobs.sqlite")
    done = store.submit(Job("done", "/p.yaml", order_id="A1", serial_number=HOSTILE))
    store.update(replace(done, state=JobState.RUNNING, sub_state="scanning", station=1))
    facts = [{"name": "tool", "state": "due", "date": "", "due": "2026-01-01", "residual": None}]
    result = {"measured": {"area_ratio": 0.99}, "calibration": facts}
    store.finish(replace(store.get("done"), state=JobState.ENDED, sub_state=""), result)
    store.submit(Job("waits", "/p.yaml", serial_number="=cmd", attributes=(("k", "v"),)))
    store.close()
    return tmp_path


def invoke(*arguments: object) -> object:
    return runner.invoke(app, ["jobs", *map(str, arguments)])


def test_lists_newest_first_and_by_state(runs: Path) -> None:
    rows = json.loads(invoke("list", "--runs", runs, "--json").stdout)["jobs"]
    assert [(row["job_id"], row["state"]) for row in rows] == [
        ("waits", "AllowedToStart"),
        ("done", "Ended"),
    ]
    ended = invoke("list", "--runs", runs / "jobs.sqlite", "--state", "ended", "--json")
    assert [row["job_id"] for row in json.loads(ended.stdout)["jobs"]] == ["done"]
    text = invoke("list", "--runs", runs).stdout
    assert "done" in text and "[red]" in text, "shown as it is"


def test_shows_order_history_and_result(runs: Path) -> None:
    document = json.loads(invoke("show", "done", "--runs", runs, "--json").stdout)
    assert document["job"]["order_id"] == "A1"
    assert [entry["state"] for entry in document["history"]] == [
        "AllowedToStart",
        "Running",
        "Ended",
    ]
    assert document["result"]["measured"]["area_ratio"] == 0.99
    text = invoke("show", "done", "--runs", runs).stdout
    assert "0.99" in text and "Calibration" in text and "2026-01-01" in text


def test_exports_json_and_csv(runs: Path, tmp_path: Path) -> None:
    assert invoke("export", tmp_path / "jobs.json", "--runs", runs).exit_code == 0
    document = json.loads((tmp_path / "jobs.json").read_text())
    assert [job["job"]["job_id"] for job in document["jobs"]] == ["done", "waits"]
    assert document["jobs"][0]["job"]["serial_number"] == HOSTILE
    assert invoke("export", tmp_path / "jobs.csv", "--runs", runs).exit_code == 0
    with (tmp_path / "jobs.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["job_id"] for row in rows] == ["done", "waits"]
    assert rows[1]["serial_number"] == "'=cmd", "no formula for a spreadsheet"


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("show", "none"), "none"),
        (("list", "--state", "Gone"), "AllowedToStart"),
        (("export", "jobs.pdf"), ".csv"),
    ],
)
def test_bad_input_is_named(runs: Path, arguments: tuple[str, ...], named: str) -> None:
    result = invoke(*arguments, "--runs", runs)
    assert result.exit_code == 2 and named in result.stderr
    assert "Traceback" not in result.stderr


def test_a_missing_store_is_named_and_not_made(tmp_path: Path) -> None:
    result = invoke("list", "--runs", tmp_path)
    assert result.exit_code == 2 and "jobs.sqlite" in result.stderr
    assert not (tmp_path / "jobs.sqlite").exists()
