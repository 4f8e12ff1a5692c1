"""Jobs that are interrupted and go on, against a small cell of independent servers."""

import errno
import functools
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from skinplan_msgs.msg import DeviceState, Heartbeat, Job, JobStatus, PartReference, Status
from skinplan_msgs.srv import JobCommand, JobGet, JobSubmit

from nodes.bench import Bench
from nodes.shape_part import write_shape_part
from nodes.small_part import write_small_part
from nodes.supervised_cell import HOME, SupervisedCell, joints_of
from skinplan.errors import JobStoreError
from skinplan.jobs.model import JobRecord
from skinplan.jobs.store import JobStore
from skinplan.part.model import Part
from skinplan_nodes.cell_supervisor import CellSupervisor
from skinplan_nodes.qos import LATCHED, STATE
from skinplan_nodes.supervisor.machine import State
from skinplan_nodes.supervisor.mission import Mission
from skinplan_nodes.supervisor.run_folder import RunFolder

Ask = JobCommand.Request
QUICK: dict[str, Any] = {
    "report": False,
    "calibration_required": False,
    "certify_motion": False,
    "stop_timeout_s": 1.0,
    "start_timeout_s": 10.0,
}


@pytest.fixture(scope="module")
def part(tmp_path_factory: pytest.TempPathFactory) -> Part:
    return write_small_part(tmp_path_factory.mktemp("part"))


@pytest.fixture
def bench() -> Iterator[Bench]:
    found = Bench(threads=8)
    yield found
    found.close()
    assert not found.failures


class Run:
    """A supervisor, its cell and one job."""

    def __init__(self, bench: Bench, folder: Path, part: Part, **cell: Any) -> None:
        self.bench, self.runs, self.part = bench, folder / "runs", part
        self.cell: SupervisedCell = bench.start(
            functools.partial(SupervisedCell, **cell), simulated=False
        )
        self.states = bench.collect_before(JobStatus, "job_status", LATCHED)
        # Made early: a client that has just come up may miss an answer.
        self._clients = {
            kind: bench.tester.create_client(kind, name)
            for kind, name in (
                (JobSubmit, "jobs/submit"),
                (JobCommand, "jobs/command"),
                (JobGet, "jobs/get"),
            )
        }

    def supervise(self, **values: Any) -> "Run":
        """Starts the supervisor in this process."""
        given = {**QUICK, "runs_folder": str(self.runs), "required_nodes": ["nobody"], **values}
        beats = self.bench.tester.create_publisher(Heartbeat, "heartbeat", STATE)
        self.beat = lambda name, pid=1: beats.publish(Heartbeat(node=f"/{name}", pid=pid))
        self.bench.start(CellSupervisor, simulated=False, **given)
        self.bench.wait(lambda: beats.get_subscription_count() > 0)
        self.bench.tester.create_timer(0.5, lambda: [self.beat(n, p) for n, p in self.alive])
        return self

    alive: tuple[tuple[str, int], ...] = (("nobody", 1),)

    def submit(self) -> "Run":
        job = Job(job_id="j1", part=PartReference(uri=str(self.part.source)))
        answer = self._call(JobSubmit, JobSubmit.Request(job=job))
        assert answer.status.code == Status.OK
        return self

    def command(self, command: int) -> None:
        request = Ask(job_id="j1", command=command)
        answer = self._call(JobCommand, request)
        assert answer.status.code == Status.OK, answer.status.message

    def _call(self, kind: Any, request: Any) -> Any:
        """Asks again after a while: the answer of a server that has just come up may get lost."""
        patiently(self._clients[kind].service_is_ready)
        for _ in range(20):
            answer = self._clients[kind].call_async(request)
            deadline = time.monotonic() + 3.0
            while not answer.done() and time.monotonic() < deadline:
                time.sleep(0.01)
            if answer.done():
                return answer.result()
        raise AssertionError("no answer")

    def told(self) -> JobGet.Response:
        """What the service says of the job."""
        return self._call(JobGet, JobGet.Request(job_id="j1", with_history=True))

    def until(self, state: int, sub_state: str | None = None) -> JobStatus:
        def found() -> JobStatus | None:
            last = self.states[-1] if self.states else None
            fits = last is not None and last.state == state
            return last if fits and sub_state in (None, last.sub_state) else None

        return patiently(found, 60.0)

    def until_scanned(self, point: int) -> None:
        patiently(lambda: point in self.cell.seen, 60.0)

    def ended(self) -> dict[str, Any]:
        self.until(JobStatus.ENDED)
        return self.summary()

    def aborted(self) -> dict[str, Any]:
        self.until(JobStatus.ABORTED)
        return self.summary()

    def summary(self) -> dict[str, Any]:
        return json.loads((self.runs / "j1" / "summary.json").read_text())

    def stands_still(self, for_s: float = 0.3) -> None:
        moved_s, q = self.cell.arm.moved_s, self.cell.arm.q.copy()
        time.sleep(for_s)
        assert self.cell.arm.moved_s == moved_s
        np.testing.assert_array_equal(self.cell.arm.q, q)


