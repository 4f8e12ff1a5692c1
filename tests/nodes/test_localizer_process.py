"""The localiser as a process of its own, killed in the middle of an approach."""

import functools
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from action_msgs.msg import GoalStatus, GoalStatusArray
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_action_status_default
from skinplan_msgs.msg import Heartbeat, Status

from nodes.bench import Bench
from nodes.localizer_cell import drive, work_place
from skinplan.jobs.model import Job
from skinplan.part.files import load_part
from skinplan.part.model import Part
from skinplan.part.samples import write_sample
from skinplan.robot.cell import CellConfig
from skinplan_nodes.mock_camera import MockCamera
from skinplan_nodes.mock_mir100 import MockMir100
from skinplan_nodes.qos import STATE
from skinplan_nodes.supervisor.cell import Located
from skinplan_nodes.supervisor.control import StepError
from skinplan_nodes.supervisor.ros_cell import RosCell
from skinplan_nodes.supervisor.watch import NodeWatch

CELL = CellConfig()
TIMEOUTS = SimpleNamespace(
    planning_timeout_s=60.0,
    drive_timeout_s=300.0,
    localize_timeout_s=600.0,
    start_timeout_s=60.0,
    stop_timeout_s=20.0,
)


@pytest.fixture(scope="module")
def part(tmp_path_factory: pytest.TempPathFactory) -> Part:
    written = write_sample("scene2", tmp_path_factory.mktemp("part"))
    assert written.source is not None
    return load_part(written.source)


def patiently(bench: Bench, condition: Callable[[], bool], turning: bool = False) -> None:
    """Waits longer than the bench: a process needs long on a busy machine."""
    deadline = time.monotonic() + 90.0
    while not condition():
        assert time.monotonic() < deadline, "the condition did not come true in time"
        if turning:
            bench.turn_clock()
        time.sleep(0.01)


class Localizer:
    """The process."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        command = [sys.executable, "-m", "skinplan_nodes.aruco_localizer", "--ros-args"]
        self._process = subprocess.Popen([*command, "-p", "use_sim_time:=true"])

    def kill(self) -> None:
        assert self._process is not None
        os.kill(self._process.pid, signal.SIGKILL)
        self._process.wait(10)

    def end(self) -> None:
        if self._process is not None and self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(10)
            except subprocess.TimeoutExpired:
                self._process.kill()
                raise


@pytest.fixture
def localizer() -> Iterator[Localizer]:
    found = Localizer()
    yield found
    found.end()


class Caller:
    """The supervisor's own way to its nodes, with the heartbeats it listens to."""

    def __init__(self, bench: Bench, part: Part) -> None:
        self._job = Job("j1", str(part.source))
        node = bench.start(functools.partial(Node, "caller"))
        self.watch = NodeWatch(("aruco_localizer",), silent_max_s=2.5)
        node.create_subscription(
            Heartbeat,
            "heartbeat",
            lambda m: self.watch.beat(m.node, time.monotonic(), m.pid),
            STATE,
        )
        self.cell = RosCell(node, TIMEOUTS, self.watch)
        self.answer: Located | StepError | None = None

    def localize(self) -> threading.Thread:
        self.answer = None
        thread = threading.Thread(target=self._localize)
        thread.start()
        return thread

    def _localize(self) -> None:
        try:
            self.cell.wait_ready()
            self.answer = self.cell.localize(self._job, may_move=True, new_place=True)
        except StepError as error:
            self.answer = error


def ids_of(message: GoalStatusArray) -> set[bytes]:
    return {bytes(item.goal_info.goal_id.uuid) for item in message.status_list}


def status_of(message: GoalStatusArray, number: bytes) -> int | None:
    items = message.status_list
    return next((m.status for m in items if bytes(m.goal_info.goal_id.uuid) == number), None)


@pytest.mark.long
def test_kill_9_in_the_middle_of_an_approach(
    bench: Bench, part: Part, localizer: Localizer
) -> None:
    bench.start(MockMir100, part_uri=str(part.source), seed=3)
    bench.start(MockCamera, part_uri=str(part.source), seed=3)
    odometry = bench.collect(Odometry, "odom", STATE)
    goals: list[Any] = []
    bench.tester.create_subscription(
        GoalStatusArray,
        "navigate_to_pose/_action/status",
        goals.append,
        qos_profile_action_status_default,
    )
    localizer.start()
    drive(bench, work_place(part))
    before = ids_of(goals[-1])
    caller = Caller(bench, part)
    thread = caller.localize()

    def moving() -> bool:
        return ids_of(goals[-1]) > before and abs(odometry[-1].twist.twist.linear.x) > 0.05

    patiently(bench, lambda: not caller.watch.absent(time.monotonic()))
    patiently(bench, lambda: moving() or caller.answer is not None, turning=True)
    assert caller.answer is None, caller.answer
    (orphan,) = ids_of(goals[-1]) - before
    localizer.kill()
    # Time stands: the base is in the middle of its drive when the caller notices.
    patiently(bench, lambda: caller.answer is not None)
    thread.join(10.0)
    assert isinstance(caller.answer, StepError)
    assert (caller.answer.code, caller.answer.node) == (Status.NODE_LOST, "aruco_localizer")
    assert "aruco_localizer was lost" in str(caller.answer)

    localizer.start()
    patiently(bench, lambda: not caller.watch.absent(time.monotonic()))
    cancelled = lambda: status_of(goals[-1], orphan) == GoalStatus.STATUS_CANCELED  # noqa: E731
    patiently(bench, cancelled, turning=True)
    bench.wait(lambda: odometry[-1].twist.twist == Twist(), turning=True)
    stood = odometry[-1].pose.pose
    bench.turn_clock(bench.now_s + 2.0)
    bench.wait(lambda: odometry[-1].header.stamp.sec >= bench.now_s - 1.5, turning=True)
    assert odometry[-1].pose.pose == stood

    thread = caller.localize()
    patiently(bench, lambda: caller.answer is not None, turning=True)
    thread.join(10.0)
    assert isinstance(caller.answer, Located), caller.answer
    assert caller.answer.quality >= CELL.quality.threshold
