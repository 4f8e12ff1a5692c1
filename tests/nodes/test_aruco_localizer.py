"""The approach-retry loop on the mock base and camera; and what it refuses."""

import hashlib
import threading
from typing import Any

import cv2
import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, Twist
from nav2_msgs.action import NavigateToPose
from nav_msgs.msg import Odometry
from rclpy.action import ActionClient
from sensor_msgs.msg import CompressedImage, Image
from skinplan_msgs.action import LocalizePart
from skinplan_msgs.msg import MarkerObservations, PartPose, Status
from tf2_msgs.msg import TFMessage
from unique_identifier_msgs.msg import UUID

from nodes.bench import Bench
from nodes.localizer_cell import drive, localize, send, start_cell, work_place
from nodes.small_part import reference
from skinplan.errors import (
    FrameMissingError,
    LocalizationCancelledError,
    NoImageError,
    StaleImageError,
)
from skinplan.mock.truth import Truth
from skinplan.part.files import load_part
from skinplan.part.model import Part
from skinplan.part.samples import write_sample
from skinplan.robot.cell import CellConfig
from skinplan.transforms import difference, inverse, planar, transform
from skinplan_nodes import camera_feed
from skinplan_nodes.aruco_localizer import ArucoLocalizer
from skinplan_nodes.camera_feed import CameraFeed, FeedSettings, Frames
from skinplan_nodes.conversions import (
    camera_info_to_msg,
    image_from_msg,
    image_to_msg,
    part_pose_from_msg,
    pose_from_msg,
    pose_stamped_to_msg,
    stamp_from_msg,
    transform_stamped_to_msg,
)
from skinplan_nodes.mock_camera import MockCamera
from skinplan_nodes.mock_mir100 import MockMir100
from skinplan_nodes.qos import IMAGE, LATCHED, STATE, STATIC_TF
from skinplan_nodes.replies import status_of

CELL = CellConfig()


@pytest.fixture(scope="module")
def part(tmp_path_factory: pytest.TempPathFactory) -> Part:
    written = write_sample("scene2", tmp_path_factory.mktemp("part"))
    assert written.source is not None
    return load_part(written.source)


def test_the_part_is_found_by_moving_closer(bench: Bench, part: Part) -> None:
    start_cell(bench, part)
    seen = bench.collect(MarkerObservations, "markers/observations", STATE)
    latched = bench.collect_before(PartPose, "part_pose", LATCHED)
    drive(bench, work_place(part))
    feedback: list[Any] = []
    goal = LocalizePart.Goal(part=reference(part), may_move=True)
    answer = localize(bench, goal, feedback)
    assert answer.status == GoalStatus.STATUS_SUCCEEDED
    result = answer.result
    assert (result.status.code, result.status.message) == (Status.OK, "")
    assert result.quality >= CELL.quality.threshold
    assert result.attempts > 1, "from the work place the view is not good enough"
    assert result.attempts <= CELL.quality.max_attempts
    bench.wait(lambda: len(feedback) == result.attempts)
    assert feedback[0].phase == "detecting"
    assert {item.phase for item in feedback[1:]} <= {"turning", "advancing"}
    assert feedback[-1].quality == pytest.approx(result.quality)
    bench.wait(lambda: len(seen) >= result.attempts)
    assert all(len(item.observations) for item in seen)
    bench.wait(lambda: latched)
    assert latched[-1] == result.part_pose
    truth = Truth(part, CELL, 3)
    T_map_workpiece = pose_from_msg(result.map_pose.pose)
    # The base stands up to 50 mm and 1 degree beside where it believes to be.
    assert difference(T_map_workpiece, truth.T_map_workpiece)[0] < 0.15
    located = part_pose_from_msg(result.part_pose)
    assert located.marker_ids.tolist()