@pytest.fixture
def run(bench: Bench, tmp_path: Path, part: Part) -> Callable[..., Run]:
    return lambda **cell: Run(bench, tmp_path, part, **cell)


def test_an_undisturbed_job_passes_every_point_once(run: Callable[..., Run]) -> None:
    job = run(stations=2).supervise().submit()
    summary = job.ended()
    assert job.cell.asked == [[0, 1, 2], [3, 4, 5]]
    assert job.cell.calls.count("localize") == 3
    assert summary["interruptions"] == [] and summary["rescans"] == []
    steps = [step["step"] for step in summary["timeline"]]
    assert steps[0] == "starting" and steps[-1] == "closing"
    assert steps.count("scanning, station 1") == steps.count("scanning, station 2") == 1
    assert summary["measured"]["area_ratio_over_certified"] == 0.0
    np.testing.assert_allclose(job.cell.arm.q, HOME, atol=1e-6)
    assert job.cell.bags == ["bag"] and job.cell.calls.count("recorder/stop") == 1
    assert job.cell.inspections == [("frames", False)]


def test_a_part_without_markers_is_located_by_its_shape(bench: Bench, tmp_path: Path) -> None:
    job = Run(bench, tmp_path, write_shape_part(tmp_path / "part"), stations=2)
    job.supervise().submit().ended()
    assert job.cell.calls.count("locate by shape") == 3
    assert "localize" not in job.cell.calls


def test_a_pause_holds_in_the_middle_of_a_segment_and_goes_on_there(
    run: Callable[..., Run],
) -> None:
    job = run(points=10).supervise().submit()
    job.until_scanned(2)
    job.command(Ask.PAUSE)
    held = job.until(JobStatus.INTERRUPTED, "paused")
    assert held.status.code == Status.OK
    assert 9 not in job.cell.seen, "the segment was not driven to its end"
    job.stands_still()
    goals = len(job.cell.arm.goals)
    job.command(Ask.RESUME)
    summary = job.ended()
    # What is left of the segment, from where the arm stood; nothing was planned anew.
    end_rad = joints_of(9)[0] + 0.05
    np.testing.assert_allclose(job.cell.arm.goals[goals][-1][0], end_rad, atol=1e-6)
    assert job.cell.calls.count("plan_trajectories") == 1
    assert set(job.cell.seen) == set(range(10))
    (stood,) = summary["interruptions"]
    assert (stood["state"], stood["code"]) == ("scanning", 0)
    assert stood["resumed_after_s"] > 0.0
    assert "arm/stop" not in job.cell.calls, "cancelling was enough"


def test_the_scanner_is_on_until_the_arm_stands(run: Callable[..., Run]) -> None:
    job = run(points=16)
    job.cell.arm.brakes_s = 0.4
    job.supervise().submit()
    job.until_scanned(2)
    job.command(Ask.PAUSE)
    job.until(JobStatus.INTERRUPTED, "paused")
    assert not job.cell.scanner_on
    assert job.cell.scanner_switched_s > job.cell.arm.moved_s
    job.command(Ask.ABORT)
    job.aborted()


