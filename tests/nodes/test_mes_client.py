"""The reference MES client against a small cell: orders, a pause, an abort, a supervisor killed."""

import functools
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import rclpy

from flooding import Floods, check_answers
from mes_orders import (
    OVER,
    MesClient,
    check,
    hand_in,
    kill_process,
    orders_of,
    work_through,
    write_parts,
)
from nodes.bench import Bench
from nodes.supervised_cell import SupervisedCell
from skinplan.jobs.store import JobStore

VALUES = {
    "report": False,
    "certify_motion": False,
    "calibration_required": False,
    "required_nodes": [""],
    "operators": ["Anna"],
}


class Supervisor:
    """The supervisor as a process that is started again after it was killed."""

    def __init__(self, runs: Path) -> None:
        self._command = [sys.executable, "-m", "skinplan_nodes.cell_supervisor", "--ros-args"]
        for name, value in {**VALUES, "runs_folder": str(runs)}.items():
            text = value if isinstance(value, str) else json.dumps(value)
            self._command += ["-p", f"{name}:={text}"]
        self.process = subprocess.Popen(self._command)

    def kill(self) -> None:
        kill_process(self.process.pid)
        self.process.wait(10)
        self.process = subprocess.Popen(self._command)

    def end(self) -> None:
        self.process.terminate()
        self.process.wait(30)


@pytest.fixture
def cell() -> Iterator[SupervisedCell]:
    bench = Bench(threads=8)
    yield bench.start(functools.partial(SupervisedCell), simulated=False)
    bench.close()
    assert not bench.failures


@pytest.fixture
def client() -> Iterator[MesClient]:
    rclpy.init(args=[])
    found = MesClient("Anna")
    yield found
    found.node.destroy_node()
    rclpy.try_shutdown()


@pytest.mark.parametrize(
    "events",
    [
        {1: "abort"},
        pytest.param({1: "pause", 2: "abort", 3: "kill"}, marks=pytest.mark.long),
    ],
)
def test_orders_are_worked_off_fetched_and_acknowledged(
    tmp_path: Path, cell: SupervisedCell, client: MesClient, events: dict[int, str]
) -> None:
    supervisor = Supervisor(tmp_path / "runs")
    try:
        orders = orders_of(write_parts(tmp_path), max(events) + 1)
        hand_in(client, orders)
        check(work_through(client, orders, events, supervisor.kill, 120.0), events)
    finally:
        supervisor.end()
    store = JobStore(tmp_path / "runs" / "jobs.sqlite", copy=True)
    assert len(store.list()) == len(orders) and store.list(include_cleared=False) == ()
    store.close()


def test_a_flood_of_calls_is_answered_and_changes_nothing(
    tmp_path: Path, cell: SupervisedCell, client: MesClient
) -> None:
    supervisor = Supervisor(tmp_path / "runs")
    parts = write_parts(tmp_path)
    (order,) = orders_of(parts, 1)
    floods = None
    try:
        cell.arm.never_ends = True
        assert client.submit(order).status.code == 1
        client.spin(2.0)
        floods = Floods(2, 150, order["job_id"], str(parts[0]))
        check_answers(floods.reports(), 300)
        assert client.look(order["job_id"]).state not in OVER
        cell.arm.never_ends = False
        client.follow(order["job_id"], 60.0)
        history = client.fetch(order["job_id"]).history
        check({order["job_id"]: client.fetch(order["job_id"])}, {})
        assert not [entry for entry in history if "command" in entry.reason]
    finally:
        if floods is not None:
            floods.close()
        supervisor.end()
    store = JobStore(tmp_path / "runs" / "jobs.sqlite", copy=True)
    assert [record.job.job_id for record in store.list()] == [order["job_id"]]
    store.close()
