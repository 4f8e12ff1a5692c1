"""Job services and the watch of the supervisor, without the rest of the cell."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import KeyValue
from rclpy.action import ActionClient
from skinplan_msgs.action import MeasurePart
from skinplan_msgs.msg import Heartbeat, Job, JobStatus, PartReference, Status
from skinplan_msgs.srv import JobCommand, JobGet, JobList, JobSubmit

from nodes.bench import Bench
from skinplan.jobs.store import JobStore
from skinplan.part.samples import write_sample
from skinplan_nodes.cell_supervisor import CellSupervisor
from skinplan_nodes.qos import LATCHED, STATE

Ask = JobCommand.Request


@pytest.fixture(scope="module")
def part_uri(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(write_sample("scene2", tmp_path_factory.mktemp("part")).source)


class Desk:
    """A supervisor and the clients of its services."""

    def __init__(self, bench: Bench, folder: Path, part_uri: str, **parameters: Any) -> None:
        self.bench, self.folder, self.part_uri = bench, folder, part_uri
        self.states = bench.collect_before(JobStatus, "job_status", LATCHED)
        values = {"required_nodes": ["nobody"], "calibration_required": False, **parameters}
        self.supervisor = bench.start(
            CellSupervisor, simulated=False, runs_folder=str(folder), **values
        )

    def call(self, kind: Any, name: str, **fields: Any) -> Any:
        client = self.bench.tester.create_client(kind, f"jobs/{name}")
        self.bench.wait(client.service_is_ready)
        return self.bench.result(client.call_async(kind.Request(**fields)))

    def submit(self, job_id: str = "j1", **fields: Any) -> Any:
        digest = fields.pop("sha256", "")
        part = PartReference(uri=fields.pop("uri", self.part_uri), mesh_sha256=digest)
        return self.call(JobSubmit, "submit", job=Job(job_id=job_id, part=part, **fields))

    def command(self, job_id: str, command: int) -> Any:
        return self.call(JobCommand, "command", job_id=job_id, command=command)

    def until(self, state: int) -> JobStatus:
        return self.bench.wait(lambda: next((s for s in self.states if s.state == state), None))


@pytest.fixture
def desk(bench: Bench, tmp_path: Path, part_uri: str) -> Callable[..., Desk]:
    return lambda **parameters: Desk(bench, tmp_path / "runs", part_uri, **parameters)


def test_job_that_may_not_start_waits_for_its_command(desk: Callable[..., Desk]) -> None:
    cell = desk(auto_start=False)
    answer = cell.submit(serial_number="S-7")
    assert answer.status.code == Status.OK
    assert answer.job_status.state == JobStatus.NOT_ALLOWED_TO_START
    found = cell.call(JobGet, "get", job_id="j1")
    assert found.job.serial_number == "S-7"
    assert cell.command("j1", Ask.START).status.code == Status.OK
    assert cell.until(JobStatus.RUNNING).job_id == "j1"


def test_attribute_of_the_job_decides_whether_it_starts(desk: Callable[..., Desk]) -> None:
    cell = desk()
    waits = [KeyValue(key="auto_start", value="false")]
    assert cell.submit(attributes=waits).job_status.state == JobStatus.NOT_ALLOWED_TO_START


def test_job_without_id_gets_one_and_the_empty_id_asks_for_it(desk: Callable[..., Desk]) -> None:
    cell = desk(auto_start=False)
    made = cell.submit(job_id="").job_id
    assert made
    assert cell.call(JobGet, "get", job_id="").job.job_id == made
    assert [s.job_id for s in cell.call(JobList, "list", limit=0).jobs] == [made]


def test_bad_requests_get_their_own_codes(desk: Callable[..., Desk]) -> None:
    cell = desk(auto_start=False)
    assert cell.call(JobGet, "get", job_id="").status.code == Status.JOB_UNKNOWN
    assert cell.submit(uri="relative.yaml").status.code == Status.JOB_INVALID
    assert cell.submit(job_id="a/b").status.code == Status.JOB_INVALID
    assert cell.submit().status.code == Status.OK
    assert cell.submit().status.code == Status.OK, "the same again is no conflict"
    assert cell.submit(order_id="other").status.code == Status.JOB_CONFLICT
    assert cell.command("j1", Ask.PAUSE).status.code == Status.JOB_COMMAND_REFUSED
    assert cell.command("j1", 99).status.code == Status.JOB_COMMAND_REFUSED
    assert cell.command("none", Ask.START).status.code == Status.JOB_UNKNOWN


def test_a_supervisor_that_ends_begins_no_other_job(desk: Callable[..., Desk]) -> None:
    cell = desk()
    cell.submit("j1")
    cell.until(JobStatus.RUNNING)
    cell.submit("j2")
    cell.supervisor.close()

    def state_of(job_id: str) -> int:
        store = JobStore(cell.folder / "jobs.sqlite", copy=True)
        try:
            return store.get(job_id).state
        finally:
            store.close()

    cell.bench.wait(lambda: state_of("j1") == JobStatus.ABORTED)
    assert state_of("j2") == JobStatus.ALLOWED_TO_START
    assert not (cell.folder / "j2").exists()


def test_cancelled_job_never_begins(desk: Callable[..., Desk]) -> None:
    cell = desk(auto_start=False)
    cell.submit()
    assert cell.command("j1", Ask.CANCEL).job_status.state == JobStatus.ABORTED
    assert not (cell.folder / "j1").exists()


def test_missing_node_ends_the_job_with_its_name(desk: Callable[..., Desk]) -> None:
    cell = desk(start_timeout_s=1.0)
    cell.submit()
    last = cell.until(JobStatus.ABORTED)
    assert last.status.code == Status.DEVICE_NOT_READY
    assert "nobody" in last.status.message
    summary = json.loads((cell.folder / "j1" / "summary.json").read_text())
    assert summary["job"]["state"] == "Aborted"
    assert summary["error"]["step"] == "starting"
    assert summary["error"]["node"] == "nobody"


def test_missing_part_file_is_refused(desk: Callable[..., Desk]) -> None:
    cell = desk()
    status = cell.submit(uri="/nowhere/part.yaml").status
    assert status.code == Status.PART_NOT_FOUND
    assert "/nowhere/part.yaml" in status.message
    assert cell.call(JobGet, "get", job_id="j1").status.code == Status.JOB_UNKNOWN


def test_silent_node_ends_the_job_with_its_name(desk: Callable[..., Desk], bench: Bench) -> None:
    cell = desk(required_nodes=["planner", "nobody"], silent_max_s=2.0, recovery_timeout_s=1.0)
    beats = bench.tester.create_publisher(Heartbeat, "heartbeat", STATE)
    bench.wait(lambda: beats.get_subscription_count() > 0)
    beats.publish(Heartbeat(node="/planner", pid=1, count=1))
    cell.submit()
    last = cell.until(JobStatus.ABORTED)
    assert last.status.code == Status.NODE_LOST
    assert "planner" in last.status.message


def test_abort_ends_a_running_job(desk: Callable[..., Desk]) -> None:
    cell = desk()
    cell.submit()
    cell.until(JobStatus.RUNNING)
    assert cell.command("j1", Ask.ABORT).status.code == Status.OK
    assert cell.until(JobStatus.ABORTED).status.code == Status.JOB_ABORTED


def test_second_job_waits_and_runs_after_the_first(desk: Callable[..., Desk]) -> None:
    cell = desk()
    cell.submit("first")
    assert cell.submit("second").job_status.state == JobStatus.ALLOWED_TO_START
    cell.command("first", Ask.ABORT)
    running = [JobStatus.RUNNING]
    cell.bench.wait(lambda: [s for s in cell.states if s.job_id == "second" and s.state in running])


def test_action_ends_with_the_job(desk: Callable[..., Desk], bench: Bench) -> None:
    cell = desk()
    client = ActionClient(bench.tester, MeasurePart, "measure_part")
    bench.wait(client.server_is_ready)
    job = Job(job_id="j1", part=PartReference(uri=cell.part_uri))
    handle = bench.result(client.send_goal_async(MeasurePart.Goal(job=job)))
    cell.until(JobStatus.RUNNING)
    assert bench.result(handle.cancel_goal_async()).goals_canceling
    response = bench.result(handle.get_result_async())
    assert response.status == GoalStatus.STATUS_CANCELED
    assert response.result.status.code == Status.JOB_ABORTED
    assert Path(response.result.summary_uri).is_file()


def test_action_with_a_bad_job_is_aborted_with_a_status(
    desk: Callable[..., Desk], bench: Bench
) -> None:
    desk()
    client = ActionClient(bench.tester, MeasurePart, "measure_part")
    bench.wait(client.server_is_ready)
    handle = bench.result(client.send_goal_async(MeasurePart.Goal(job=Job(job_id="j1"))))
    response = bench.result(handle.get_result_async())
    assert response.status == GoalStatus.STATUS_ABORTED
    assert response.result.status.code == Status.JOB_INVALID
