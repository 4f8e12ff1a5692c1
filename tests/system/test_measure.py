"""One mission through the whole graph, read back from its folder and its bag; and how runs end."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from nodes.small_part import write_small_part
from skinplan.inspection.cloud import read_ply
from skinplan.jobs.model import JobState
from skinplan.jobs.store import JobStore
from skinplan.recording.heal import heal_bag
from skinplan.robot.cell import CellConfig
from system.graph_run import TIMEOUT_S, GraphRun

# Another program of the shop: nothing but rclpy and the interfaces.
MES_BRIDGE = """
import sys, time, rclpy
from skinplan_msgs.srv import JobCommand, JobGet
rclpy.init()
node = rclpy.create_node("mes_bridge")
get = node.create_client(JobGet, "jobs/get")
command = node.create_client(JobCommand, "jobs/command")

def call(client, request):
    assert client.wait_for_service(20.0), "nobody serves " + client.srv_name
    answer = client.call_async(request)
    rclpy.spin_until_future_complete(node, answer, timeout_sec=20.0)
    return answer.result()

job_id = sys.argv[1]
found = call(get, JobGet.Request(job_id=job_id))
print(found.status.code, found.job.job_id, found.job.serial_number, found.job_status.state)
# A command answers at once; what it does is seen in the state a moment later.
PAUSE, RESUME, INTERRUPTED, RUNNING = JobCommand.Request.PAUSE, JobCommand.Request.RESUME, 3, 2
for number, wanted in ((PAUSE, INTERRUPTED), (PAUSE, INTERRUPTED), (RESUME, RUNNING)):
    status = call(command, JobCommand.Request(job_id=job_id, command=number)).status
    for _ in range(200):
        state = call(get, JobGet.Request(job_id=job_id)).job_status.state
        if state == wanted:
            break
        time.sleep(0.1)
    print(status.code, state)
"""


@pytest.fixture(scope="module")
def part_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A panel with a bump; high enough for its markers to stay in view near by."""
    folder = tmp_path_factory.mktemp("part")
    source = write_small_part(folder, size_m=(0.6, 0.5)).source
    assert source is not None
    return source


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, part_file: Path) -> Iterator[GraphRun]:
    folder = tmp_path_factory.mktemp("runs")
    arguments = ["--time-factor", "10", "--job-id", "job-1", "--serial-number", "S-7"]
    found = GraphRun(folder, part_file, *arguments)
    yield found
    found.close()


@pytest.fixture(scope="module")
def mes_answer(run: GraphRun) -> str:
    """What another program is told while the job is running."""
    run.until_sub_state("planning")
    command = [sys.executable, "-P", "-c", MES_BRIDGE, "job-1"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    return done.stdout.strip() or done.stderr


@pytest.fixture(scope="module")
def folder(run: GraphRun, mes_answer: str) -> Path:
    """The run's folder, after the job ended well."""
    code = run.wait()
    last = run.events[-1]
    assert (code, last["event"], last["state"], last["error"]) == (0, "result", "Ended", "")
    return Path(last["run_folder"])


@pytest.fixture(scope="module")
def summary(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "summary.json").read_text())


@pytest.fixture
def start(tmp_path: Path, part_file: Path) -> Iterator[Callable[..., GraphRun]]:
    runs: list[GraphRun] = []

    def begin(*arguments: str) -> GraphRun:
        runs.append(GraphRun(tmp_path / "runs", part_file, "--time-factor", "10", *arguments))
        return runs[-1]

    yield begin
    for found in runs:
        found.close()


def test_another_program_gets_the_state(mes_answer: str) -> None:
    assert mes_answer.splitlines()[0] == "1 job-1 S-7 2"


def test_another_program_pauses_and_resumes(mes_answer: str) -> None:
    # OK and Interrupted; refused, because it is interrupted already; OK and Running.
    assert mes_answer.splitlines()[1:] == ["1 3", "803 3", "1 2"]


def test_run_leaves_no_process(run: GraphRun, folder: Path) -> None:
    run.wait_gone()
    assert run.processes() == []


def test_summary_has_all_keys(summary: dict[str, Any]) -> None:
    keys = {
        "job": {"id", "state"},
        "mesh": {"triangles", "area_m2", "sha256"},
        "scan_path": {"points", "row_points", "feature_points", "regions"},
        "coverage": {
            "area_ratio",
            "feature_area_ratio",
            "rows_only_area_ratio",
            "rows_only_feature_area_ratio",
        },
        "stations": {"count", "candidates", "lower_bound", "proven_optimal", "reached_ratio"},
        "trajectory": {
            "scan_s",
            "transit_s",
            "base_s",
            "cycle_s",
            "lower_bound_s",
            "breaks",
            "tcp_path_m",
            "skipped",
            "order",
        },
        "planning_s": {"mesh", "scan_path", "coverage", "stations", "trajectory", "total"},
        "measured": {"points", "area_ratio", "feature_area_ratio", "deviation_rms_m"},
        "bag": {"path", "messages", "bytes"},
    }
    for section, names in keys.items():
        assert names <= set(summary[section]), section
    assert len(summary["plan_hash"]) == 64
    assert summary["job"] == {**summary["job"], "id": "job-1", "state": "Ended"}
    assert "error" not in summary


def test_part_is_located_at_every_station(summary: dict[str, Any]) -> None:
    entries = summary["localization"]
    assert [entry["station"] for entry in entries] == list(range(summary["stations"]["count"] + 1))
    for entry in entries:
        assert entry["E"] >= CellConfig().quality.threshold
        # The base stood up to 50 mm beside its goal.
        assert entry["position_error_m"] < 0.005
        assert entry["angle_error_rad"] < 0.01