def test_frames_of_the_part_are_published(bench: Bench, part: Part) -> None:
    start_cell(bench, part)
    moving = bench.collect(TFMessage, "tf", STATE)
    fixed = bench.collect(TFMessage, "tf_static", STATIC_TF)
    drive(bench, work_place(part))
    goal = LocalizePart.Goal(part=reference(part), quality_threshold=0.05, may_move=False)
    assert localize(bench, goal).result.status.code == Status.OK

    def edges(messages: list[Any]) -> set[tuple[str, str]]:
        return {(t.header.frame_id, t.child_frame_id) for m in messages for t in m.transforms}

    bench.wait(lambda: ("map", "workpiece") in edges(moving), turning=True)
    markers = {("fixture", f"marker_{marker.id}") for marker in part.fixture.markers}
    bench.wait(lambda: {("workpiece", "fixture"), *markers} <= edges(fixed))


def test_without_moving_it_says_that_the_quality_is_not_reached(bench: Bench, part: Part) -> None:
    start_cell(bench, part)
    drive(bench, work_place(part))
    answer = localize(bench, LocalizePart.Goal(part=reference(part), may_move=False))
    assert answer.status == GoalStatus.STATUS_ABORTED
    assert answer.result.status.code == Status.QUALITY_NOT_REACHED
    assert answer.result.attempts == 1
    assert "without moving" in answer.result.status.message


def test_too_few_attempts_bring_the_base_back(bench: Bench, part: Part) -> None:
    start_cell(bench, part)
    frames = Frames()
    bench.tester.create_subscription(TFMessage, "tf", lambda m: frames.take(m) and None, STATE)
    drive(bench, work_place(part))
    goal = LocalizePart.Goal(
        part=reference(part), may_move=True, max_attempts=2, quality_threshold=1.0
    )
    feedback: list[Any] = []
    answer = localize(bench, goal, feedback)
    assert answer.result.status.code == Status.QUALITY_NOT_REACHED
    assert answer.result.attempts == 2
    assert feedback[-1].phase in ("turning", "advancing"), "it did move"
    bench.wait(
        lambda: difference(frames.lookup("map", "base_link"), work_place(part))[0] < 1e-6,
        turning=True,
    )


def test_no_marker_in_sight(bench: Bench, part: Part) -> None:
    start_cell(bench, part)
    drive(bench, work_place(part) @ planar(0.0, 0.0, np.pi))
    seen = bench.collect(MarkerObservations, "markers/observations", STATE)
    answer = localize(bench, LocalizePart.Goal(part=reference(part), may_move=True))
    assert answer.result.status.code == Status.NO_MARKER
    assert answer.result.attempts == 3
    bench.wait(lambda: len(seen) == 3)
    assert not any(item.observations for item in seen), "empty lists are published"


def test_markers_of_another_part(
    bench: Bench, part: Part, tmp_path_factory: pytest.TempPathFactory
) -> None:
    start_cell(bench, part)
    drive(bench, work_place(part))
    folder = tmp_path_factory.mktemp("other")
    other = write_sample("scene2", folder)
    assert other.source is not None
    text = other.source.read_text(encoding="utf-8")
    for marker in part.fixture.markers:
        text = text.replace(f"- id: {marker.id}\n", f"- id: {marker.id + 50}\n")
        text = text.replace(f"{{id: {marker.id},", f"{{id: {marker.id + 50},")
    other.source.write_text(text, encoding="utf-8")
    ids = {marker.id for marker in load_part(other.source).fixture.markers}
    assert not ids & {marker.id for marker in part.fixture.markers}
    answer = localize(bench, LocalizePart.Goal(part=reference(other), may_move=True))
    assert answer.result.status.code == Status.WRONG_MARKER


def test_cancel_stops_it(bench: Bench, part: Part) -> None:
    start_cell(bench, part)
    drive(bench, work_place(part))
    goal = LocalizePart.Goal(part=reference(part), may_move=True)
    feedback: list[Any] = []
    handle = send(bench, goal, feedback)
    bench.wait(lambda: feedback, turning=True)
    bench.result(handle.cancel_goal_async(), turning=True)
    answer = bench.result(handle.get_result_async(), turning=True)
    assert answer.status == GoalStatus.STATUS_CANCELED
    assert answer.result.status.code == Status.LOCALIZATION_CANCELLED


