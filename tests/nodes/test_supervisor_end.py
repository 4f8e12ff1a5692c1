"""What a supervisor that ends still waits for: nothing, whatever the cell does."""

import threading
import time
from types import SimpleNamespace

import pytest
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from nodes.bench import TIMEOUT_S, Bench
from skinplan.robot.arm import JOINT_NAMES
from skinplan_nodes.conversions import stamp_to_msg
from skinplan_nodes.qos import STATE
from skinplan_nodes.supervisor.control import StepError
from skinplan_nodes.supervisor.ros_cell import RosCell
from skinplan_nodes.supervisor.watch import NodeWatch

# Longer than any test may last: only the end of the program ends such a wait.
_FOREVER_S = 1000.0
TIMEOUTS = SimpleNamespace(
    planning_timeout_s=_FOREVER_S,
    drive_timeout_s=_FOREVER_S,
    localize_timeout_s=_FOREVER_S,
    start_timeout_s=_FOREVER_S,
    stop_timeout_s=_FOREVER_S,
)


def keeps_moving(bench: Bench) -> list[int]:
    """Publishes an arm and a base that no stop brings to rest; returns a count of the messages."""
    joints = bench.tester.create_publisher(JointState, "joint_states", STATE)
    odometry = bench.tester.create_publisher(Odometry, "odom", STATE)
    ticks = [0]

    def tick() -> None:
        ticks[0] += 1
        now_s = 0.05 * ticks[0]
        position = [0.1 * now_s] * len(JOINT_NAMES)
        state = JointState(name=list(JOINT_NAMES), position=position, velocity=[0.1] * 6)
        state.header.stamp = stamp_to_msg(now_s)
        joints.publish(state)
        place = Odometry()
        place.header.stamp = stamp_to_msg(now_s)
        place.pose.pose.position.x = 0.5 * now_s
        place.pose.pose.orientation.w = 1.0
        odometry.publish(place)

    bench.tester.create_timer(0.02, tick)
    return ticks


def test_an_arm_that_moves_on_does_not_hold_up_the_end(bench: Bench) -> None:
    ticks = keeps_moving(bench)
    cell = RosCell(bench.tester, TIMEOUTS, NodeWatch(()))
    bench.wait(lambda: cell.arm_joints() is not None)
    failed: list[StepError] = []

    def halt() -> None:
        try:
            cell.halt(stop_devices=True)
        except StepError as error:
            failed.append(error)

    job_thread = threading.Thread(target=halt, daemon=True)
    job_thread.start()
    looked = ticks[0] + 100
    bench.wait(lambda: ticks[0] > looked)
    assert job_thread.is_alive(), "it waits until the arm stands"
    cell.waiter.end_by(time.monotonic())
    job_thread.join(TIMEOUT_S)
    assert not job_thread.is_alive()
    assert [(error.node, "the arm moves at" in str(error)) for error in failed] == [
        ("follow_joint_trajectory", True)
    ]


def test_what_is_asked_after_the_end_is_still_asked(bench: Bench) -> None:
    asked: list[str] = []

    def answer(name: str, response: SetBool.Response | Trigger.Response) -> object:
        asked.append(name)
        response.success = True
        return response

    for name in ("arm/stop", "base/stop"):
        bench.tester.create_service(Trigger, name, lambda _, made, name=name: answer(name, made))
    bench.tester.create_service(SetBool, "scanner/enable", lambda _, made: answer("scanner", made))
    cell = RosCell(bench.tester, TIMEOUTS, NodeWatch(()))
    names = ("arm/stop", "base/stop", "scanner/enable")
    wanted = [c for c in bench.tester.clients if c.srv_name.lstrip("/") in names]
    assert len(wanted) == 3
    bench.wait(lambda: all(client.service_is_ready() for client in wanted))
    cell.waiter.end_by(time.monotonic())
    cell.halt(stop_devices=True)
    bench.wait(lambda: sorted(asked) == ["arm/stop", "base/stop", "scanner"])


def test_what_nobody_serves_is_not_waited_for_at_the_end(bench: Bench) -> None:
    cell = RosCell(bench.tester, TIMEOUTS, NodeWatch(()))
    cell.waiter.end_by(time.monotonic())
    with pytest.raises(StepError, match=r"service /?recorder/stop: nobody serves it at the end"):
        cell.stop_recording()