def test_part_is_measured(summary: dict[str, Any], folder: Path) -> None:
    assert summary["measured"]["area_ratio"] > 0.95
    assert summary["measured"]["deviation_rms_m"] < 2e-4
    assert len(read_ply(folder / "cloud.ply").points) == summary["measured"]["points"]


def test_folder_is_complete(folder: Path) -> None:
    files = {"summary.json", "report.html", "cloud.ply"}
    files |= {f"plan/{name}.json" for name in ("scan_path", "stations", "trajectories")}
    files |= {"bag/metadata.yaml", "log/job.log", "log/station_planner.log"}
    assert [name for name in sorted(files) if not (folder / name).is_file()] == []
    assert list(folder.rglob(".*")) == [], "no temporary file is left"


def test_bag_is_read_by_rosbags(folder: Path, summary: dict[str, Any]) -> None:
    with AnyReader([folder / "bag"]) as reader:
        assert reader.message_count == summary["bag"]["messages"]
        counts = {c.topic: c.msgcount for c in reader.connections}
        for connection, _, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)
    names = {"/joint_states", "/tf", "/tf_static", "/odom", "/clock", "/scanner/points"}
    names |= {"/camera/color/image_raw", "/part_pose", "/scan_path", "/station_plan"}
    names |= {"/trajectory_plan", "/job_status", "/heartbeat", "/tracker/scanner_pose"}
    assert {name for name in names if not counts.get(name)} == set()


def test_bag_is_decoded_by_mcap_ros2_support(folder: Path, summary: dict[str, Any]) -> None:
    topics, images = set(), 0
    with next((folder / "bag").glob("*.mcap")).open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            topics.add(channel.topic)
            images += channel.topic == "/camera/color/image_raw" and message.width == 1280
    assert len(topics) >= 12
    assert images > 0


def test_events_tell_the_way_of_the_job(run: GraphRun, folder: Path) -> None:
    states = [e for e in run.events if e["event"] == "status"]
    names = [e["sub_state"] for e in states]
    order = ["driving", "localizing", "planning", "scanning", "inspecting", "closing"]
    assert [name for name in dict.fromkeys(names) if name in order] == order
    shares = [e["progress"] for e in states]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


@pytest.mark.long
def test_killed_node_ends_the_job_with_its_name(start: Callable[..., GraphRun]) -> None:
    run = start("--job-id", "job-2", "--restarts", "0")
    run.until_sub_state("localizing")
    run.node("station_planner").send_signal(signal.SIGTERM)
    killed_s = time.monotonic()
    over = run.until(lambda e: e.get("state") == "Aborted")
    assert time.monotonic() - killed_s < 10.0
    assert run.wait() == 1
    died = next(event for event in run.events if event["event"] == "node_died")
    assert died["node"] == "station_planner"
    assert over["job_id"] == "job-2"
    last = run.events[-1]
    assert last["event"] == "result"
    assert "station_planner" in last["error"]
    folder = Path(last["run_folder"])
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["job"]["state"] == "Aborted"
    assert summary["error"]["node"] == "station_planner"
    assert summary["error"]["code"] == 603
    with AnyReader([folder / "bag"]) as reader:
        assert reader.message_count > 0
    run.wait_gone()


def test_interrupt_ends_everything_in_time(start: Callable[..., GraphRun]) -> None:
    run = start("--job-id", "job-3")
    run.until_sub_state("driving")
    assert len(run.processes()) > 20
    began_s = time.monotonic()
    run.process.send_signal(signal.SIGINT)
    assert run.wait(15.0) == 130
    assert time.monotonic() - began_s < 5.0
    assert run.processes() == []
    assert run.events[-1]["event"] == "result"
    folder = Path(run.events[-1]["run_folder"])
    assert json.loads((folder / "summary.json").read_text())["job"]["state"] == "Aborted"
    with AnyReader([folder / "bag"]) as reader:
        assert reader.message_count > 0


def test_interrupt_leaves_a_summary_when_the_bag_is_not_closed(
    start: Callable[..., GraphRun],
) -> None:
    run = start("--job-id", "job-4")
    run.until_sub_state("driving")
    bag = Path(run.events[0]["log_folder"]).parent / "bag"
    deadline = time.monotonic() + TIMEOUT_S
    while sum(file.stat().st_size for file in bag.glob("*.mcap")) < 1_000_000:
        assert time.monotonic() < deadline, "the bag does not grow"
        time.sleep(0.02)
    # It answers as late as one whose disk is busy for long.
    run.node("run_recorder").send_signal(signal.SIGSTOP)
    began_s = time.monotonic()
    run.process.send_signal(signal.SIGINT)
    assert run.wait(15.0) == 130
    assert time.monotonic() - began_s < 5.0
    assert run.processes() == []
    folder = Path(run.events[-1]["run_folder"])
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["job"]["state"] == "Aborted"
    assert summary["error"]["message"] == "the command ABORT was given: interrupted"
    assert summary["bag"]["closed"] is False
    assert summary["bag"]["error"].startswith("service recorder/stop: no answer when")
    heal_bag(bag)
    with AnyReader([bag]) as reader:
        assert reader.message_count > 0
    with closing(JobStore(folder / "log" / "jobs.sqlite")) as store:
        assert store.get("job-4").state is JobState.ABORTED


# In the normal run the process manager alone is killed, see test_processes.py.
@pytest.mark.long
def test_killed_runner_leaves_no_process(start: Callable[..., GraphRun]) -> None:
    run = start("--serve")
    run.until(lambda event: event["event"] == "graph")
    # All nodes, each with honcho's reader, and the runner.
    deadline = time.monotonic() + 30.0
    while len(run.processes()) < 27:
        assert time.monotonic() < deadline
        time.sleep(0.1)
    os.kill(run.process.pid, signal.SIGKILL)
    run.process.wait(10.0)
    run.wait_gone()
