"""Nodes that are killed come back, in a graph of two: the clock and a planner."""

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

import psutil
import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from skinplan_msgs.msg import Heartbeat

from nodes.small_part import write_small_part
from skinplan_nodes.conversions import stamp_from_msg
from skinplan_nodes.qos import STATE
from system.graph_run import TIMEOUT_S, GraphRun, command_of
from system.test_processes import wait_for

CLOCK, PLANNER, SUPERVISOR = "sim_clock", "scan_path_planner", "cell_supervisor"


class Ear:
    """Hears the time and the heartbeats of the graph."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self.pids: dict[str, list[int]] = {CLOCK: [], PLANNER: []}
        self._context = Context()
        rclpy.init(args=[], context=self._context)
        self._node = Node("ear", context=self._context, use_global_arguments=False)
        self._node.create_subscription(Clock, "/clock", self._on_clock, STATE)
        self._node.create_subscription(Heartbeat, "heartbeat", self._on_beat, STATE)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()

    def close(self) -> None:
        rclpy.shutdown(context=self._context)
        self._thread.join(20.0)
        self._node.destroy_node()

    def _on_clock(self, message: Clock) -> None:
        self.times.append(stamp_from_msg(message.clock))

    def _on_beat(self, message: Heartbeat) -> None:
        self.pids[message.node.strip("/")].append(message.pid)

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            pass


@pytest.fixture
def ear() -> Iterator[Ear]:
    found = Ear()
    yield found
    found.close()


@pytest.fixture
def run(tmp_path: Path) -> Iterator[GraphRun]:
    part = write_small_part(tmp_path)
    assert part.source is not None
    nodes = ["--serve", "--only", CLOCK, "--only", PLANNER]
    options = ["--time-factor", "20", "--restarts", "2", "--job-id", "cell"]
    found = GraphRun(tmp_path / "runs", part.source, *nodes, *options)
    yield found
    found.close()


def kill(run: GraphRun, name: str) -> psutil.Process:
    """Kills a node's process as it dies in the field: without a word."""
    there: list[psutil.Process] = []

    def found() -> bool:
        module = f"skinplan_nodes.{name}"
        there[:] = [p for p in run.processes() if module in command_of(p)[:6]]
        return bool(there)

    wait_for(found)
    (process,) = there
    process.send_signal(signal.SIGKILL)
    return process


def until_back(run: GraphRun, name: str, count: int) -> None:
    """Waits until a node has been started again for the count-th time."""
    wanted = {"event": "node_restarted", "node": name, "restarts": count}
    run.until(lambda event: event == wanted)


def test_clock_and_planner_come_back_after_kill_9(run: GraphRun, ear: Ear) -> None:
    wait_for(lambda: len(ear.times) > 20 and bool(ear.pids[CLOCK]) and bool(ear.pids[PLANNER]))
    last_s = ear.times[-1]
    killed = kill(run, CLOCK)
    until_back(run, CLOCK, 1)
    wait_for(lambda: ear.pids[CLOCK][-1] != killed.pid and ear.times[-1] > last_s + 5.0)
    assert ear.times == sorted(ear.times), "time never runs back"
    assert max(b - a for a, b in zip(ear.times, ear.times[1:], strict=False)) < 20.0, "no jump"
    killed = kill(run, PLANNER)
    until_back(run, PLANNER, 1)
    wait_for(lambda: ear.pids[PLANNER][-1] != killed.pid)
    same = "/cell/scan_path_planner.params.yaml"
    assert any(word.endswith(same) for word in command_of(run.node(PLANNER))), "the same parameters"
    died = [e for e in run.events if e["event"] == "node_died"]
    assert [(e["node"], e["signal"], e["restarted"]) for e in died] == [
        (CLOCK, 9, True),
        (PLANNER, 9, True),
    ]
    run.process.send_signal(signal.SIGINT)
    assert run.wait() == 130
    run.wait_gone()


def test_a_node_that_dies_again_and_again_ends_the_graph(run: GraphRun) -> None:
    run.until(lambda e: e["event"] == "graph")
    for count in (1, 2):
        kill(run, CLOCK)
        until_back(run, CLOCK, count)
    kill(run, CLOCK)
    assert run.wait() == 1
    last = run.events[-1]
    assert (last["event"], last["node"], last["restarted"]) == ("node_died", CLOCK, False)
    run.wait_gone()


def test_a_run_that_nobody_listens_to_leaves_nothing(run: GraphRun) -> None:
    run.until(lambda e: e["event"] == "graph")
    assert run.process.stdout is not None
    # The reader has this end open: closed below it, as when the listener is killed.
    os.dup2(os.open(os.devnull, os.O_RDONLY), run.process.stdout.fileno())
    kill(run, CLOCK)
    assert run.process.wait(TIMEOUT_S) == 143
    run.wait_gone()


@pytest.mark.long
def test_the_job_client_goes_on_with_a_supervisor_that_comes_back(tmp_path: Path) -> None:
    """The job waits for nodes that never come: long enough to kill the supervisor meanwhile."""
    part = write_small_part(tmp_path)
    assert part.source is not None
    nodes = ["--serve", "--only", CLOCK, "--only", SUPERVISOR, "--job-id", "cell"]
    run = GraphRun(tmp_path / "runs", part.source, *nodes)
    client = None
    try:
        client = Client(run, part.source, tmp_path)
        client.until(lambda event: event.get("sub_state") == "starting")
        seen = len(client.events)
        kill(run, SUPERVISOR)
        until_back(run, SUPERVISOR, 1)
        client.until(lambda event: event["event"] == "status", seen)
        assert client.process.poll() is None
        client.process.send_signal(signal.SIGINT)
        assert client.process.wait(60.0) == 1
        client.until(lambda event: event["event"] == "result", seen)
        assert client.events[-1]["state"] == "Aborted"
    finally:
        if client is not None:
            client.close()
        run.close()


class Client:
    """The job client as a program of its own."""

    def __init__(self, run: GraphRun, part_file: Path, folder: Path) -> None:
        domain = run.until(lambda event: event["event"] == "graph")["ros_domain_id"]
        command = [sys.executable, "-P", "-m", "skinplan_nodes.measure", "--job-id", "job"]
        command += ["--part-uri", str(part_file), "--runs-folder", str(folder / "runs")]
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
        self.events: list[dict[str, Any]] = []
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def until(self, condition: Callable[[dict[str, Any]], bool], begin: int = 0) -> None:
        """Waits for an event."""
        deadline = time.monotonic() + TIMEOUT_S
        while not any(condition(event) for event in self.events[begin:]):
            assert time.monotonic() < deadline, self.events[-3:]
            time.sleep(0.05)

    def close(self) -> None:
        """Ends it, whatever happened."""
        self.process.kill()
        self.process.wait(20.0)
        self._reader.join(20.0)

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.events.append(json.loads(line))
