"""The mock devices behind the interfaces of the real ones: happy paths and their illegal twins."""

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from control_msgs.action import FollowJointTrajectory
from geometry_msgs.msg import PoseStamped
from nav2_msgs.action import NavigateToPose
from nav_msgs.msg import Odometry
from rclpy.action import ActionClient
from rosgraph_msgs.msg import Clock
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, Image, JointState, PointCloud2
from std_srvs.srv import SetBool
from tf2_msgs.msg import TFMessage

from nodes.bench import Bench
from skinplan.errors import PartInvalidError
from skinplan.localization.detect import detect_markers
from skinplan.mesh.load import load_mesh
from skinplan.mesh.model import SurfaceMesh
from skinplan.mock.tracker import LineOfSight
from skinplan.mock.truth import Truth
from skinplan.part.files import load_part
from skinplan.part.samples import write_sample
from skinplan.robot.arm import JOINT_NAMES, ArmModel
from skinplan.robot.cell import CellConfig
from skinplan.scanner.rays import RayCaster
from skinplan.transforms import Array, apply, difference, inverse, planar, transform
from skinplan_nodes.conversions import (
    camera_info_from_msg,
    image_from_msg,
    joint_state_from_msg,
    joint_state_to_msg,
    joint_trajectory_to_msg,
    pose_from_msg,
    pose_stamped_from_msg,
    pose_stamped_to_msg,
    scan_frame_from_msg,
    stamp_from_msg,
    transform_stamped_from_msg,
)
from skinplan_nodes.mock_camera import MockCamera
from skinplan_nodes.mock_ctrack import MockCtrack
from skinplan_nodes.mock_mir100 import MockMir100
from skinplan_nodes.mock_ur5 import CONTROLLER, MockUr5
from skinplan_nodes.qos import LATCHED, SENSOR, STATE, STATIC_TF
from skinplan_nodes.sim_clock import SimClock, SimTime

HOME = np.array(CellConfig().home_rad)


