"""The parts of the supervisor that need no graph: watch, switches, progress, run folder."""

import json
import os
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rclpy.task import Future
from skinplan_msgs.msg import Status

from skinplan.errors import JobInvalidError
from skinplan.jobs.model import Job, JobRecord, JobState
from skinplan.robot.cell import CellConfig
from skinplan.stations.model import SkippedPoint, Station, StationPlan
from skinplan.trajectory.model import SCAN, TRANSIT, Segment, StationTrajectory
from skinplan_nodes.supervisor.control import (
    AbortError,
    InterruptError,
    JobControl,
    Request,
    StepError,
)
from skinplan_nodes.supervisor.journal import Entry
from skinplan_nodes.supervisor.machine import Event
from skinplan_nodes.supervisor.progress import Progress
from skinplan_nodes.supervisor.run_data import Round
from skinplan_nodes.supervisor.run_folder import RunFolder
from skinplan_nodes.supervisor.time_left import TimeLeft
from skinplan_nodes.supervisor.timeline import timeline
from skinplan_nodes.supervisor.waiting import Waiter
from skinplan_nodes.supervisor.watch import NodeWatch, process_runs

CELL = CellConfig()


def test_watch_misses_what_it_never_saw() -> None:
    watch = NodeWatch(("a", "b"), silent_max_s=5.0)
    assert watch.missing() == ("a", "b")
    watch.beat("/cell1/a", 0.0)
    assert watch.missing() == ("b",)
    assert watch.lost(100.0) == "a"


def test_watch_loses_a_silent_node_and_finds_it_again() -> None:
    watch = NodeWatch(("a",), silent_max_s=5.0)
    watch.beat("a", 10.0)
    assert watch.lost(15.0) is None
    assert watch.lost(15.1) == "a"
    watch.beat("a", 16.0)
    assert watch.lost(16.5) is None


def test_watch_is_patient_with_a_busy_machine() -> None:
    watch = NodeWatch(("a", "b"), silent_max_s=5.0, process_runs=lambda pid: pid == 7)
    watch.beat("a", 0.0, pid=7)
    watch.beat("b", 0.0, pid=8)
    assert watch.lost(5.0) is None
    assert watch.lost(5.1) == "b", "its process is gone"
    assert not watch.is_lost("a", 20.0), "its process runs"
    assert watch.is_lost("a", 20.1), "it hangs"


def test_watch_names_a_dead_process_at_once_but_none_of_another_machine() -> None:
    running = {7, 8}
    watch = NodeWatch(("far", "a", "b"), process_runs=lambda pid: pid in running)
    watch.beat("far", 0.0, pid=99)
    watch.beat("a", 0.0, pid=7)
    watch.beat("b", 0.0, pid=8)
    assert watch.dead() is None, "nobody here knows the process of the far one"
    running.discard(8)
    assert watch.dead() == "b" and watch.lost(0.1) is None
    running.add(9)
    watch.beat("b", 0.2, pid=9)
    assert watch.dead() is None, "it was started again"


def test_a_dead_process_does_not_run() -> None:
    child = subprocess.Popen([sys.executable, "-S", "-c", ""])
    assert process_runs(os.getpid())
    deadline = time.monotonic() + 20.0
    while process_runs(child.pid):
        assert time.monotonic() < deadline, "a zombie does not count as running"
        time.sleep(0.01)
    child.wait()
    assert not process_runs(child.pid)
    assert not process_runs(0)


def test_watch_loses_a_node_that_left_the_graph() -> None:
    watch = NodeWatch(("a", "b"))
    for name in ("a", "b"):
        watch.beat(name, 0.0)
    watch.look(["a"])
    assert watch.lost(0.1) is None, "one look may be wrong"
    watch.look(["a"])
    assert watch.lost(0.2) == "b"


def test_watch_ignores_nodes_that_are_not_required() -> None:
    watch = NodeWatch(("a",))
    watch.beat("a", 0.0)
    watch.beat("player", 0.0)
    for _ in range(3):
        watch.look(["a"])
    assert watch.lost(1.0) is None


def test_who_asked_a_node_that_was_started_again_does_not_wait_for_its_answer() -> None:
    watch = NodeWatch(("a",), silent_max_s=5.0, process_runs=lambda _: True)
    watch.beat("a", time.monotonic(), pid=7)
    waiter = Waiter(
        time.monotonic,
        lambda name: watch.is_lost(name, time.monotonic()),
        lambda name: watch.pid(name, time.monotonic()),
    )
    answered = Future()
    answered.set_result("an answer")
    assert waiter.wall(answered, 60.0, "service s", "a") == "an answer"
    timer = threading.Timer(0.1, lambda: watch.beat("a", time.monotonic(), pid=8))
    timer.start()
    with pytest.raises(StepError, match="service s: node a was started again meanwhile") as found:
        waiter.wall(Future(), 60.0, "service s", "a")
    assert (found.value.code, found.value.node) == (Status.NODE_LOST, "a")
    timer.join()


def test_abort_keeps_the_first_reason_and_breaks_into_what_is_done() -> None:
    control = JobControl()
    control.check()
    control.abort(603, "node x was lost", "x")
    control.abort(804, "somebody asked")
    control.ask(Request(Event.PAUSE))
    with pytest.raises(AbortError, match="node x was lost") as caught:
        control.check()
    assert (caught.value.code, caught.value.node) == (603, "x")