def test_the_end_of_the_node_stops_the_base_and_answers_with_an_error(
    bench: Bench, part: Part
) -> None:
    bench.start(MockMir100, part_uri=str(part.source), seed=3)
    bench.start(MockCamera, part_uri=str(part.source), seed=3)
    localizer = bench.start(ArucoLocalizer)
    odometry = bench.collect(Odometry, "odom", STATE)
    drive(bench, work_place(part))
    handle = send(bench, LocalizePart.Goal(part=reference(part), may_move=True))
    result = handle.get_result_async()
    moving = lambda: odometry and abs(odometry[-1].twist.twist.linear.x) > 0.05  # noqa: E731
    bench.wait(lambda: moving() or result.done(), turning=True)
    assert not result.done(), result.result().result
    ending = threading.Thread(target=localizer.close)
    ending.start()
    answer = bench.result(result, turning=True)
    ending.join(20.0)
    assert answer.status == GoalStatus.STATUS_ABORTED
    assert answer.result.status.code == Status.LOCALIZATION_CANCELLED
    bench.wait(lambda: odometry[-1].twist.twist == Twist(), turning=True)
    before = odometry[-1].pose.pose
    bench.turn_clock(bench.now_s + 3.0)
    bench.wait(lambda: stamp_from_msg(odometry[-1].header.stamp) > bench.now_s - 0.5, turning=True)
    assert odometry[-1].pose.pose == before


def test_a_new_process_stops_the_drive_of_one_that_was_killed(bench: Bench, part: Part) -> None:
    """Goals of this node begin with its mark; nobody else's drive is touched."""
    bench.start(MockMir100, part_uri=str(part.source), seed=3)
    client = ActionClient(bench.tester, NavigateToPose, "navigate_to_pose")
    bench.wait(client.server_is_ready)
    mark = hashlib.sha256(b"/aruco_localizer").digest()[:8]
    goal = NavigateToPose.Goal(pose=pose_stamped_to_msg(planar(2.0, -3.0, 0.0), "map"))
    sent = client.send_goal_async(goal, goal_uuid=UUID(uuid=list(mark + bytes(8))))
    orphan = bench.result(sent, turning=True).get_result_async()
    bench.start(ArucoLocalizer)
    assert bench.result(orphan, turning=True).status == GoalStatus.STATUS_CANCELED
    drive(bench, work_place(part))


def test_a_part_that_is_elsewhere_than_last_time(bench: Bench, part: Part) -> None:
    start_cell(bench, part, part_moved_m=1e-6, images=1)
    drive(bench, work_place(part))
    goal = LocalizePart.Goal(part=reference(part), quality_threshold=0.05)
    assert localize(bench, goal).result.status.code == Status.OK
    drive(bench, work_place(part) @ planar(0.1, 0.0, 0.0))
    answer = localize(bench, goal)
    assert answer.result.status.code == Status.PART_MOVED
    assert "new_place" in answer.result.status.message
    goal.new_place = True
    assert localize(bench, goal).result.status.code == Status.OK


def test_markers_are_watched_between_goals_and_the_diagnostics_say_so(
    bench: Bench, part: Part
) -> None:
    start_cell(bench, part, watched_part=str(part.source), watch_rate_hz=30.0)
    told = bench.collect(DiagnosticArray, "diagnostics", STATE)
    seen = bench.collect(MarkerObservations, "markers/observations", STATE)
    drive(bench, work_place(part))
    bench.wait(lambda: len(seen) > 5 and seen[-1].observations, turning=True)
    item = seen[-1].observations[0]
    assert item.quality == pytest.approx(
        item.alpha * item.facing + (1.0 - item.alpha) * item.nearness
    )
    assert item.quality_threshold == CELL.quality.threshold
    assert np.array(item.pose.covariance).reshape(6, 6).trace() > 0.0

    def values() -> dict[str, str]:
        mine = [m.status[0] for m in told if m.status[0].hardware_id == "aruco_localizer"]
        return {pair.key: pair.value for pair in mine[-1].values} if mine else {}

    bench.wait(lambda: float(values().get("detection_rate", "nan")) > 0.0, turning=True)
    found = values()
    assert {"image_rate_hz", "images_dropped", "last_good_pose_age_s", "quality"} <= set(found)
    assert int(found["images_evaluated"]) > 0


