"""Somebody else's arm takes the place of the mock: the same goals, the same job."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from control_msgs.action import FollowJointTrajectory
from sensor_msgs.msg import JointState

from nodes.bench import Bench
from nodes.device_bench import CONTROLLER, HOME, arm_goal, send
from nodes.small_part import write_small_part
from skinplan.robot.arm import JOINT_NAMES
from skinplan_nodes.conversions import joint_state_from_msg
from skinplan_nodes.graph import GraphSettings, NodeSpec, describe
from skinplan_nodes.mock_ur5 import MockUr5
from skinplan_nodes.qos import STATE
from skinplan_nodes.runner import graph_environment, write_parameters
from system.foreign_arm import ForeignArm

_RUN_S = 900.0


@pytest.fixture
def bench() -> Iterator[Bench]:
    # The foreign arm sleeps in its callback.
    found = Bench(threads=4)
    yield found
    found.close()
    assert not found.failures


def start_arm(bench: Bench, ours: bool) -> None:
    if ours:
        bench.start(MockUr5)
    else:
        make = lambda **kwargs: ForeignArm(  # noqa: E731
            list(JOINT_NAMES),
            HOME.tolist(),
            context=kwargs["context"],
            use_global_arguments=False,
        )
        bench.start(make, simulated=False)


@pytest.mark.parametrize("ours", [True, False])
def test_the_same_client_drives_both(bench: Bench, ours: bool) -> None:
    start_arm(bench, ours)
    states: list[JointState] = bench.collect(JointState, "joint_states", STATE)
    bench.turn_clock(bench.now_s + 0.3)
    goal = HOME + [0.2, -0.1, 0.1, 0.0, 0.1, -0.2]
    _, result = send(
        bench, FollowJointTrajectory, CONTROLLER, arm_goal([0.0, 1.0, 2.0], [HOME, HOME, goal])
    )
    response = bench.result(result, turning=True)
    assert response.status == GoalStatus.STATUS_SUCCEEDED
    assert response.result.error_code == FollowJointTrajectory.Result.SUCCESSFUL
    bench.wait(
        lambda: np.abs(joint_state_from_msg(states[-1])[0] - goal).max() < 1e-4, turning=True
    )
    handle, result = send(
        bench, FollowJointTrajectory, CONTROLLER, arm_goal([0.0, 60.0], [goal, HOME])
    )
    bench.turn_clock(bench.now_s + 1.0)
    bench.result(handle.cancel_goal_async(), turning=True)
    assert bench.result(result, turning=True).status == GoalStatus.STATUS_CANCELED


def specs(settings: GraphSettings) -> list[NodeSpec]:
    """The graph without the mock of the arm, which nobody waits for either."""
    found = []
    for node in describe(settings):
        if node.name == "mock_ur5":
            continue
        if node.name == "cell_supervisor":
            needed: Any = node.parameters["required_nodes"]
            others = [name for name in needed if name != "mock_ur5"]
            node = replace(node, parameters={**node.parameters, "required_nodes": others})
        found.append(node)
    return found


class Processes:
    """Processes of one graph; ends them all."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._environment = graph_environment(dict(os.environ))
        self.started: list[subprocess.Popen[bytes]] = []

    def start(self, name: str, *command: str) -> "subprocess.Popen[bytes]":
        with (self._folder / f"{name}.log").open("wb") as log:
            process = subprocess.Popen(
                [sys.executable, *command],
                stdout=log,
                stderr=subprocess.STDOUT,
                env=self._environment,
            )
        self.started.append(process)
        return process

    def end(self) -> None:
        for process in reversed(self.started):
            process.terminate()
        for process in self.started:
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait(10.0)


@pytest.mark.long
def test_a_job_is_done_with_the_foreign_arm(tmp_path: Path) -> None:
    part = write_small_part(tmp_path)
    runs = tmp_path / "runs"
    runs.mkdir()
    # The foreign arm tells its state at each turn of the clock only: slow time for enough frames.
    settings = GraphSettings(runs, str(part.source), time_factor=2.0)
    processes = Processes(tmp_path)
    try:
        arm = Path(__file__).with_name("foreign_arm.py")
        home = ",".join(str(q) for q in HOME)
        processes.start("foreign_arm", str(arm), ",".join(JOINT_NAMES), home)
        for node in specs(settings):
            given = ("--ros-args", "--params-file", str(write_parameters(node, tmp_path)))
            processes.start(node.name, "-m", node.module, *given)
        client = processes.start(
            "measure",
            *("-m", "skinplan_nodes.measure", "--part-uri", str(part.source)),
            *("--runs-folder", str(runs), "--job-id", "foreign", "--json-lines"),
        )
        assert client.wait(_RUN_S) == 0, (tmp_path / "measure.log").read_text()[-2000:]
    finally:
        processes.end()
    summary = json.loads((runs / "foreign" / "summary.json").read_text())
    assert summary["job"]["state"] == "Ended"
    assert summary["measured"]["area_ratio"] > 0.97