@pytest.fixture(scope="module")
def part_uri(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(write_sample("scene2", tmp_path_factory.mktemp("part")).source)


def send(bench: Bench, kind: Any, name: str, goal: Any) -> tuple[Any, Any]:
    """Sends a goal and returns its handle and the future of its result."""
    client = ActionClient(bench.tester, kind, name)
    bench.wait(client.server_is_ready)
    handle = bench.result(client.send_goal_async(goal))
    assert handle.accepted
    return handle, handle.get_result_async()


def navigate(bench: Bench, T_map_base_link: Array, frame: str = "map") -> tuple[Any, Any]:
    goal = NavigateToPose.Goal(pose=pose_stamped_to_msg(T_map_base_link, frame))
    return send(bench, NavigateToPose, "navigate_to_pose", goal)


def follow(bench: Bench, times: Any, positions: Any) -> tuple[Any, Any]:
    trajectory = joint_trajectory_to_msg(np.asarray(times, float), np.asarray(positions, float))
    goal = FollowJointTrajectory.Goal(trajectory=trajectory)
    return send(bench, FollowJointTrajectory, f"{CONTROLLER}/follow_joint_trajectory", goal)


def test_sim_time_is_wall_time_times_the_factor_and_never_leaps() -> None:
    time = SimTime(1.0, 5.0, longest_step_s=0.06)
    assert time.tick(10_000_000_000) == 1_000_000_000
    assert time.tick(10_020_000_000) == 1_100_000_000
    assert time.tick(20_000_000_000) == 1_400_000_000, "a late tick slows time down"
    assert time.tick(19_000_000_000) == 1_400_000_000, "time never runs backwards"


def test_clock_runs_by_the_factor(bench: Bench) -> None:
    bench.start(SimClock, simulated=False, time_factor=10.0)
    ticks = bench.collect(Clock, "/clock", SENSOR)
    bench.wait(lambda: len(ticks) > 10)
    stamps = np.array([stamp_from_msg(tick.clock) for tick in ticks])
    assert np.all(np.diff(stamps) > 0.0)
    assert np.diff(stamps).max() <= 0.6 + 1e-6, "three ticks of 20 ms at most"


def test_base_arrives_and_stands_a_little_beside(bench: Bench, part_uri: str) -> None:
    bench.start(MockMir100, part_uri=part_uri)
    odometry = bench.collect(Odometry, "odom", STATE)
    truth = bench.collect(PoseStamped, "truth/base_pose", STATE)
    static = bench.collect(TFMessage, "tf_static", STATIC_TF)
    target = planar(0.5, -1.0, 0.3)
    _, result = navigate(bench, target)
    response = bench.result(result, turning=True)
    assert response.status == GoalStatus.STATUS_SUCCEEDED
    bench.wait(
        lambda: odometry and difference(pose_from_msg(odometry[-1].pose.pose), target)[0] < 1e-6,
        turning=True,
    )
    stamp_s = stamp_from_msg(odometry[-1].header.stamp)
    bench.wait(lambda: truth and stamp_from_msg(truth[-1].header.stamp) >= stamp_s)
    distance, angle = difference(pose_stamped_from_msg(truth[-1], "map"), target)
    assert 0.0 < distance <= CellConfig().base_error_m
    assert angle <= CellConfig().base_error_rad
    edges = {(t.header.frame_id, t.child_frame_id) for m in static for t in m.transforms}
    assert ("base_link", "arm_base") in edges
    assert ("map", "tracker") in edges


@pytest.mark.parametrize(
    ("frame", "pose", "words"),
    [
        ("odom", planar(0.0, -1.0, 0.0), "frame 'map' is accepted"),
        ("map", planar(500.0, 0.0, 0.0), "away is accepted"),
    ],
)
def test_base_refuses_a_goal_with_its_reason(
    bench: Bench, part_uri: str, frame: str, pose: Array, words: str
) -> None:
    bench.start(MockMir100, part_uri=part_uri)
    bench.turn_clock()
    _, result = navigate(bench, pose, frame)
    response = bench.result(result)
    assert response.status == GoalStatus.STATUS_ABORTED
    assert response.result.error_code != NavigateToPose.Result.NONE
    assert words in response.result.error_msg


def test_base_stops_when_the_goal_is_cancelled(bench: Bench, part_uri: str) -> None:
    bench.start(MockMir100, part_uri=part_uri)
    odometry = bench.collect(Odometry, "odom", STATE)
    target = planar(8.0, -1.0, 0.0)
    handle, result = navigate(bench, target)
    bench.wait(lambda: odometry and odometry[-1].twist.twist.linear.x > 0.2, turning=True)
    bench.result(handle.cancel_goal_async())
    response = bench.result(result, turning=True)
    assert response.status == GoalStatus.STATUS_CANCELED
    bench.wait(lambda: odometry[-1].twist.twist.linear.x == 0.0, turning=True)
    assert difference(pose_from_msg(odometry[-1].pose.pose), target)[0] > 1.0


def test_newer_goal_of_the_base_replaces_the_older(bench: Bench, part_uri: str) -> None:
    bench.start(MockMir100, part_uri=part_uri)
    _, first = navigate(bench, planar(8.0, -1.0, 0.0))
    bench.turn_clock(bench.now_s + 0.5)
    _, second = navigate(bench, planar(0.0, -1.0, 0.0))
    assert bench.result(first, turning=True).status == GoalStatus.STATUS_ABORTED
    assert bench.result(second, turning=True).status == GoalStatus.STATUS_SUCCEEDED


def test_arm_follows_in_time_with_evenly_stamped_states(bench: Bench) -> None:
    bench.start(MockUr5)
    states = bench.collect(JointState, "joint_states", STATE)
    bench.turn_clock(bench.now_s + 0.5)
    goal = HOME + 0.2
    _, result = follow(bench, [0.0, 1.0, 2.0], [HOME, HOME + 0.1, goal])
    response = bench.result(result, turning=True)
    assert response.status == GoalStatus.STATUS_SUCCEEDED
    assert response.result.error_code == FollowJointTrajectory.Result.SUCCESSFUL
    beside = 3e-5  # repeatability of the scanner; its lever arms are longer than a tenth of a metre
    bench.wait(
        lambda: np.allclose(joint_state_from_msg(states[-1])[0], goal, atol=10.0 * beside),
        turning=True,
    )
    stamps = np.array([stamp_from_msg(state.header.stamp) for state in states])
    np.testing.assert_allclose(np.diff(stamps), 0.008, atol=1e-6)
    speeds = np.array([joint_state_from_msg(state)[1] for state in states])
    assert np.abs(speeds).max() == pytest.approx(0.1, rel=1e-3)


@pytest.mark.parametrize(
    ("times", "positions", "code", "words"),
    [
        ([0.0, 1.0], [HOME + 1.0, HOME], -4, "the arm stands at"),
        ([0.0, 0.01], [HOME, HOME + 1.0], -2, "rad/s is accepted"),
        ([0.0, 5.0], [HOME, HOME + 20.0], -2, "is accepted"),
        ([1.0, 0.5], [HOME, HOME], -1, "times that rise"),
        ([0.0, 1.0], [HOME, HOME * np.nan], -2, "finite"),
    ],
)
def test_arm_refuses_a_trajectory_with_its_reason(
    bench: Bench, times: Any, positions: Any, code: int, words: str
) -> None:
    bench.start(MockUr5)
    bench.turn_clock(bench.now_s + 0.3)
    _, result = follow(bench, times, positions)
    response = bench.result(result)
    assert response.status == GoalStatus.STATUS_ABORTED
    assert response.result.error_code == code
    assert words in response.result.error_string


def test_arm_refuses_unknown_joints(bench: Bench) -> None:
    bench.start(MockUr5)
    trajectory = joint_trajectory_to_msg(np.array([0.0, 1.0]), np.stack([HOME, HOME]))
    trajectory.joint_names = [f"panda_{name}" for name in JOINT_NAMES]
    goal = FollowJointTrajectory.Goal(trajectory=trajectory)
    _, result = send(bench, FollowJointTrajectory, f"{CONTROLLER}/follow_joint_trajectory", goal)
    response = bench.result(result)
    assert response.result.error_code == FollowJointTrajectory.Result.INVALID_JOINTS


def test_arm_holds_when_the_trajectory_is_cancelled(bench: Bench) -> None:
    bench.start(MockUr5)
    states = bench.collect(JointState, "joint_states", STATE)
    bench.turn_clock(bench.now_s + 0.3)
    handle, result = follow(bench, [0.0, 10.0], [HOME, HOME + 1.0])
    bench.wait(
        lambda: states and joint_state_from_msg(states[-1])[0][0] > HOME[0] + 0.1, turning=True
    )
    bench.result(handle.cancel_goal_async())
    assert bench.result(result, turning=True).status == GoalStatus.STATUS_CANCELED
    bench.wait(lambda: np.all(joint_state_from_msg(states[-1])[1] == 0.0), turning=True)
    assert joint_state_from_msg(states[-1])[0][0] < HOME[0] + 0.9


def test_scan_frames_lie_on_the_true_surface(bench: Bench, part_uri: str) -> None:
    part, cell = load_part(Path(part_uri)), CellConfig()
    bench.start(MockCtrack, part_uri=part_uri, rays=200)
    frames = bench.collect(PointCloud2, "scanner/points", STATE)
    base = bench.tester.create_publisher(PoseStamped, "truth/base_pose", STATE)
    arm = bench.tester.create_publisher(JointState, "joint_states", STATE)
    enable = bench.tester.create_client(SetBool, "scanner/enable")
    bench.wait(lambda: base.get_subscription_count() and arm.get_subscription_count())
    bench.wait(enable.service_is_ready)
    T_map_workpiece = Truth(part, cell, 1).T_map_workpiece
    mesh = load_mesh(part.mesh_path, part.unit)
    T_map_base, joints = place_in_view(cell, T_map_workpiece, mesh)
    base.publish(pose_stamped_to_msg(T_map_base, "map"))
    arm.publish(joint_state_to_msg(joints, stamp_s=1.0))
    assert not frames, "the scanner is off"
    assert bench.result(enable.call_async(SetBool.Request(data=True))).success
    stamps = iter(np.arange(2.0, 100.0, 0.1))

    def scanned() -> bool:
        arm.publish(joint_state_to_msg(joints, stamp_s=float(next(stamps))))
        return any(frame.width for frame in frames)

    bench.wait(scanned)
    frame = scan_frame_from_msg(next(frame for frame in frames if frame.width))
    points = apply(inverse(T_map_workpiece) @ cell.T_map_tracker, frame.points)
    starts = points + np.array([0.0, 0.0, 0.3])
    distance, _ = RayCaster(mesh).hits(starts, np.tile([0.0, 0.0, -1.0], (len(points), 1)))
    near = np.abs(distance - 0.3)
    assert np.median(near) < 5e-4
    assert set(frame.values) == {"intensity", "incidence"}


def test_a_frame_is_taken_from_where_the_base_stood_then(bench: Bench, part_uri: str) -> None:
    """Also when the base's pose comes later than the joint states, as on a busy machine."""
    part, cell = load_part(Path(part_uri)), CellConfig()
    bench.start(MockCtrack, part_uri=part_uri, rays=200)
    poses = bench.collect(PoseStamped, "tracker/scanner_pose", STATE)
    base = bench.tester.create_publisher(PoseStamped, "truth/base_pose", STATE)
    arm = bench.tester.create_publisher(JointState, "joint_states", STATE)
    bench.wait(lambda: base.get_subscription_count() and arm.get_subscription_count())
    T_map_workpiece = Truth(part, cell, 1).T_map_workpiece
    mesh = load_mesh(part.mesh_path, part.unit)
    T_map_base, joints = place_in_view(cell, T_map_workpiece, mesh)
    elsewhere = planar(0.0, -0.1, 0.0) @ T_map_base

    def stand(T_map_base_link: Array, stamp_s: float) -> None:
        base.publish(pose_stamped_to_msg(T_map_base_link, "map", stamp_s))

    def seen(stamp_s: float) -> Array:
        def found() -> list[Any]:
            return [p for p in poses if abs(stamp_from_msg(p.header.stamp) - stamp_s) < 1e-3]

        return pose_stamped_from_msg(bench.wait(found)[0], "tracker")[:3, 3]

    stand(elsewhere, 1.0)
    arm.publish(joint_state_to_msg(joints, stamp_s=1.0))
    before = seen(1.0)
    for stamp_s in np.arange(1.5, 2.01, 0.1):
        arm.publish(joint_state_to_msg(joints, stamp_s=float(stamp_s)))
    time.sleep(0.3)
    stand(T_map_base, 1.5)
    stand(T_map_base, 2.0)
    assert np.linalg.norm(seen(1.5) - before) == pytest.approx(0.1, abs=1e-3)
    # A base that tells nothing any more holds up nobody for long.
    for stamp_s in np.arange(3.0, 5.0, 0.1):
        arm.publish(joint_state_to_msg(joints, stamp_s=float(stamp_s)))
    assert np.linalg.norm(seen(3.5) - before) == pytest.approx(0.1, abs=1e-3)


def place_in_view(
    cell: CellConfig, T_map_workpiece: Array, mesh: SurfaceMesh
) -> tuple[Array, Array]:
    """Returns base pose and joints for a look at the part's middle from 0.3 m, as tracker sees."""
    model = ArmModel.load(cell)
    height = T_map_workpiece[2, 3] - cell.T_base_link_arm_base[2, 3]
    # View axis to the left, scanner y up.
    turn = Rotation.from_matrix([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    T_arm_base_scanner = transform((0.0, 0.45, height), turn.as_matrix())
    branches, valid = model.inverse((T_arm_base_scanner @ inverse(cell.T_tool0_scanner))[None])
    middle = T_map_workpiece[:3, 3]
    T_map_base = planar(middle[0], middle[1] - 0.45 - 0.3, 0.0)
    sight = LineOfSight(cell, model, mesh, T_map_workpiece)
    arm_base = T_map_base @ cell.T_base_link_arm_base
    seen = [q for q in branches[0][valid[0]] if not sight.hindrance(q, arm_base)]
    return T_map_base, seen[0]


def test_camera_renders_the_markers_of_the_fixture(bench: Bench, part_uri: str) -> None:
    part, cell = load_part(Path(part_uri)), CellConfig()
    images = bench.collect_before(Image, "camera/color/image_raw", SENSOR)
    infos = bench.collect_before(CameraInfo, "camera/color/camera_info", SENSOR)
    base = bench.tester.create_publisher(PoseStamped, "truth/base_pose", STATE)
    place = bench.tester.create_publisher(PoseStamped, "truth/workpiece_pose", LATCHED)
    bench.start(MockCamera, part_uri=part_uri, rate_hz=10.0)
    bench.wait(lambda: base.get_subscription_count() and place.get_subscription_count())
    place.publish(pose_stamped_to_msg(part.T_map_workpiece, "map"))
    base.publish(pose_stamped_to_msg(planar(-0.3, -1.2, 0.0), "map"))
    bench.wait(lambda: images and infos, turning=True)
    ids = detect_markers(image_from_msg(images[-1]), part.fixture.dictionary).ids
    assert set(ids.tolist()) & {marker.id for marker in part.fixture.markers}
    assert camera_info_from_msg(infos[-1]).width == cell.camera.width
    assert images[-1].header.frame_id == "camera_color_optical_frame"


def test_base_publishes_a_connected_tree(bench: Bench, part_uri: str) -> None:
    bench.start(MockMir100, part_uri=part_uri)
    moving = bench.collect(TFMessage, "tf", STATE)
    bench.wait(lambda: moving, turning=True)
    edges = [transform_stamped_from_msg(t)[:2] for t in moving[-1].transforms]
    assert edges == [("map", "odom"), ("odom", "base_link")]


def test_mock_without_a_part_says_what_it_needs(bench: Bench) -> None:
    with pytest.raises(PartInvalidError, match="is accepted"):
        bench.start(MockCtrack, part_uri="")