class Compressor:
    """Sends what the camera sends once more, as JPEG, or something that is none."""

    def __init__(self, bench: Bench) -> None:
        self._sender = bench.tester.create_publisher(
            CompressedImage, "camera/color/image_raw/compressed", IMAGE
        )
        bench.tester.create_subscription(Image, "camera/color/image_raw", self._send, IMAGE)
        self.junk = False

    def _send(self, image: Image) -> None:
        _, found = cv2.imencode(".jpg", image_from_msg(image), [cv2.IMWRITE_JPEG_QUALITY, 90])
        data = b"no picture" if self.junk else found.tobytes()
        self._sender.publish(CompressedImage(header=image.header, format="jpeg", data=data))


def test_compressed_images_give_the_pose(bench: Bench, part: Part) -> None:
    start_cell(bench, part, compressed=True)
    compressor = Compressor(bench)
    bases = bench.collect(PoseStamped, "truth/base_pose", STATE)
    drive(bench, work_place(part))
    goal = LocalizePart.Goal(part=reference(part), quality_threshold=0.05)
    result = localize(bench, goal).result
    assert result.status.code == Status.OK, result.status.message
    assert bench.tester.count_subscribers("camera/color/image_raw") == 1, "only the compressor's"
    T_map_arm_base = pose_from_msg(bases[-1].pose) @ CELL.T_base_link_arm_base
    truth = inverse(T_map_arm_base) @ Truth(part, CELL, 3).T_map_workpiece
    apart_m, angle_rad = difference(
        truth, part_pose_from_msg(result.part_pose).T_arm_base_workpiece
    )
    assert apart_m < 5e-3
    assert angle_rad < 5e-3
    compressor.junk = True
    result = localize(bench, goal).result
    assert result.status.code == Status.IMAGE_INVALID
    assert "JPEG or PNG" in result.status.message


def test_a_second_goal_is_refused(bench: Bench, part: Part) -> None:
    start_cell(bench, part)
    goal = LocalizePart.Goal(part=reference(part), may_move=False)
    first = send(bench, goal)
    assert first.accepted
    assert not send(bench, goal).accepted
    assert bench.result(first.get_result_async(), turning=True).result.status.code != Status.UNSET
    again = send(bench, goal)
    assert again.accepted, "the next one is taken again"
    bench.result(again.get_result_async(), turning=True)


@pytest.mark.parametrize("threshold", [float("nan"), -0.1, 1.5])
def test_thresholds_that_are_none(bench: Bench, part: Part, threshold: float) -> None:
    bench.start(ArucoLocalizer)
    goal = LocalizePart.Goal(part=reference(part), quality_threshold=threshold)
    answer = localize(bench, goal)
    assert answer.status == GoalStatus.STATUS_ABORTED
    assert answer.result.status.code == Status.REQUEST_INVALID
    assert "0 to 1 is accepted" in answer.result.status.message


def test_a_part_that_is_none_and_a_cell_without_frames(bench: Bench, part: Part) -> None:
    bench.start(ArucoLocalizer, image_timeout_s=0.5)
    unknown = localize(bench, LocalizePart.Goal(part=reference(part, uri="/no/part.yaml")))
    assert unknown.result.status.code == Status.PART_NOT_FOUND
    blind = localize(bench, LocalizePart.Goal(part=reference(part)))
    assert blind.result.status.code == Status.NO_IMAGE
    lost = localize(bench, LocalizePart.Goal(part=reference(part), may_move=True))
    assert lost.result.status.code == Status.NO_TRANSFORM


