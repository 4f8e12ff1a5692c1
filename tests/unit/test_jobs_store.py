"""Job store: idempotent, consistent, safe against being killed."""

import json
import math
import os
import random
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from skinplan.errors import (
    InputError,
    JobCommandError,
    JobConflictError,
    JobInvalidError,
    JobQueueFullError,
    JobStoreError,
    JobTextError,
    JobUnknownError,
)
from skinplan.jobs.checks import check_command, check_job, new_job_id
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


def test_of_the_same_priority_the_earliest_start_comes_first(tmp_path: Path) -> None:
    store = JobStore(tmp_path / "jobs.db", clock=lambda: 1_000)
    for name, priority, earliest in (
        ("late", 0, 900), ("early", 0, 500), ("first", 0, 0), ("urgent", 5, 950), ("then", 9, 2_000)
    ):  # fmt: skip
        store.submit(replace(JOB, job_id=name, priority=priority, earliest_start_ns=earliest))
    order = []
    for now_ns in (*[1_000] * 4, 1_999, 2_000):
        record = store.next_to_run(now_ns)
        order.append(None if record is None else record.job.job_id)
        if record is not None:
            running = store.update(replace(record, state=JobState.RUNNING))
            store.update(replace(running, state=JobState.ENDED))
    assert order == ["urgent", "first", "early", "late", None, "then"]
    store.close()


def test_no_more_jobs_wait_than_may(store: JobStore) -> None:
    for name in ("a", "b"):
        store.submit(replace(JOB, job_id=name), queue_max=2)
    with pytest.raises(JobQueueFullError, match="2 jobs wait"):
        store.submit(replace(JOB, job_id="c"), queue_max=2)
    assert store.submit(replace(JOB, job_id="b"), queue_max=2).job.job_id == "b", "it waits already"
    store.update(replace(store.get("a"), state=JobState.RUNNING))
    store.submit(replace(JOB, job_id="c"), queue_max=2)


def finish(store: JobStore, job_id: str, result: dict | None = None) -> None:
    store.submit(replace(JOB, job_id=job_id))
    record = store.update(replace(store.get(job_id), state=JobState.RUNNING))
    store.finish(replace(record, state=JobState.ENDED), result)


def test_the_result_stays_with_the_job(store: JobStore) -> None:
    finish(store, "a", {"measured": {"area_ratio": 0.5, "worst": float("nan")}})
    finish(store, "b")
    assert json.loads(store.result("a")) == {"measured": {"area_ratio": 0.5, "worst": None}}
    assert store.result("b") == ""
    with pytest.raises(JobUnknownError):
        store.result("c")


def test_what_was_cleared_is_listed_no_more_but_kept(store: JobStore) -> None:
    finish(store, "a", {"n": 1})
    store.submit(replace(JOB, job_id="b"))
    with pytest.raises(JobConflictError, match="AllowedToStart"):
        store.clear("b")
    assert store.clear("a", "fetched by Anna").cleared
    assert store.clear("a").cleared, "a second time changes nothing"
    assert [r.job.job_id for r in store.list(include_cleared=False)] == ["b"]
    assert [r.job.job_id for r in store.list()] == ["b", "a"]
    assert [e.reason for e in store.history("a")][-1] == "fetched by Anna"
    assert store.submit(replace(JOB, job_id="a")).cleared, "still the same job"
    with pytest.raises(JobConflictError):
        store.submit(replace(JOB, job_id="a", serial_number="other"))


def test_jobs_come_in_pages_and_by_state(store: JobStore) -> None:
    for number in range(5):
        finish(store, f"e{number}")
        store.submit(replace(JOB, job_id=f"w{number}"))
        store.update(replace(store.get(f"w{number}"), state=JobState.NOT_ALLOWED_TO_START))
    first = store.list(3, states=(JobState.ENDED,))
    assert [r.job.job_id for r in first] == ["e4", "e3", "e2"]
    rest = store.list(3, before="e2", states=(JobState.ENDED, 99, 255))
    assert [r.job.job_id for r in rest] == ["e1", "e0"]
    with pytest.raises(JobUnknownError):
        store.list(before="nobody")


