"""Every fault of the mock devices: the state they tell, how the goal ends, and that nothing moves.

The nodes are real ones, and so are the messages; only time is turned by hand.
"""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from control_msgs.action import FollowJointTrajectory
from geometry_msgs.msg import Point, PoseStamped
from sensor_msgs.msg import CameraInfo, Image
from skinplan_msgs.msg import DeviceState, Status

from nodes.bench import Bench
from nodes.device_bench import HOME, Devices, follow, navigate
from nodes.small_part import write_small_part
from skinplan.errors import InputError
from skinplan.robot.cell import CellConfig
from skinplan.transforms import difference, planar
from skinplan_nodes.conversions import (
    image_from_msg,
    pose_from_msg,
    pose_stamped_from_msg,
    pose_stamped_to_msg,
    stamp_from_msg,
)
from skinplan_nodes.mock_camera import MockCamera
from skinplan_nodes.mock_mir100 import FAILED_TO_MAKE_PROGRESS, MockMir100
from skinplan_nodes.mock_ur5 import MockUr5
from skinplan_nodes.qos import IMAGE, LATCHED, STATE

FAR = planar(9.0, -1.0, 0.0)
_Arm = FollowJointTrajectory.Result
# Longest braking: highest speed over deceleration, and two turns of the clock [s].
ARM_STANDS_S, BASE_STANDS_S = 0.2 / 5.0 + 0.2, 1.0 / 1.5 + 0.2


