"""Job store: idempotent, consistent, safe against being killed."""

import math
import os
import random
import signal
import sqlite3
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from skinplan.errors import (
    InputError,
    JobCommandError,
    JobConflictError,
    JobInvalidError,
    JobUnknownError,
)
from skinplan.jobs.checks import check_job, new_job_id
from skinplan.jobs.model import Job, JobCommand, JobRecord, JobState
from skinplan.jobs.rows import content_of
from skinplan.jobs.states import COMMANDS, TRANSITIONS, apply_command, check_transition
from skinplan.jobs.store import JobStore

JOB = Job(
    "job-1", "/parts/scene4.yaml", "a" * 64, "order 5", "SN-7", "Anna", 0, (("b", "2"), ("a", "1"))
)


@pytest.fixture
def store(tmp_path: Path) -> Iterator[JobStore]:
    opened = JobStore(tmp_path / "jobs.db")
    yield opened
    opened.close()


def test_what_is_submitted_is_found(store: JobStore) -> None:
    record = store.submit(JOB)
    assert record.state == JobState.ALLOWED_TO_START
    assert replace(store.get("job-1"), time_left_s=0.0).job.serial_number == "SN-7"
    assert math.isnan(store.get("job-1").time_left_s)
    assert sorted(store.get("job-1").job.attributes) == sorted(JOB.attributes)
    assert [r.job.job_id for r in store.list()] == ["job-1"]


def test_the_same_again_is_the_same_job(store: JobStore) -> None:
    store.submit(JOB)
    running = store.update(replace(store.get("job-1"), state=JobState.RUNNING, progress=0.4))
    again = store.submit(replace(JOB, attributes=tuple(reversed(JOB.attributes))))
    assert again.state == running.state and again.progress == 0.4
    assert len(store.list()) == 1
    assert [e.state for e in store.history("job-1")] == [
        JobState.ALLOWED_TO_START,
        JobState.RUNNING,
    ]


@pytest.mark.parametrize("change", [{"serial_number": "SN-8"}, {"priority": 3}, {"attributes": ()}])
def test_other_content_under_the_same_id_is_refused(store: JobStore, change: dict) -> None:
    store.submit(JOB)
    with pytest.raises(JobConflictError, match=next(iter(change))):
        store.submit(replace(JOB, **change))
    assert store.get("job-1").job.serial_number == "SN-7"


def test_unknown_jobs_are_named(store: JobStore) -> None:
    for call in (store.get, store.history, store.remove):
        with pytest.raises(JobUnknownError, match="job-9"):
            call("job-9")
    with pytest.raises(JobUnknownError):
        store.update(JobRecord(JOB, JobState.RUNNING))
    with pytest.raises(JobUnknownError):
        store.get("\ud800")


def test_priority_then_first_come(store: JobStore) -> None:
    for name, priority in (("a", 0), ("b", 5), ("c", 5), ("d", -1)):
        store.submit(replace(JOB, job_id=name, priority=priority))
    store.submit(replace(JOB, job_id="held", priority=100), allowed_to_start=False)
    order = []
    while (record := store.next_to_run()) is not None:
        store.update(replace(record, state=JobState.RUNNING))
        assert store.next_to_run() is None, "one job at a time"
        current = store.current()
        assert current is not None and current.job.job_id == record.job.job_id
        store.update(replace(record, state=JobState.ENDED))
        order.append(record.job.job_id)
    assert order == ["b", "c", "a", "d"]


def test_history_has_states_sub_states_and_stations_but_not_progress(tmp_path: Path) -> None:
    times = iter(range(1000, 2000))
    store = JobStore(tmp_path / "jobs.db", clock=lambda: next(times))
    store.submit(JOB)
    record = replace(store.get("job-1"), state=JobState.RUNNING, sub_state="scanning", station=1)
    store.update(record, "began")
    store.update(replace(record, progress=0.5))
    store.update(replace(record, station=2))
    store.update(
        replace(record, state=JobState.ABORTED, sub_state="", error_code=603, error="arm lost")
    )
    entries = store.history("job-1")
    assert [(e.state.title, e.sub_state, e.station, e.reason) for e in entries] == [
        ("AllowedToStart", "", 0, "submitted"),
        ("Running", "scanning", 1, "began"),
        ("Running", "scanning", 2, ""),
        ("Aborted", "", 1, "arm lost"),
    ]
    assert [e.at_ns for e in entries] == sorted(e.at_ns for e in entries)
    assert store.get("job-1").error_code == 603
    store.close()