def test_a_protective_stop_waits_for_the_operator(run: Callable[..., Run]) -> None:
    job = run().supervise().submit()
    job.until_scanned(1)
    job.cell.set_arm(DeviceState.FAULT, "protective_stop")
    held = job.until(JobStatus.INTERRUPTED, "waiting")
    assert held.status.code == Status.PROTECTIVE_STOP
    job.stands_still()
    job.command(Ask.RESUME)
    summary = job.ended()
    assert job.cell.calls.count("arm/reset") >= 1
    assert set(job.cell.seen) == set(range(6))
    assert [s["code"] for s in summary["interruptions"]] == [Status.PROTECTIVE_STOP]
    assert job.states[-1].status.code == Status.OK


@pytest.mark.long
def test_a_fault_that_nobody_ends_ends_the_job_with_its_code(run: Callable[..., Run]) -> None:
    job = run().supervise(operator_timeout_s=1.0).submit()
    job.until_scanned(1)
    job.cell.set_arm(DeviceState.EMERGENCY_STOP, "emergency_stop")
    summary = job.aborted()
    assert summary["error"]["code"] == Status.EMERGENCY_STOP
    assert summary["interruptions"][0]["resumed_after_s"] is None
    job.stands_still()


@pytest.mark.long
def test_an_arm_that_leaves_its_way_is_planned_anew_without_what_was_seen(
    run: Callable[..., Run],
) -> None:
    job = run(with_devices=False).supervise().submit()
    job.until_scanned(2)
    job.command(Ask.PAUSE)
    job.until(JobStatus.INTERRUPTED, "paused")
    seen = set(job.cell.seen)
    # Somebody jogs the arm.
    job.cell.arm.move(job.cell.arm.q + np.array([0.0, 0.3, 0.0, 0.0, 0.0, 0.0]))
    goals = len(job.cell.arm.goals)
    job.command(Ask.RESUME)
    job.ended()
    assert job.cell.asked[0] == [0, 1, 2, 3, 4, 5]
    assert set(job.cell.asked[1]) <= set(range(6)) - (seen - {max(seen)})
    assert set(job.cell.seen) == set(range(6))
    assert job.cell.calls.count("localize") == 2, "the base did not move"
    assert len(job.cell.arm.goals) > goals


@pytest.mark.long
def test_a_base_that_moved_is_located_again(run: Callable[..., Run]) -> None:
    job = run().supervise().submit()
    job.until_scanned(2)
    job.command(Ask.PAUSE)
    job.until(JobStatus.INTERRUPTED, "paused")
    job.cell.base = job.cell.base.copy()
    job.cell.base[0, 3] += 0.02
    job.command(Ask.RESUME)
    job.ended()
    assert job.cell.calls.count("localize") == 3
    assert job.cell.calls.count("plan_trajectories") == 2
    assert set(job.cell.seen) == set(range(6))


@pytest.mark.long
def test_a_base_that_stands_badly_drives_to_its_station_again(run: Callable[..., Run]) -> None:
    job = run().supervise()
    job.cell.stands_badly = 1
    summary = job.submit().ended()
    assert [s["code"] for s in summary["interruptions"]] == [Status.QUALITY_NOT_REACHED]
    motions = [call for call in job.cell.calls if call in ("drive", "localize")]
    assert motions[2:6] == ["drive", "localize", "drive", "localize"], "the station's, twice"


def test_a_localiser_that_still_works_on_its_last_goal_is_asked_again(
    run: Callable[..., Run],
) -> None:
    job = run().supervise()
    job.cell.localizer_refuses = 3
    summary = job.submit().ended()
    assert summary["interruptions"] == []
    assert job.cell.localizer_refuses < 0 and job.cell.calls.count("localize") == 2