@pytest.fixture(scope="module")
def part_uri(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(write_small_part(tmp_path_factory.mktemp("part")).source)


def moving_arm(bench: Bench, **parameters: Any) -> tuple[Devices, Any]:
    """Starts an arm on a long way; returns what listens, and the future of the result."""
    devices = Devices(bench)
    bench.start(MockUr5, **parameters)
    bench.turn_clock(bench.now_s + 0.3)
    _, result = follow(bench, [0.0, 10.0], [HOME, HOME + 1.0])
    devices.wait_until_moving("arm")
    return devices, result


def driving_base(bench: Bench, part_uri: str, **parameters: Any) -> tuple[Devices, Any]:
    devices = Devices(bench)
    bench.start(MockMir100, part_uri=part_uri, **parameters)
    bench.turn_clock(bench.now_s + 0.3)
    _, result = navigate(bench, FAR)
    devices.wait_until_moving("base")
    return devices, result


@pytest.mark.parametrize(
    ("fault", "state", "after"),
    [
        ("protective_stop", DeviceState.FAULT, DeviceState.FAULT),
        ("emergency_stop", DeviceState.EMERGENCY_STOP, DeviceState.STOPPED),
    ],
)
def test_arm_stops_and_takes_no_goal_until_it_is_reset(
    bench: Bench, fault: str, state: int, after: int
) -> None:
    devices, result = moving_arm(bench)
    devices.make("mock_ur5", fault)
    stopped_s = bench.now_s
    response = bench.result(result, turning=True)
    assert response.status == GoalStatus.STATUS_ABORTED
    assert response.result.error_code == _Arm.INVALID_GOAL
    assert response.result.error_string.startswith(f"{fault}: ")
    told = devices.wait_for("arm", state, fault)
    assert told.device == "arm" and told.message
    assert devices.stands("arm", stopped_s + ARM_STANDS_S)
    assert not devices.states["arm"][-1].moving
    refused = bench.result(follow(bench, [0.0, 10.0], [HOME, HOME])[1], turning=True)
    assert refused.status == GoalStatus.STATUS_ABORTED and fault in refused.result.error_string
    answer = devices.trigger("arm/reset")
    assert not answer.success and fault in answer.message
    devices.end("mock_ur5")
    devices.wait_for("arm", after, fault if after == DeviceState.FAULT else "")
    assert devices.trigger("arm/reset").success
    devices.wait_for("arm", DeviceState.READY)


def test_arm_that_stops_following_violates_its_path(bench: Bench) -> None:
    devices, result = moving_arm(bench)
    devices.make("mock_ur5", "stops_following")
    stopped_s = bench.now_s
    response = bench.result(result, turning=True)
    assert response.result.error_code == _Arm.PATH_TOLERANCE_VIOLATED
    assert response.result.error_string.startswith("stops_following: path tolerance violated")
    assert "at most 0.2 rad" in response.result.error_string
    devices.wait_for("arm", DeviceState.FAULT, "stops_following")
    assert devices.stands("arm", stopped_s + ARM_STANDS_S)
    assert not devices.trigger("arm/reset").success
    devices.end("mock_ur5")
    assert devices.trigger("arm/reset").success


def test_arm_is_slowed_down_and_says_so(bench: Bench) -> None:
    devices, result = moving_arm(bench)
    devices.make("mock_ur5", "slow", speed_percent=20.0)
    bench.turn_clock(bench.now_s + 1.0)
    bench.wait(lambda: abs(devices.joints[-1].velocity[0] - 0.02) < 1e-4, turning=True)
    devices.end("mock_ur5")
    response = bench.result(result, turning=True)
    assert response.result.error_code == _Arm.SUCCESSFUL


def test_stop_of_the_arm_holds_until_reset(bench: Bench) -> None:
    devices, result = moving_arm(bench)
    assert devices.trigger("arm/stop").success
    stopped_s = bench.now_s
    response = bench.result(result, turning=True)
    assert response.result.error_string.startswith("stopped: ")
    devices.wait_for("arm", DeviceState.STOPPED)
    assert devices.stands("arm", stopped_s + ARM_STANDS_S)
    assert not devices.enable("arm", True).success, "switching on is no reset"
    assert devices.trigger("arm/reset").success
    devices.wait_for("arm", DeviceState.READY)
    assert devices.enable("arm", False).success
    devices.wait_for("arm", DeviceState.DISABLED)
    assert devices.enable("arm", True).success


def test_blocked_base_gives_up_after_its_patience(bench: Bench, part_uri: str) -> None:
    devices, result = driving_base(bench, part_uri, patience_s=2.0)
    # The clock turns on while the fault is asked for.
    asked_s = bench.now_s
    devices.make("mock_mir100", "blocked")
    stopped_s = bench.now_s
    response = bench.result(result, turning=True)
    assert response.status == GoalStatus.STATUS_ABORTED
    assert response.result.error_code == FAILED_TO_MAKE_PROGRESS
    assert response.result.error_msg.startswith("blocked: ")
    assert asked_s + 1.8 < bench.now_s
    devices.wait_for("base", DeviceState.FAULT, "blocked")
    assert devices.stands("base", stopped_s + BASE_STANDS_S)
    assert not devices.trigger("base/reset").success
    devices.end("mock_mir100")
    assert devices.trigger("base/reset").success
    devices.wait_for("base", DeviceState.READY)


def test_base_goes_on_when_the_way_is_free_again(bench: Bench, part_uri: str) -> None:
    devices, result = driving_base(bench, part_uri)
    devices.make("mock_mir100", "blocked", duration=2.0)
    response = bench.result(result, turning=True)
    assert response.status == GoalStatus.STATUS_SUCCEEDED
    assert difference(pose_from_msg(devices.odometry[-1].pose.pose), FAR)[0] < 1e-6


def test_lost_base_stands_refuses_and_is_uncertain(bench: Bench, part_uri: str) -> None:
    devices, result = driving_base(bench, part_uri)
    devices.make("mock_mir100", "lost")
    stopped_s = bench.now_s
    response = bench.result(result, turning=True)
    assert response.result.error_code != 0
    assert response.result.error_msg.startswith("lost: ")
    devices.wait_for("base", DeviceState.FAULT, "lost")
    assert devices.stands("base", stopped_s + BASE_STANDS_S)
    assert devices.odometry[-1].pose.covariance[0] >= 1e6
    refused = bench.result(navigate(bench, FAR)[1], turning=True)
    assert refused.status == GoalStatus.STATUS_ABORTED
    devices.end("mock_mir100")
    assert devices.trigger("base/reset").success
    bench.wait(lambda: devices.odometry[-1].pose.covariance[0] < 1.0, turning=True)


def test_base_that_never_answers_stands_and_says_nothing(bench: Bench, part_uri: str) -> None:
    devices, result = driving_base(bench, part_uri)
    devices.make("mock_mir100", "never_answers")
    stopped_s = bench.now_s
    assert devices.stands("base", stopped_s + BASE_STANDS_S, for_s=20.0)
    assert not result.done()
    devices.end("mock_mir100")
    response = bench.result(result, turning=True)
    assert response.result.error_msg.startswith("never_answers: ")
    assert devices.stands("base", bench.now_s)


def test_localisation_jumps_and_odometry_does_not(bench: Bench, part_uri: str) -> None:
    devices, result = driving_base(bench, part_uri)
    truth = bench.collect(PoseStamped, "truth/base_pose", STATE)
    bench.wait(lambda: truth, turning=True)
    count = len(devices.odometry)
    devices.make("mock_mir100", "jump", jump=0.08)
    assert bench.result(result, turning=True).status == GoalStatus.STATUS_SUCCEEDED
    told = devices.odometry[count:]
    places = np.array([pose_from_msg(m.pose.pose)[:2, 3] for m in told])
    stamps = np.array([stamp_from_msg(m.header.stamp) for m in told])
    ways = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert np.all(ways <= CellConfig().base_speed_m_s * np.diff(stamps) + 1e-6)
    # Where it believes to be is the goal; the wheels have come somewhere else.
    apart = difference(pose_from_msg(devices.odometry[-1].pose.pose), FAR)[0]
    assert apart == pytest.approx(0.08, abs=1e-6)
    bench.wait(lambda: stamp_from_msg(truth[-1].header.stamp) >= bench.now_s - 0.2, turning=True)
    true = pose_stamped_from_msg(truth[-1], "map")
    assert difference(true, FAR)[0] <= CellConfig().base_error_m + 1e-9


def test_stop_of_the_base_ends_the_goal(bench: Bench, part_uri: str) -> None:
    devices, result = driving_base(bench, part_uri)
    assert devices.trigger("base/stop").success
    stopped_s = bench.now_s
    response = bench.result(result, turning=True)
    assert response.result.error_msg.startswith("stopped: ")
    devices.wait_for("base", DeviceState.STOPPED)
    assert devices.stands("base", stopped_s + BASE_STANDS_S)
    assert devices.trigger("base/reset").success


class Seen:
    """A camera before the fixture."""

    def __init__(self, bench: Bench, part_uri: str) -> None:
        self.bench, self.devices = bench, Devices(bench)
        self.images: list[Image] = bench.collect_before(Image, "camera/color/image_raw", IMAGE)
        bench.collect_before(CameraInfo, "camera/color/camera_info", IMAGE)
        self._base = bench.tester.create_publisher(PoseStamped, "truth/base_pose", STATE)
        part = bench.tester.create_publisher(PoseStamped, "truth/workpiece_pose", LATCHED)
        bench.start(MockCamera, part_uri=part_uri, rate_hz=10.0)
        bench.wait(lambda: self._base.get_subscription_count() and part.get_subscription_count())
        part.publish(pose_stamped_to_msg(planar(0.0, 0.0, 0.0), "map"))

    def next(self) -> Image:
        """The next image; the base stands."""
        count = len(self.images)

        def come() -> bool:
            stand = planar(-0.3, -1.2, 0.0)
            self._base.publish(pose_stamped_to_msg(stand, "map", self.bench.now_s))
            return len(self.images) > count

        self.bench.wait(come, turning=True)
        return self.images[-1]


def test_camera_freezes_darkens_and_stamps_late(bench: Bench, part_uri: str) -> None:
    seen = Seen(bench, part_uri)
    first = seen.next()
    assert not np.array_equal(image_from_msg(seen.next()), image_from_msg(first)), "noise"
    seen.devices.make("mock_camera", "frozen")
    seen.next()
    frozen, again = seen.next(), seen.next()
    assert np.array_equal(image_from_msg(again), image_from_msg(frozen))
    assert stamp_from_msg(again.header.stamp) > stamp_from_msg(frozen.header.stamp)
    assert seen.devices.states["camera"][-1].state == DeviceState.READY, "it does not know"
    seen.devices.end("mock_camera")
    seen.devices.make("mock_camera", "dark")
    seen.next()
    assert image_from_msg(seen.next()).mean() < 10.0
    seen.devices.end("mock_camera")
    seen.devices.make("mock_camera", "stale_stamps", age=7.0)
    seen.next()
    stale = stamp_from_msg(seen.next().header.stamp)
    assert bench.now_s - stale > 6.5 or stale == 0.0


def test_camera_without_images_is_at_fault(bench: Bench, part_uri: str) -> None:
    seen = Seen(bench, part_uri)
    seen.next()
    seen.devices.make("mock_camera", "no_images")
    seen.devices.wait_for("camera", DeviceState.FAULT, "no_images")
    count = len(seen.images)
    bench.turn_clock(bench.now_s + 2.0)
    assert len(seen.images) <= count + 1
    seen.devices.end("mock_camera")
    assert seen.devices.trigger("camera/reset").success
    seen.next()


def test_fault_at_a_time_and_for_a_while(bench: Bench) -> None:
    devices = Devices(bench)
    bench.start(MockUr5, faults=["protective_stop@4.0+2.0"])
    bench.turn_clock(3.5)
    devices.wait_for("arm", DeviceState.READY)
    pending = devices.inject("mock_ur5", "slow", turning=False, at=100.0).pending
    assert pending == ["protective_stop", "slow"]
    bench.turn_clock(4.5)
    devices.wait_for("arm", DeviceState.FAULT, "protective_stop")
    assert not devices.trigger("arm/reset").success
    bench.turn_clock(bench.now_s + 2.5)
    assert devices.trigger("arm/reset").success


def test_fault_at_a_place(bench: Bench, part_uri: str) -> None:
    devices = Devices(bench)
    bench.start(MockMir100, part_uri=part_uri)
    bench.turn_clock(bench.now_s + 0.2)
    start = pose_from_msg(bench.wait(lambda: devices.odometry, turning=True)[-1].pose.pose)
    target = start @ planar(6.0, 0.0, 0.0)
    middle = (start @ planar(3.0, 0.0, 0.0))[:3, 3]
    place = Point(x=middle[0], y=middle[1])
    devices.make("mock_mir100", "lost", place=place, radius=0.5)
    response = bench.result(navigate(bench, target)[1], turning=True)
    assert response.result.error_msg.startswith("lost: ")
    stood = pose_from_msg(devices.odometry[-1].pose.pose)
    assert abs(difference(start, stood)[0] - 2.5) < 0.5


@pytest.mark.parametrize(
    ("fault", "fields", "code", "words"),
    [
        ("tired", {}, Status.FAULT_UNKNOWN, "protective_stop"),
        ("slow", {"sped": 1}, Status.REQUEST_INVALID, "speed_percent"),
        ("slow", {"speed_percent": 200}, Status.REQUEST_INVALID, "from 0 to 100"),
        ("slow", {"speed_percent": "fast"}, Status.REQUEST_INVALID, "numbers"),
        ("slow", {"at": -1.0}, Status.REQUEST_INVALID, ">= 0"),
        ("slow", {"duration": float("nan")}, Status.REQUEST_INVALID, ">= 0"),
    ],
)
def test_faults_that_are_none_are_refused(
    bench: Bench, fault: str, fields: Any, code: int, words: str
) -> None:
    devices = Devices(bench)
    bench.start(MockUr5)
    answer = devices.inject("mock_ur5", fault, turning=False, **fields)
    assert answer.status.code == code
    assert words in answer.status.message
    assert answer.active == answer.pending == []


def test_a_parameter_that_is_no_fault_ends_the_start(bench: Bench) -> None:
    with pytest.raises(InputError, match=r"name\[@time_s\]"):
        bench.start(MockUr5, faults=["protective stop"])


def test_a_killed_device_process_is_gone_without_a_word(tmp_path: Path) -> None:
    program = [sys.executable, "-m", "skinplan_nodes.mock_ur5", "--ros-args"]
    given = ["-p", "faults:=['process_killed']"]
    done = subprocess.run([*program, *given], capture_output=True, timeout=60.0, cwd=tmp_path)
    assert done.returncode == -9
    assert b"process_killed begins" in done.stderr


def stood_at(part_uri: str, folder: Path, from_s: float, goals: bool) -> tuple[Any, Any, float]:
    """Starts arm and base, sends them somewhere or not; returns where they stand, and the time."""
    bench = Bench()
    try:
        devices = Devices(bench)
        bench.now_s = from_s
        bench.start(MockUr5, state_file=str(folder / "arm.state"))
        bench.start(MockMir100, part_uri=part_uri, state_file=str(folder / "base.state"))
        bench.turn_clock(bench.now_s + 0.3)
        if goals:
            bench.result(follow(bench, [0.0, 1.0], [HOME, HOME + 0.3])[1], turning=True)
            bench.result(navigate(bench, planar(1.0, -1.0, 0.2))[1], turning=True)
        late_s = bench.now_s + 0.5
        bench.wait(
            lambda: (
                devices.joints
                and devices.odometry
                and stamp_from_msg(devices.joints[-1].header.stamp) > late_s
                and stamp_from_msg(devices.odometry[-1].header.stamp) > late_s
            ),
            turning=True,
        )
        base = pose_from_msg(devices.odometry[-1].pose.pose)
        return np.array(devices.joints[-1].position), base, bench.now_s
    finally:
        bench.close()
        assert not bench.failures


def test_devices_stand_where_they_stood_when_their_process_is_started_again(
    part_uri: str, tmp_path: Path
) -> None:
    q, base, now_s = stood_at(part_uri, tmp_path, 1.0, goals=True)
    again, moved, _ = stood_at(part_uri, tmp_path, now_s, goals=False)
    assert np.abs(q - HOME).max() > 0.2
    np.testing.assert_allclose(again, q, atol=1e-9)
    np.testing.assert_allclose(moved, base, atol=1e-9)
    # Of another run, whose clock begins anew, nothing is taken over.
    home, _, _ = stood_at(part_uri, tmp_path, 1.0, goals=False)
    np.testing.assert_allclose(home, HOME, atol=1e-9)