def test_a_job_that_is_over_stays_over_and_can_be_removed(store: JobStore) -> None:
    store.submit(JOB)
    with pytest.raises(JobConflictError, match="AllowedToStart"):
        store.remove("job-1")
    aborted = store.update(replace(store.get("job-1"), state=JobState.ABORTED))
    with pytest.raises(JobCommandError, match="over"):
        store.update(replace(aborted, state=JobState.RUNNING))
    store.remove("job-1")
    assert store.list() == ()
    assert store.submit(replace(JOB, serial_number="other")).job.serial_number == "other"
    assert len(store.history("job-1")) == 1


def test_the_order_can_t_be_changed_by_an_update(store: JobStore) -> None:
    store.submit(JOB)
    record = store.update(JobRecord(replace(JOB, operator_name="Eve"), JobState.RUNNING))
    assert record.job.operator_name == store.get("job-1").job.operator_name == "Anna"


def test_what_was_running_is_still_on_the_cell_after_a_restart(tmp_path: Path) -> None:
    first = JobStore(tmp_path / "jobs.db")
    first.submit(JOB)
    first.submit(replace(JOB, job_id="job-2"))
    first.update(replace(first.get("job-1"), state=JobState.RUNNING, rescan=1))
    second = JobStore(tmp_path / "jobs.db")
    left = second.current()
    assert left is not None and (left.job.job_id, left.rescan) == ("job-1", 1)
    assert second.next_to_run() is None
    second.update(replace(left, state=JobState.INTERRUPTED), "started anew")
    second.update(replace(left, state=JobState.RUNNING))
    second.update(replace(left, state=JobState.ENDED))
    found = second.next_to_run()
    assert found is not None and found.job.job_id == "job-2"
    first.close()
    second.close()


def test_a_store_of_the_first_version_is_brought_up_to_date(tmp_path: Path) -> None:
    path = tmp_path / "jobs.db"
    with JobStoreOfVersion1(path) as database:
        database.execute("INSERT INTO jobs VALUES (1, ?, ?, 0, 2, 'scanning', 1, 2, 0.5, NULL, "
                         "'/runs/job-1', 1, '', 7)", ("job-1", content_of(JOB)))  # fmt: skip
    store = JobStore(path)
    found = store.current()
    assert found is not None
    assert (found.sub_state, found.station_count, found.rescan) == ("scanning", 2, 0)
    store.update(replace(found, rescan=2))
    assert JobStore(path).get("job-1").rescan == 2
    store.close()


class JobStoreOfVersion1:
    """The tables as they were, written out."""

    def __init__(self, path: Path) -> None:
        self._database = sqlite3.connect(path)
        self._database.executescript(
            "CREATE TABLE jobs (number INTEGER PRIMARY KEY AUTOINCREMENT, job_id TEXT NOT NULL "
            "UNIQUE, content TEXT NOT NULL, priority INTEGER NOT NULL, state INTEGER NOT NULL, "
            "sub_state TEXT NOT NULL, station INTEGER NOT NULL, station_count INTEGER NOT NULL, "
            "progress REAL NOT NULL, time_left_s REAL, run_folder TEXT NOT NULL, error_code "
            "INTEGER NOT NULL, error TEXT NOT NULL, changed_ns INTEGER NOT NULL);"
            "CREATE TABLE history (number INTEGER PRIMARY KEY AUTOINCREMENT, job_id TEXT NOT NULL "
            "REFERENCES jobs(job_id) ON DELETE CASCADE, at_ns INTEGER NOT NULL, state INTEGER NOT "
            "NULL, sub_state TEXT NOT NULL, station INTEGER NOT NULL, reason TEXT NOT NULL);"
            "PRAGMA user_version = 1;"
        )

    def __enter__(self) -> sqlite3.Connection:
        return self._database

    def __exit__(self, *_: object) -> None:
        self._database.commit()
        self._database.close()