def test_old_jobs_and_the_oldest_of_too_many_are_forgotten(tmp_path: Path) -> None:
    times = iter(range(1000, 10_000))
    store = JobStore(tmp_path / "jobs.db", clock=lambda: next(times))
    for number in range(6):
        finish(store, f"e{number}", {"n": number})
    store.submit(replace(JOB, job_id="waits"))
    old_ns = store.get("e1").changed_ns + 1
    assert store.retain(oldest_ns=old_ns) == 2
    assert [r.job.job_id for r in store.list()] == ["waits", "e5", "e4", "e3", "e2"]
    store.clear("e4")
    assert store.retain(most=2) == 2, "the acknowledged one first, then the oldest"
    assert [r.job.job_id for r in store.list()] == ["waits", "e5", "e3"]
    with sqlite3.connect(store.path) as database:
        left = database.execute("SELECT job_id FROM results ORDER BY job_id").fetchall()
        entries = database.execute("SELECT DISTINCT job_id FROM history").fetchall()
    database.close()
    assert left == [("e3",), ("e5",)] and len(entries) == 3, "with results and histories"
    assert store.retain(most=2) == 0
    store.close()


def test_a_copy_leaves_the_file_alone_and_sees_one_moment(tmp_path: Path) -> None:
    path = tmp_path / "jobs.db"
    with JobStoreOfVersion1(path) as database:
        database.execute("INSERT INTO jobs VALUES (1, ?, ?, 0, 2, 'scanning', 1, 2, 0.5, NULL, "
                         "'/runs/job-1', 1, '', 7)", ("job-1", content_of(JOB)))  # fmt: skip
    before = path.read_bytes()
    copy = JobStore(path, copy=True)
    assert copy.get("job-1").station_count == 2 and copy.history("job-1") == ()
    copy.close()
    assert path.read_bytes() == before
    with pytest.raises(InputError, match="no such file"):
        JobStore(tmp_path / "other.db", copy=True)
    assert not (tmp_path / "other.db").exists()


def test_a_store_that_can_t_be_written_is_named_and_nothing_is_half_done(store: JobStore) -> None:
    store.submit(JOB)
    other = sqlite3.connect(store.path, isolation_level=None)
    other.execute("PRAGMA journal_mode = WAL")
    other.execute("CREATE TRIGGER full BEFORE INSERT ON history BEGIN "
                  "SELECT RAISE(ABORT, 'the disk is full'); END")  # fmt: skip
    with pytest.raises(JobStoreError, match="disk is full"):
        store.update(replace(store.get("job-1"), state=JobState.RUNNING))
    assert store.get("job-1").state is JobState.ALLOWED_TO_START
    other.execute("DROP TRIGGER full")
    other.close()
    store.update(replace(store.get("job-1"), state=JobState.RUNNING))


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


def test_a_store_of_the_second_version_is_brought_up_to_date(tmp_path: Path) -> None:
    path = tmp_path / "jobs.db"
    old = json.loads(content_of(JOB))
    for key in ("part_id", "recipe_version", "earliest_start_ns", "accept_due_calibration"):
        del old[key]
    with JobStoreOfVersion1(path) as database:
        database.execute("ALTER TABLE jobs ADD COLUMN rescan INTEGER NOT NULL DEFAULT 0")
        database.execute("PRAGMA user_version = 2")
        text = json.dumps(old, sort_keys=True)
        database.execute("INSERT INTO jobs VALUES (1, 'job-1', ?, 0, 4, '', 1, 2, 1.0, NULL, "
                         "'/runs/job-1', 1, '', 7, 1)", (text,))  # fmt: skip
        database.execute("INSERT INTO history VALUES (1, 'job-1', 7, 4, '', 1, 'done')")
    store = JobStore(path)
    found = store.get("job-1")
    assert (found.rescan, found.step, found.cleared, found.job.part_id) == (1, 0, False, "")
    assert store.submit(JOB).state is JobState.ENDED, (
        "the same content, although it has more fields"
    )
    assert [entry.reason for entry in store.history("job-1")] == ["done"]
    assert store.clear("job-1").cleared and store.result("job-1") == ""
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


WRITER = """
import sys
from dataclasses import replace
from skinplan.jobs.model import Job, JobState
from skinplan.jobs.store import JobStore
store, first = JobStore(sys.argv[1]), int(sys.argv[2])
for i in range(first, first + 100000):
    record = store.submit(Job(f"job-{i}", "/p.yaml", attributes=(("n", str(i)),)))
    record = store.update(replace(record, state=JobState.RUNNING, sub_state="driving"))
    record = store.update(replace(record, sub_state="scanning", station=1, progress=0.5))
    record = store.finish(
        replace(record, state=JobState.ENDED, sub_state="", progress=1.0), {"number": i}
    )
    if i % 3 == 0:
        store.clear(record.job.job_id)
    if i == first + 2:
        print("go", flush=True)
"""