def feed_of(frames: Frames, now_s: float = 100.0) -> CameraFeed:
    steps = iter(np.arange(now_s, now_s + 1e4, 1.0))
    return CameraFeed(frames, lambda: float(next(steps)), FeedSettings(0.5, 2.0, 5.0))


def image_at(feed: CameraFeed, stamp_s: float) -> None:
    camera = CELL.camera
    image = np.zeros((camera.height, camera.width), dtype=np.uint8)
    from skinplan.localization.camera import camera_model

    feed.take_info(camera_info_to_msg(camera_model(camera), "optical", stamp_s))
    feed.take_image(image_to_msg(image, "optical", stamp_s))


def moved(frames: Frames, x_m: float, stamp_s: float) -> None:
    edge = transform_stamped_to_msg("odom", "base_link", transform((x_m, 0, 0)), stamp_s)
    assert not frames.take(TFMessage(transforms=[edge]))


def test_an_image_from_before_the_last_motion_is_stale() -> None:
    frames = Frames()
    for x_m, stamp_s in ((0.0, 10.0), (0.1, 11.0), (0.1, 12.0), (0.1, 13.0)):
        moved(frames, x_m, stamp_s)
    assert frames.moved_s == 11.0
    feed = feed_of(frames)
    with pytest.raises(NoImageError, match="no image") as missing:
        feed.look(0.0, lambda: False)
    assert status_of(missing.value).code == Status.NO_IMAGE
    image_at(feed, 11.4)
    with pytest.raises(StaleImageError, match=r"the base moved until 11\.000 s") as stale:
        feed.look(0.0, lambda: False)
    assert status_of(stale.value).code == Status.STALE_IMAGE
    image_at(feed, 11.6)
    assert feed.look(0.0, lambda: False).stamp_s == pytest.approx(11.6)
    with pytest.raises(StaleImageError) as same:
        feed.look(11.6, lambda: False)
    assert status_of(same.value).code == Status.STALE_IMAGE
    with pytest.raises(LocalizationCancelledError) as stopped:
        feed.look(11.6, lambda: True)
    assert status_of(stopped.value).code == Status.LOCALIZATION_CANCELLED


def test_an_image_counts_as_soon_as_the_base_is_known_to_have_stood(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Nobody looks by himself: only what is told wakes who waits.
    monkeypatch.setattr(camera_feed, "_POLL_S", 60.0)
    frames = Frames()
    moved(frames, 0.0, 10.0)
    feed = CameraFeed(frames, lambda: 100.0, FeedSettings(0.5, 2.0, 120.0))
    waits, found = threading.Event(), []

    def asked_to_end() -> bool:
        waits.set()
        return False

    looks = threading.Thread(target=lambda: found.append(feed.look(0.0, asked_to_end)), daemon=True)
    looks.start()
    assert waits.wait(30.0)
    image_at(feed, 11.0)
    moved(frames, 0.0, 11.02)
    looks.join(30.0)
    assert [view.stamp_s for view in found] == [pytest.approx(11.0)]


def test_frames_refuse_transforms_that_are_none() -> None:
    frames = Frames()
    edge = transform_stamped_to_msg("a", "b", np.eye(4))
    edge.transform.rotation.w = 0.0
    (reason,) = frames.take(TFMessage(transforms=[edge]))
    assert "length 0" in reason
    with pytest.raises(FrameMissingError) as unknown:
        frames.lookup("map", "base_link")
    assert status_of(unknown.value).code == Status.NO_TRANSFORM
    T = transform((1, 2, 3))
    frames.take(TFMessage(transforms=[transform_stamped_to_msg("a", "b", T)]))
    np.testing.assert_allclose(frames.lookup("b", "a"), inverse(T))
