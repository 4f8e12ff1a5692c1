"""What an MES is told: a code for every refusal, histories, results, pages; and who may command."""

import json
import re
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import KeyValue
from rclpy.action import ActionClient
from skinplan_msgs.action import MeasurePart
from skinplan_msgs.msg import DeviceState, Job, JobStatus, PartReference, Status
from skinplan_msgs.srv import JobCommand, JobGet, JobList

from nodes.bench import Bench
from nodes.test_cell_supervisor import Ask, Desk
from skinplan.jobs import checks
from skinplan.jobs.model import JobCommand as JobCommands
from skinplan.jobs.model import JobState
from skinplan.part.samples import write_sample
from skinplan.robot.calibration import NAMES, note_calibration
from skinplan_nodes.qos import LATCHED

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def part_uri(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(write_sample("scene2", tmp_path_factory.mktemp("part")).source)


@pytest.fixture
def desk(bench: Bench, tmp_path: Path, part_uri: str) -> Callable[..., Desk]:
    return lambda **parameters: Desk(bench, tmp_path / "runs", part_uri, **parameters)


def calibrate(folder: Path, days: int, names: tuple[str, ...] = NAMES) -> str:
    """Notes calibrations that are valid for some days from now."""
    facts, file = folder / "cell.calibration.yaml", folder / "found.json"
    file.write_text("{}")
    now = datetime.now(UTC)
    for name in names:
        due = (now + timedelta(days=days)).date()
        note_calibration(facts, name, file, now, due, 0.1, "m")
    return str(facts)


@pytest.mark.parametrize(
    ("fields", "code"),
    [
        ({"part_id": "scene9"}, Status.PART_ID_MISMATCH),
        ({"uri": "/nowhere/part.yaml"}, Status.PART_NOT_FOUND),
        ({"uri": "part.yaml"}, Status.JOB_INVALID),
        ({"uri": "/etc/hostname"}, Status.PART_INVALID),
        ({"sha256": "0" * 64}, Status.MESH_HASH_MISMATCH),
        ({"order_id": "x" * 129}, Status.JOB_TEXT_REFUSED),
        ({"operator_name": "a\x1b[31m"}, Status.JOB_TEXT_REFUSED),
        ({"attributes": [KeyValue(key="k", value="v" * 1025)]}, Status.JOB_TEXT_REFUSED),
        ({"priority": 5000}, Status.JOB_INVALID),
        ({"earliest_start": Time(sec=-1)}, Status.JOB_INVALID),
    ],
)
def test_each_refusal_has_its_code_and_leaves_nothing(
    desk: Callable[..., Desk], fields: dict[str, Any], code: int
) -> None:
    cell = desk(auto_start=False)
    status = cell.submit(**fields).status
    assert (status.code, bool(status.message)) == (code, True)
    assert cell.call(JobList, "list").jobs == []


def test_a_full_queue_refuses_but_knows_what_it_has(desk: Callable[..., Desk]) -> None:
    cell = desk(auto_start=False, queue_max=2)
    for job_id in ("a", "b"):
        assert cell.submit(job_id).status.code == Status.OK
    assert cell.submit("c").status.code == Status.JOB_QUEUE_FULL
    assert cell.submit("b").status.code == Status.OK


@pytest.mark.parametrize(
    ("days", "names", "code"),
    [
        (5, NAMES, Status.OK),
        (-2, NAMES, Status.CALIBRATION_DUE),
        (5, NAMES[:3], Status.CALIBRATION_MISSING),
    ],
)
def test_a_job_is_refused_where_the_calibration_is_not_valid_unless_it_says_so(
    desk: Callable[..., Desk], tmp_path: Path, days: int, names: tuple[str, ...], code: int
) -> None:
    facts = calibrate(tmp_path, days, names)
    cell = desk(auto_start=False, calibration_required=True, calibration_file=facts)
    status = cell.submit().status
    assert status.code == code, status.message
    assert cell.submit("j2", accept_due_calibration=True).status.code == Status.OK
    if code == Status.CALIBRATION_MISSING:
        assert "camera" in status.message


def test_a_calibration_that_runs_out_while_a_job_waits_sends_it_back(
    desk: Callable[..., Desk], tmp_path: Path
) -> None:
    cell = desk(calibration_required=True, calibration_file=calibrate(tmp_path, 5))
    soon = Time(sec=int(time.time()) + 2)
    answer = cell.submit(earliest_start=soon)
    assert answer.job_status.state == JobStatus.ALLOWED_TO_START
    calibrate(tmp_path, -2)
    held = cell.until(JobStatus.NOT_ALLOWED_TO_START)
    assert held.status.code == Status.CALIBRATION_DUE
    assert cell.command("j1", Ask.START).status.code == Status.CALIBRATION_DUE
    calibrate(tmp_path, 5)
    assert cell.command("j1", Ask.START).status.code == Status.OK
    cell.until(JobStatus.RUNNING)


def test_a_device_at_fault_refuses_what_would_begin_but_not_what_waits(
    desk: Callable[..., Desk], bench: Bench
) -> None:
    arm = bench.tester.create_publisher(DeviceState, "arm/state", LATCHED)
    cell = desk()
    bench.wait(lambda: arm.get_subscription_count() > 0)
    arm.publish(DeviceState(device="arm", state=DeviceState.FAULT, fault="protective_stop"))
    bench.wait(lambda: cell.submit("j1").status.code == Status.DEVICE_NOT_READY or None)
    later = Time(sec=int(time.time()) + 3600)
    assert cell.submit("j2", earliest_start=later).status.code == Status.OK
    waits = [KeyValue(key="auto_start", value="false")]
    assert cell.submit("j3", attributes=waits).status.code == Status.OK
    assert cell.command("j3", Ask.START).status.code == Status.DEVICE_NOT_READY


def test_an_earliest_start_is_waited_for(desk: Callable[..., Desk]) -> None:
    cell = desk()
    begin = int(time.time()) + 2
    cell.submit(earliest_start=Time(sec=begin))
    running = cell.until(JobStatus.RUNNING)
    assert running.header.stamp.sec >= begin


def test_only_operators_of_the_list_get_in(desk: Callable[..., Desk], bench: Bench) -> None:
    cell = desk(operators=["Anna", "Zoë"])
    assert cell.submit().status.code == Status.JOB_OPERATOR_REFUSED
    assert cell.submit(operator_name="anna").status.code == Status.JOB_OPERATOR_REFUSED
    assert cell.submit(operator_name="Anna").status.code == Status.OK
    cell.until(JobStatus.RUNNING)
    for name in ("", "Eve", "Anna ", "Anna\u200b"):
        for command in (Ask.ABORT, Ask.PAUSE, Ask.STOP, Ask.CLEAR, 99):
            answer = cell.call(
                JobCommand, "command", job_id="j1", command=command, operator_name=name
            )
            assert answer.status.code == Status.JOB_OPERATOR_REFUSED
    history = cell.call(JobGet, "get", job_id="j1", with_history=True).history
    assert [entry.state for entry in history][-1] == JobStatus.RUNNING, "nothing has changed"
    done = cell.call(
        JobCommand, "command", job_id="j1", command=Ask.ABORT, operator_name="Zoë", reason="end"
    )
    assert done.status.code == Status.OK
    assert "by Zoë: end" in cell.until(JobStatus.ABORTED).status.message


def test_with_a_list_of_operators_a_goal_can_t_be_cancelled_by_anybody(
    desk: Callable[..., Desk], bench: Bench
) -> None:
    cell = desk(operators=["Anna"])
    client = ActionClient(bench.tester, MeasurePart, "measure_part")
    bench.wait(client.server_is_ready)
    job = Job(job_id="j1", part=PartReference(uri=cell.part_uri), operator_name="Eve")
    refused = bench.result(client.send_goal_async(MeasurePart.Goal(job=job)))
    response = bench.result(refused.get_result_async())
    assert response.status == GoalStatus.STATUS_ABORTED
    assert response.result.status.code == Status.JOB_OPERATOR_REFUSED
    job.operator_name = "Anna"
    handle = bench.result(client.send_goal_async(MeasurePart.Goal(job=job)))
    cell.until(JobStatus.RUNNING)
    assert not bench.result(handle.cancel_goal_async()).goals_canceling
    assert cell.states[-1].state == JobStatus.RUNNING


def test_a_job_that_is_over_has_history_and_result_and_can_be_cleared(
    desk: Callable[..., Desk], tmp_path: Path
) -> None:
    cell = desk(start_timeout_s=1.0, calibration_file=calibrate(tmp_path, -2, ("tool",)))
    cell.submit(accept_due_calibration=True, recipe_version="7", part_id="scene2")
    cell.until(JobStatus.ABORTED)
    found = cell.call(JobGet, "get", job_id="j1", with_history=True, with_result=True)
    states = [entry.state for entry in found.history]
    assert states == [JobStatus.ALLOWED_TO_START, *[JobStatus.RUNNING] * 2, JobStatus.ABORTED]
    assert found.history[-1].reason and found.job.recipe_version == "7"
    stamps = [(entry.stamp.sec, entry.stamp.nanosec) for entry in found.history]
    assert stamps == sorted(stamps) and stamps[0][0] > 1_700_000_000
    result = json.loads(found.result)
    assert result == json.loads(Path(found.summary_uri).read_text())
    assert {fact["name"]: fact["state"] for fact in result["calibration"]} == {
        "hand_eye": "missing",
        "tool": "due",
        "tracker_position": "missing",
        "camera": "missing",
    }
    assert result["job"]["accept_due_calibration"] is True
    plain = cell.call(JobGet, "get", job_id="j1")
    assert plain.result == "" and plain.history == []
    for _ in range(2):
        assert cell.command("j1", Ask.CLEAR).job_status.cleared
    assert cell.call(JobList, "list").jobs == []
    assert [s.job_id for s in cell.call(JobList, "list", include_cleared=True).jobs] == ["j1"]
    assert cell.submit(order_id="another").status.code == Status.JOB_CONFLICT


def test_what_was_cancelled_is_in_the_list_no_more(desk: Callable[..., Desk]) -> None:
    cell = desk(auto_start=False)
    for job_id in ("a", "b", "c"):
        cell.submit(job_id)
    assert cell.command("b", Ask.CANCEL).job_status.state == JobStatus.ABORTED
    assert [s.job_id for s in cell.call(JobList, "list").jobs] == ["c", "a"]
    page = cell.call(JobList, "list", limit=1, before_job_id="c", include_cleared=True)
    assert [s.job_id for s in page.jobs] == ["b"]
    aborted = cell.call(JobList, "list", states=[JobStatus.ABORTED], include_cleared=True)
    assert [s.job_id for s in aborted.jobs] == ["b"]
    unknown = cell.call(JobList, "list", before_job_id="nobody")
    assert unknown.status.code == Status.JOB_UNKNOWN


def test_reasons_are_limited_and_change_nothing(desk: Callable[..., Desk]) -> None:
    cell = desk(auto_start=False)
    cell.submit()
    for reason in ("x" * 257, "two\nlines", "\x1b[2J"):
        answer = cell.call(JobCommand, "command", job_id="j1", command=Ask.ABORT, reason=reason)
        assert answer.status.code == Status.JOB_TEXT_REFUSED
    assert cell.call(JobGet, "get", job_id="j1").job_status.state == JobStatus.NOT_ALLOWED_TO_START


def test_the_manual_names_every_code_command_and_state_of_a_job() -> None:
    text = (ROOT / "docs" / "mes.md").read_text(encoding="utf-8")
    message = (ROOT / "skinplan_msgs" / "msg" / "Status.msg").read_text(encoding="utf-8")
    codes = re.findall(
        r"^uint16 ((?:JOB|CALIBRATION|PART)_\w+|RESUME_REFUSED) = (\d+)", message, re.M
    )
    # What can happen to a part once the job runs stands in the manual of the supervisor.
    codes = [(name, code) for name, code in codes if name != "PART_MOVED"]
    assert len(codes) >= 15
    for name, code in codes:
        assert re.search(rf"\b{code}\b[^\n]*`{name}`", text), name
    for command in JobCommands:
        assert f"{command.name} ({command.value})" in text
    for state in JobState:
        assert state.title in text
    for name in (*LIMITS, "jobs/submit", "jobs/get", "jobs/list", "jobs/command", "job_status"):
        assert name in text, name


LIMITS = (
    f"{checks.LONGEST_NAME} characters",
    f"{checks.LONGEST_URI} characters",
    f"{checks.LONGEST_REASON} characters",
    f"{checks.LONGEST_VALUE} characters",
    f"up to {checks.MOST_ATTRIBUTES}",
)