def kill_a_writer(path: Path, first: int, after_s: float) -> None:
    """Ends a process that writes into a store, after it has begun to."""
    command = [sys.executable, "-c", WRITER, str(path), str(first)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "go\n"
    time.sleep(after_s)
    os.kill(process.pid, signal.SIGKILL)
    process.wait(10)


def check_whole(path: Path) -> None:
    """Every job is in the state of its last change, with every change and its result."""
    with sqlite3.connect(path) as database:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    database.close()
    store = JobStore(path)
    places = [
        (JobState.ALLOWED_TO_START, ""),
        (JobState.RUNNING, "driving"),
        (JobState.RUNNING, "scanning"),
        (JobState.ENDED, ""),
    ]
    for record in store.list():
        job_id = record.job.job_id
        history = store.history(job_id)
        walked = [(entry.state, entry.sub_state) for entry in history][: len(places)]
        assert walked == places[: len(walked)], job_id
        assert history[-1].state == record.state
        assert len(history) == len(walked) + (1 if record.cleared else 0)
        result = store.result(job_id)
        assert (result != "") == (record.state is JobState.ENDED), job_id
        assert result in ("", f'{{"number": {dict(record.job.attributes)["n"]}}}')
    store.close()


@pytest.mark.parametrize("rounds", [3, pytest.param(60, marks=pytest.mark.long)])
def test_killed_processes_leave_a_consistent_store(tmp_path: Path, rounds: int) -> None:
    path, rng = tmp_path / "jobs.db", random.Random(rounds)
    for number in range(rounds):
        kill_a_writer(path, number * 1_000_000, rng.uniform(0.0, 0.05))
        check_whole(path)
    store = JobStore(path)
    assert len(store.list()) >= 3 * rounds
    unfinished = store.list(states=(JobState.ALLOWED_TO_START, JobState.RUNNING))
    assert len(unfinished) <= rounds, "one at most of each process"
    store.close()


def test_a_migration_that_is_killed_begins_anew(tmp_path: Path) -> None:
    path = tmp_path / "jobs.db"
    with JobStoreOfVersion1(path) as database:
        for i in range(50):
            row = (i + 1, f"j{i}", content_of(replace(JOB, job_id=f"j{i}")))
            database.execute("INSERT INTO jobs VALUES (?, ?, ?, 0, 0, '', 0, 0, 0.0, NULL, '', 1, "
                             "'', 7)", row)  # fmt: skip
    script = f"from skinplan.jobs.store import JobStore; JobStore({str(path)!r})"
    for delay_s in (0.12, 0.16, 0.2, 0.24):
        process = subprocess.Popen([sys.executable, "-c", script])
        time.sleep(delay_s)
        process.kill()
        process.wait(10)
        with sqlite3.connect(path) as database:
            version = database.execute("PRAGMA user_version").fetchone()[0]
            columns = [row[1] for row in database.execute("PRAGMA table_info(jobs)")]
        database.close()
        assert (version == 1) == ("rescan" not in columns) == ("cleared" not in columns)
    store = JobStore(path)
    assert len(store.list()) == 50 and not store.get("j7").cleared
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
        ("earliest_start_ns", -1),
        ("earliest_start_ns", 2**31 * 1_000_000_000),
        ("part_id", "x" * 129),
        ("recipe_version", "1\r2"),
        ("serial_number", "SN\u202e7"),
        ("attributes", (("", "x"),)),
        ("attributes", (("a", "1"), ("a", "2"))),
        ("attributes", (("a", "x" * 1025),)),
        ("attributes", tuple((str(i), "") for i in range(65))),
    ],
)
def test_fields_out_of_range_are_named(store: JobStore, field: str, value: object) -> None:
    with pytest.raises(
        JobInvalidError, match=field.rstrip("s").split("_sha")[0].removesuffix("_n")
    ):
        store.submit(replace(JOB, **{field: value}))
    assert store.list() == ()


def test_texts_have_an_error_of_their_own() -> None:
    for change in ({"order_id": "x" * 129}, {"attributes": (("k", "a\x07"),)}):
        with pytest.raises(JobTextError):
            check_job(replace(JOB, **change))
    check_command("Anna", "x" * 256)
    for operator, reason in (("Anna", "x" * 257), ("Anna", "a\nb"), ("A\x1b[2J", "")):
        with pytest.raises(JobTextError):
            check_command(operator, reason)


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