@pytest.mark.long
def test_an_arm_goal_that_never_ends_ends_the_job_in_time(run: Callable[..., Run]) -> None:
    job = run().supervise(segment_timeout_s=1.0, resume_attempts_max=1, operator_timeout_s=1.0)
    job.cell.arm.never_ends = True
    summary = job.submit().aborted()
    assert summary["error"]["code"] == Status.STEP_TIMEOUT
    assert "was not over within 1 s" in summary["error"]["message"]
    job.stands_still()


def test_the_pause_before_a_try_is_shorter_than_the_time_for_it(run: Callable[..., Run]) -> None:
    job = run().supervise(recovery_timeout_s=1.0)
    job.cell.stands_badly = 3
    summary = job.submit().ended()
    assert [s["code"] for s in summary["interruptions"]] == 3 * [Status.QUALITY_NOT_REACHED]


def test_what_fails_again_and_again_is_left_to_the_operator(run: Callable[..., Run]) -> None:
    job = run().supervise(resume_attempts_max=1)
    job.cell.stands_badly = 100
    job.submit()
    job.until(JobStatus.INTERRUPTED, "waiting")
    assert job.cell.stands_badly == 98, "it went on once by itself"
    job.command(Ask.RESUME)
    patiently(lambda: job.cell.stands_badly == 96)
    job.until(JobStatus.INTERRUPTED, "waiting")
    job.cell.stands_badly = 0
    job.command(Ask.RESUME)
    summary = job.ended()
    assert {s["code"] for s in summary["interruptions"]} == {Status.QUALITY_NOT_REACHED}
    assert set(job.cell.seen) == set(range(6))


@pytest.mark.long
def test_a_base_that_never_answers_is_tried_again_and_recovers(run: Callable[..., Run]) -> None:
    job = run().supervise(drive_timeout_s=1.0)
    job.cell.base_answers = False
    job.submit()
    job.until(JobStatus.INTERRUPTED)
    job.cell.base_answers = True
    summary = job.ended()
    assert job.cell.calls.count("drive") >= 3
    assert {s["code"] for s in summary["interruptions"]} == {Status.DEVICE_TIMEOUT}


def test_a_node_that_is_another_process_interrupts_until_it_is_back(
    run: Callable[..., Run],
) -> None:
    job = run()
    job.alive = (("nobody", 1), ("scan_inspector", 7), ("run_recorder", 8))
    job.supervise(required_nodes=["nobody", "scan_inspector", "run_recorder"]).submit()
    job.until_scanned(1)
    job.alive, job.cell.recording = (
        (("nobody", 1), ("scan_inspector", 9), ("run_recorder", 10)),
        None,
    )
    summary = job.ended()
    assert [s["code"] for s in summary["interruptions"]] == [Status.NODE_LOST]
    assert "scan_inspector" in summary["interruptions"][0]["reason"]
    assert job.cell.inspections == [("frames", False), ("frames", True)]
    asked = list(dict.fromkeys(job.cell.bags))
    assert asked == ["bag", "bag-2"], "the recorder was lost, too, but held nothing up"
    assert job.cell.calls.count("localize") == 3, "the new inspector did not see the base stand"
    assert {0, 1, 2, 3, 4, 5} == set(job.cell.seen)


def test_a_recorder_told_of_late_goes_on_with_the_bag_it_began(run: Callable[..., Run]) -> None:
    """It was started anew just before the job; its first heartbeat comes when the bag is open."""
    job = run()
    job.alive = (("nobody", 1), ("run_recorder", 8))
    job.supervise().submit()
    job.until_scanned(1)
    job.alive = (("nobody", 1), ("run_recorder", 10))
    summary = job.ended()
    assert set(job.cell.bags) == {"bag"}
    assert job.cell.calls.count("recorder/stop") == 1 and job.cell.recording is None
    assert "parts" not in summary["bag"] and summary["bag"].get("closed", True)