def test_a_pause_breaks_in_until_it_is_taken_and_a_resume_takes_it_back() -> None:
    control = JobControl()
    control.ask(Request(Event.PAUSE, message="look"))
    with pytest.raises(InterruptError, match="look"):
        control.check()
    control.ask(Request(Event.RESUME))
    control.check()
    assert [control.take(), control.take()] == [Request(Event.RESUME), None]
    control.enter(lambda: None, frozenset({Event.PAUSE}))
    control.ask(Request(Event.PAUSE))
    control.check()


def test_a_state_that_lasts_too_long_breaks_in() -> None:
    control = JobControl()
    late = Request(Event.TIMED_OUT, 611, "too long")
    control.enter(lambda: late, frozenset())
    with pytest.raises(InterruptError, match="too long"):
        control.check()
    assert control.take() is late


def _two_stations() -> StationPlan:
    stations = tuple(Station(i, np.eye(4), np.arange(10)) for i in range(2))
    return StationPlan("rectangles", stations, 2, 0, False, 1.0, ())


def test_progress_never_falls_and_time_left_shrinks() -> None:
    progress = Progress().at_state("planning", 0).reached(0.1).planned(_two_stations(), CELL)
    first = progress.at_state("driving", 1).reached(0.05)
    assert first.share == 0.1
    assert first.title == "driving at station 1 of 2"
    second = first.at_state("driving", 2)
    assert 0.0 < second.time_left_s < first.time_left_s


def test_what_a_station_took_corrects_what_is_left_and_a_pause_does_not() -> None:
    progress = Progress().planned(_two_stations(), CELL).at_state("driving", 1, 100.0)
    expected_s = progress.later_s[0]
    paused = progress.at_state("paused", 1, 110.0)
    again = paused.at_state("scanning", 1, 500.0)
    assert again.spent_s == 10.0, "the pause is no work"
    last = again.at_state("driving", 2, 500.0 + 2.0 * expected_s - 10.0)
    assert last.correction == pytest.approx(2.0)
    assert last.time_left_s == pytest.approx(2.0 * progress.later_s[1])


def test_time_left_passes_with_the_cell_s_clock() -> None:
    left = TimeLeft()
    record = JobRecord(Job("a", "/p"), JobState.RUNNING, time_left_s=60.0)
    left.begin(record, 1000.0)
    for second in range(5):
        left.look(1000.0 + 4.0 * second, 50.0 + second)
    assert left.rate() == pytest.approx(4.0)
    now = left.now(record, 1020.0, 2_000.0)
    assert now.time_left_s == 40.0
    assert now.expected_end_ns == 2_010 * 10**9, "40 s at four times wall time"
    assert left.now(record, 2000.0, 2_000.0).time_left_s == 0.0
    held = replace(record, state=JobState.INTERRUPTED)
    assert left.now(held, 1020.0, 2_000.0) is held, "nobody knows when it goes on"


def _segment(kind: int, points: list[int]) -> Segment:
    times = np.array([0.0, 1.0])
    return Segment(
        kind, times, np.zeros((2, 6)), np.zeros((2, 6)), np.array(points, dtype=int), 0.1
    )


def test_left_over_points_are_those_that_no_station_scanned_since() -> None:
    data = Round()
    skipped = tuple(SkippedPoint(p, "no inverse kinematics") for p in (3, 4))
    data.trajectories.append(StationTrajectory(0, (_segment(SCAN, [0, 1, 2]),), skipped))
    assert data.left_over() == {3: "no inverse kinematics", 4: "no inverse kinematics"}
    segments = (_segment(TRANSIT, [4]), _segment(SCAN, [3, 5]))
    data.trajectories.append(StationTrajectory(1, segments, (SkippedPoint(4, "in collision"),)))
    assert data.left_over() == {4: "in collision"}
    assert data.scanned() == {0, 1, 2, 3, 5}


def test_run_folder_accepts_logs_and_refuses_another_run(tmp_path: Path) -> None:
    (tmp_path / "job" / "log").mkdir(parents=True)
    folder = RunFolder.create(tmp_path, "job")
    folder.note("begin")
    assert not folder.summary.exists()
    folder.finish({"job": {"id": "job", "state": "Ended"}, "value": float("nan")})
    assert json.loads(folder.summary.read_text())["value"] is None
    assert [p.name for p in folder.path.glob(".*")] == [], "no temporary file is left"
    with pytest.raises(JobInvalidError, match=r"summary\.json, state of an earlier run"):
        RunFolder.create(tmp_path, "job")


def test_run_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "runs").write_text("a file")
    with pytest.raises(JobInvalidError, match="can't be made"):
        RunFolder.create(tmp_path / "runs", "job")


def test_the_timeline_has_each_stay_at_a_station_once() -> None:
    def entry(at_s: float, state: str, station: int = 0, rescan: int = 0) -> Entry:
        values = {"state": state, "event": "done", "station": station, "rescan": rescan}
        return Entry("state", 1_000 + round(at_s * 1e9), values)

    entries = [
        Entry("job", 0, {}),
        entry(0.0, "starting"),
        entry(2.0, "planning_path"),
        entry(5.0, "moving", 1),
        Entry("points", 6, {}),
        entry(6.0, "scanning", 1),
        entry(8.0, "moving", 1),
        entry(9.0, "scanning", 1, 1),
        Entry("over", 1_000 + 12 * 10**9, {"state": "ended", "code": 1}),
    ]
    found = [(step["step"], step["begin_s"], step["end_s"]) for step in timeline(entries)]
    assert found == [
        ("starting", 0.0, 2.0),
        ("planning path", 2.0, 5.0),
        ("scanning, station 1", 5.0, 9.0),
        ("scanning, station 1, re-scan 1", 9.0, 12.0),
    ]
    assert timeline([]) == []