def test_threads_submit_the_same_job_once(store: JobStore) -> None:
    errors: list[Exception] = []

    def work(seed: int) -> None:
        rng = random.Random(seed)
        for _ in range(40):
            number = rng.randrange(10)
            try:
                store.submit(replace(JOB, job_id=f"job-{number}", priority=number))
            except Exception as error:
                errors.append(error)

    threads = [threading.Thread(target=work, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert errors == []
    assert sorted(r.job.job_id for r in store.list()) == [f"job-{i}" for i in range(10)]
    assert all(len(store.history(r.job.job_id)) == 1 for r in store.list())
    assert len(store.list(limit=3)) == 3


def test_a_killed_process_leaves_a_consistent_store(tmp_path: Path) -> None:
    script = f"""
from dataclasses import replace
from skinplan.jobs.model import Job, JobState
from skinplan.jobs.store import JobStore
store = JobStore({str(tmp_path / "jobs.db")!r})
for i in range(100000):
    record = store.submit(Job(f"job-{{i}}", "/p.yaml"))
    record = store.update(replace(record, state=JobState.RUNNING))
    record = store.update(replace(record, state=JobState.ENDED))
    if i == 5:
        print("go", flush=True)
"""
    process = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "go\n"
    os.kill(process.pid, signal.SIGKILL)
    process.wait(10)
    store = JobStore(tmp_path / "jobs.db")
    records = store.list()
    assert len(records) >= 6
    for record in records:
        assert store.history(record.job.job_id)[-1].state == record.state
    assert all(r.state == JobState.ENDED for r in records[1:])
    store.close()


def test_files_that_are_no_store_are_named(tmp_path: Path) -> None:
    (tmp_path / "text.db").write_text("this is no database " * 100)
    with pytest.raises(InputError, match=r"text\.db"):
        JobStore(tmp_path / "text.db")
    JobStore(tmp_path / "new.db").close()
    with sqlite3.connect(tmp_path / "new.db") as database:
        database.execute("PRAGMA user_version = 99")
    with pytest.raises(InputError, match="version 99"):
        JobStore(tmp_path / "new.db")
    with pytest.raises(InputError, match="store"):
        JobStore(tmp_path / "text.db" / "jobs.db")


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("job_id", ""),
        ("job_id", "a b"),
        ("job_id", "../x"),
        ("job_id", ".."),
        ("job_id", "x" * 65),
        ("job_id", "job\n"),
        ("part_uri", ""),
        ("part_uri", "scene4.yaml"),
        ("part_uri", "http://host/part.yaml"),
        ("part_uri", "/" + "x" * 1024),
        ("mesh_sha256", "A" * 64),
        ("mesh_sha256", "abc"),
        ("order_id", "x" * 129),
        ("serial_number", "a\x00b"),
        ("operator_name", "a\nb"),
        ("priority", 1001),
        ("priority", -1001),
        ("attributes", (("", "x"),)),
        ("attributes", (("a", "1"), ("a", "2"))),
        ("attributes", (("a", "x" * 1025),)),
        ("attributes", tuple((str(i), "") for i in range(65))),
    ],
)
def test_fields_out_of_range_are_named(store: JobStore, field: str, value: object) -> None:
    with pytest.raises(JobInvalidError, match=field.rstrip("s").split("_sha")[0]):
        store.submit(replace(JOB, **{field: value}))
    assert store.list() == ()


def test_legal_extremes_pass() -> None:
    extreme = Job(
        "x" * 64,
        "file:///parts/a.yaml",
        "",
        "x" * 128,
        "<script>",
        "Zoë 中文",
        1000,
        (("k" * 128, "v" * 1024),),
    )
    assert check_job(extreme) is extreme


def test_new_ids_are_legal_different_and_sort_by_time() -> None:
    ids = {new_job_id(1e9 + i // 10) for i in range(50)}
    assert len(ids) == 50
    for job_id in ids:
        check_job(replace(JOB, job_id=job_id))
    assert new_job_id(1e9) < new_job_id(2e9)


@pytest.mark.parametrize("command", list(JobCommand))
@pytest.mark.parametrize("state", list(JobState))
def test_commands_lead_along_transitions_or_are_refused(
    command: JobCommand, state: JobState
) -> None:
    record = JobRecord(JOB, state)
    if state in COMMANDS[command]:
        after = apply_command(record, int(command))
        check_transition("job-1", state, after)
        assert after == COMMANDS[command][state]
    else:
        with pytest.raises(JobCommandError, match=command.name):
            apply_command(record, command)


def test_a_command_that_does_not_exist_is_named() -> None:
    for number in (0, 8, 255):
        with pytest.raises(JobCommandError, match="START"):
            apply_command(JobRecord(JOB, JobState.RUNNING), number)


def test_every_state_is_reached_and_what_is_over_has_no_way_on() -> None:
    reached = {after for follows in TRANSITIONS.values() for after in follows}
    assert reached == set(JobState)
    assert {state for state, follows in TRANSITIONS.items() if not follows} == {
        JobState.ENDED,
        JobState.ABORTED,
    }
    for before in JobState:
        for after in set(JobState) - TRANSITIONS[before] - {before}:
            with pytest.raises(JobCommandError, match="follows"):
                check_transition("job-1", before, after)