def test_a_job_that_needs_its_recorder_stands_until_it_records(run: Callable[..., Run]) -> None:
    job = run()
    job.alive = (("nobody", 1), ("run_recorder", 8))
    job.supervise(without_recorder="interrupt").submit()
    job.until_scanned(1)
    job.cell.recording = Path("/a bag of somebody else")
    job.alive = (("nobody", 1), ("run_recorder", 10))
    job.until(JobStatus.INTERRUPTED, "waiting")
    job.stands_still()
    job.cell.recording = None
    job.command(Ask.RESUME)
    summary = job.ended()
    assert [s["code"] for s in summary["interruptions"]] == [Status.RECORDER_BUSY]
    assert list(dict.fromkeys(job.cell.bags)) == ["bag", "bag-2"]
    assert set(job.cell.seen) == set(range(6))


def test_a_job_whose_recorder_is_busy_at_the_start_ends(run: Callable[..., Run]) -> None:
    job = run().supervise(without_recorder="interrupt")
    job.cell.recording = somebody_elses = Path("/a bag of somebody else")
    summary = job.submit().aborted()
    assert summary["error"]["code"] == Status.RECORDER_BUSY
    assert job.cell.recording == somebody_elses, "what somebody else records goes on"
    assert "drive" not in job.cell.calls


def test_a_job_that_ends_by_an_error_nobody_foresaw_closes_its_bag(
    run: Callable[..., Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    reported = Mission._report

    def report(mission: Mission, state: State) -> None:
        if state is State.INSPECTING:
            raise ZeroDivisionError("nobody thought of it")
        reported(mission, state)

    monkeypatch.setattr(Mission, "_report", report)
    job = run().supervise().submit()
    summary = job.aborted()
    assert summary["error"]["code"] == Status.INTERNAL
    assert "nobody thought of it" in summary["error"]["message"]
    assert job.cell.calls.count("recorder/stop") == 1 and job.cell.recording is None
    job.stands_still()


def test_a_job_can_be_commanded_while_its_store_can_t_be_written(
    run: Callable[..., Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    stored, full = JobStore.update, threading.Event()

    def update(store: JobStore, *given: Any) -> JobRecord:
        if full.is_set():
            raise JobStoreError("database or disk is full")
        return stored(store, *given)

    monkeypatch.setattr(JobStore, "update", update)
    job = run().supervise().submit()
    job.until_scanned(1)
    full.set()
    job.command(Ask.PAUSE)
    job.until(JobStatus.INTERRUPTED, "paused")
    assert job.told().job_status.state == JobStatus.INTERRUPTED
    assert "paused" not in {change.sub_state for change in job.told().history}
    full.clear()
    patiently(lambda: "paused" in {change.sub_state for change in job.told().history})
    full.set()
    job.command(Ask.RESUME)
    job.until(JobStatus.RUNNING)
    full.clear()
    job.ended()


def test_a_summary_waits_for_space_on_the_disk(
    run: Callable[..., Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    finished, full = RunFolder.finish, [True, True]

    def finish(folder: RunFolder, summary: dict[str, Any]) -> None:
        if full and full.pop():
            raise OSError(errno.ENOSPC, "No space left on device")
        finished(folder, summary)

    monkeypatch.setattr(RunFolder, "finish", finish)
    job = run().supervise().submit()
    assert job.ended()["job"]["state"] == "Ended"
    assert not full, "it was tried until there was space"


def test_a_log_that_can_t_be_written_ends_no_job(run: Callable[..., Run]) -> None:
    job = run().supervise().submit()
    job.until_scanned(1)
    log = job.runs / "j1" / "log" / "job.log"
    log.unlink()
    log.mkdir()
    assert job.ended()["interruptions"] == []


@pytest.mark.long
def test_a_bag_whose_begin_was_not_heard_of_is_gone_on_with(run: Callable[..., Run]) -> None:
    job = run()
    job.cell.recorder_s = 1.0
    job.supervise().submit()
    patiently(lambda: job.cell.bags)
    job.command(Ask.PAUSE)
    job.until(JobStatus.INTERRUPTED, "paused")
    job.cell.recorder_s = 0.0
    job.command(Ask.RESUME)
    summary = job.ended()
    assert set(job.cell.bags) == {"bag"}
    assert "parts" not in summary["bag"]


@pytest.mark.long
def test_a_node_that_does_not_come_back_ends_the_job(run: Callable[..., Run]) -> None:
    job = run()
    job.alive = (("nobody", 1), ("planner", 2**30))
    job.supervise(
        required_nodes=["nobody", "planner"], silent_max_s=2.0, recovery_timeout_s=1.0
    ).submit()
    job.cell.base_answers = False
    job.until(JobStatus.RUNNING, "driving")
    job.alive = (("nobody", 1),)
    summary = job.aborted()
    assert summary["error"]["code"] == Status.NODE_LOST
    assert "planner" in summary["error"]["message"]


def test_stop_keeps_what_was_scanned(run: Callable[..., Run]) -> None:
    job = run().supervise().submit()
    job.until_scanned(2)
    job.command(Ask.STOP)
    summary = job.ended()
    assert "arm/stop" in job.cell.calls
    assert 0.0 < summary["measured"]["area_ratio"] < 1.0
    job.stands_still()


def test_abort_stops_at_once(run: Callable[..., Run]) -> None:
    job = run().supervise().submit()
    job.until_scanned(1)
    job.command(Ask.ABORT)
    summary = job.aborted()
    assert summary["error"]["code"] == Status.JOB_ABORTED
    assert "arm/stop" in job.cell.calls and "recorder/stop" in job.cell.calls
    job.stands_still()


@pytest.mark.long
def test_the_next_job_brings_the_arm_home_the_way_it_came(run: Callable[..., Run]) -> None:
    job = run().supervise().submit()
    job.until_scanned(3)
    job.command(Ask.ABORT)
    job.aborted()
    far = job.cell.arm.q.copy()
    goals = len(job.cell.arm.goals)
    again = Job(job_id="j2", part=PartReference(uri=str(job.part.source)))
    job._call(JobSubmit, JobSubmit.Request(job=again))
    job.until(JobStatus.ENDED)
    back = job.cell.arm.goals[goals]
    np.testing.assert_allclose(back[0], far, atol=1e-6)
    np.testing.assert_allclose(back[-1], HOME, atol=1e-6)


@pytest.mark.long
def test_a_base_does_not_drive_with_an_arm_that_somebody_left_anywhere(
    run: Callable[..., Run],
) -> None:
    job = run().supervise()
    job.cell.arm.move(HOME + 0.4)
    summary = job.submit().aborted()
    assert summary["error"]["code"] == Status.START_STATE_INVALID
    assert "by hand" in summary["error"]["message"]
    assert "drive" not in job.cell.calls


def test_what_is_missing_is_scanned_again(run: Callable[..., Run]) -> None:
    job = run().supervise()
    job.cell.blind = {2, 3}
    job.submit()
    job.bench.wait(lambda: "inspection/so far" in job.cell.calls)
    job.cell.blind = set()
    summary = job.ended()
    assert job.cell.asked == [[0, 1, 2, 3, 4, 5], [2, 3]]
    assert [r["points"] for r in summary["rescans"]] == [2]
    assert summary["measured"]["area_ratio"] == 1.0
    assert max(s.rescan for s in job.states) == 1
    assert (job.runs / "j1" / "plan" / "rescan-1" / "scan_path.json").is_file()


@pytest.mark.long
def test_re_scans_are_bounded(run: Callable[..., Run]) -> None:
    job = run().supervise(max_rescans=1)
    job.cell.blind = {2}
    summary = job.submit().ended()
    assert len(summary["rescans"]) == 1
    assert summary["measured"]["area_ratio"] == pytest.approx(5 / 6)


def patiently(condition: Callable[[], Any], timeout_s: float = 90.0) -> Any:
    """Waits until a condition is true."""
    deadline = time.monotonic() + timeout_s
    while not (value := condition()):
        assert time.monotonic() < deadline, "the condition did not come true in time"
        time.sleep(0.01)
    return value


class Process:
    """The supervisor as a process of its own, to be killed."""

    def __init__(self, job: Run, **values: Any) -> None:
        given = {**QUICK, "runs_folder": str(job.runs), "required_nodes": [""], **values}
        self._command = [sys.executable, "-m", "skinplan_nodes.cell_supervisor", "--ros-args"]
        for name, value in given.items():
            text = json.dumps(value) if not isinstance(value, str) else value
            self._command += ["-p", f"{name}:={text}"]
        self._job = job
        self.start()

    def start(self) -> None:
        self._process = subprocess.Popen(self._command)
        # A process of its own needs long to start on a busy machine.
        client = self._job.bench.tester.create_client(JobGet, "jobs/get")
        patiently(client.service_is_ready)

    def kill(self) -> None:
        os.kill(self._process.pid, signal.SIGKILL)
        self._process.wait(10)

    def end(self) -> None:
        self._process.terminate()
        try:
            self._process.wait(30)
        except subprocess.TimeoutExpired:
            self._process.kill()
            raise


@pytest.fixture
def killed(run: Callable[..., Run]) -> Iterator[Callable[..., tuple[Run, Process]]]:
    """A job whose supervisor was killed in the middle of a scan."""
    processes: list[Process] = []

    def make(**values: Any) -> tuple[Run, Process]:
        job = run()
        processes.append(Process(job, **values))
        job.submit()
        job.until_scanned(2)
        processes[0].kill()
        return job, processes[0]

    yield make
    for process in processes:
        process.end()


@pytest.mark.long
def test_a_killed_supervisor_goes_on_with_the_rest(
    killed: Callable[..., tuple[Run, Process]],
) -> None:
    job, process = killed()
    process.start()
    summary = job.ended()
    assert set(job.cell.seen) == set(range(6))
    # The arm was found where the dead supervisor's goal had brought it.
    assert len(job.cell.asked) == 2 and not {0, 1} & set(job.cell.asked[1])
    assert job.cell.calls.count("localize") == 3, "it is not known where the base is"
    assert job.cell.inspections == [("frames", False), ("frames", True)]
    (stood,) = summary["interruptions"]
    assert stood["code"] == Status.NODE_LOST and stood["resumed_after_s"] >= 0.0
    assert summary["stations"]["count"] == 1 and len(summary["localization"]) == 3
    np.testing.assert_allclose(job.cell.arm.q, HOME, atol=1e-6)


@pytest.mark.long
def test_a_killed_supervisor_waits_where_it_is_told_to(
    killed: Callable[..., tuple[Run, Process]],
) -> None:
    job, process = killed(resume_at_start=False)
    process.start()
    waits = job.until(JobStatus.INTERRUPTED, "waiting")
    assert waits.status.code == Status.NODE_LOST
    job.stands_still()
    assert job.cell.calls.count("localize") == 2, "nothing is done before RESUME"
    job.command(Ask.RESUME)
    (stood,) = job.ended()["interruptions"]
    assert stood["code"] == Status.NODE_LOST and stood["resumed_after_s"] >= 0.3
    assert job.cell.calls.count("localize") == 3, "it is not known where the base is"
    assert set(job.cell.seen) == set(range(6))


@pytest.mark.long
@pytest.mark.parametrize("damage", ["journal", "part"])
def test_what_has_changed_meanwhile_is_not_resumed(
    killed: Callable[..., tuple[Run, Process]], part: Part, damage: str
) -> None:
    job, process = killed()
    folder = job.runs / "j1"
    path = part.source if damage == "part" else folder / "state" / "journal.jsonl"
    assert path is not None
    kept = path.read_bytes()
    changed = kept.replace(b"\n", b"\n\n", 1) if damage == "part" else b"x" + kept[1:]
    path.write_bytes(changed)
    try:
        process.start()
        summary = job.aborted()
    finally:
        path.write_bytes(kept if damage == "part" else changed)
    assert summary["error"]["code"] == Status.RESUME_REFUSED
    assert ("part_sha256" if damage == "part" else "line 1") in summary["error"]["message"]
    journal = (folder / "state" / "journal.jsonl").read_bytes()
    assert journal == changed if damage == "journal" else len(journal) > 1000
    assert list((folder / "state").glob("trajectory-*.cdr"))
    job.stands_still()
