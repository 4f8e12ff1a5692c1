"""Verifies the localiser: the recorded images and frames again, one localisation after another."""

import threading
from collections.abc import Callable
from typing import Any

from nav2_msgs.action import NavigateToPose
from rclpy.action import ActionServer
from sensor_msgs.msg import CameraInfo, Image
from skinplan_msgs.action import LocalizePart
from skinplan_msgs.msg import MarkerObservations, PartPose, PartReference, Status
from tf2_msgs.msg import TFMessage

from skinplan_nodes.action_client import ThreadedActionClient
from skinplan_nodes.conversions import stamp_from_msg
from skinplan_nodes.qos import IMAGE, LATCHED, STATE, STATIC_TF
from skinplan_nodes.verify.bench import NotAnsweredError, VerifyBench
from skinplan_nodes.verify.compare import (
    StageResult,
    observation_differences,
    part_pose_differences,
)
from skinplan_nodes.verify.recorded import Localization, RecordedRun, Stamped

# A busy machine is no difference.
_IMAGE_S = 300.0
_RESULT_S = 90.0
_MATCH_S = 60.0
# The clock stands so long before the next image: nothing older than that may be used.
_BEFORE_S = 1e-3
# Frames that the localiser makes itself.
_OWN_FRAMES = ("workpiece",)
_BASE = "base_link"


class LocalizerFeed:
    """Plays the part of camera, base and frames for the localiser.

    Args:
        bench: With the localiser.
        run: Where the images come from.
        part: What is located.
    """

    def __init__(self, bench: VerifyBench, run: RecordedRun, part: PartReference) -> None:
        self._bench, self._run, self._part = bench, run, part
        node, group = bench.node, bench.group
        self._images = node.create_publisher(Image, "camera/color/image_raw", IMAGE)
        self._infos = node.create_publisher(CameraInfo, "camera/color/camera_info", STATE)
        self._tf = node.create_publisher(TFMessage, "tf", STATE)
        self._tf_static = node.create_publisher(TFMessage, "tf_static", STATIC_TF)
        self._seen: list[MarkerObservations] = []
        self._poses: list[PartPose] = []
        node.create_subscription(
            MarkerObservations, "markers/observations", self._seen.append, STATE,
            callback_group=group,
        )  # fmt: skip
        node.create_subscription(
            PartPose, "part_pose", self._poses.append, LATCHED, callback_group=group
        )
        self._base = ActionServer(
            node, NavigateToPose, "navigate_to_pose", self._on_drive, callback_group=group
        )
        self._client = ThreadedActionClient(
            node, LocalizePart, "localize_part", callback_group=group
        )
        for action in (self._base, self._client):
            bench.at_end(action.destroy)
        self._moving = iter(self._run.all("tf"))
        self._next: Stamped | None = next(self._moving, None)
        self._base_s = float("-inf")

    def verify(self, progress: Callable[[str], None]) -> StageResult:
        """Runs every localisation again."""
        result = StageResult("localization")
        every = self._run.localizations()
        if not every:
            result.notes.append("no localisation was recorded")
            return result
        self._wait_matched()
        self._send_static()
        for number, recorded in enumerate(every):
            progress(f"localisation {number + 1} of {len(every)}")
            self._localize(recorded, number == 0, result)
        return result

    def _localize(self, recorded: Localization, first: bool, result: StageResult) -> None:
        self._seen.clear()
        self._poses.clear()
        begin_s = stamp_from_msg(recorded.observations[0].message.header.stamp)
        self._feed_frames(recorded.observations[0])
        self._bench.set_clock(begin_s - _BEFORE_S)
        done = self._sent(first)
        for observation in recorded.observations:
            if done.is_set():
                result.differences.append(
                    "localization: fewer images were used than recorded, up to that of "
                    f"{_stamp_text(observation.message)}"
                )
                break
            self._show(observation, done, result)
        self._compare_result(recorded, done, result)

    def _show(self, recorded: Stamped, done: threading.Event, result: StageResult) -> None:
        """Shows one image and compares what is seen in it."""
        message = recorded.message
        image = self._run.image(message.header.stamp)
        if image is None:
            result.notes.append(f"the image of {_stamp_text(message)} was not recorded")
            return
        self._feed_frames(recorded)
        info = self._run.last("camera/color/camera_info", recorded.at_ns)
        if info is not None:
            self._infos.publish(info)
        # Not yet at the image: a drive that ends just now must not make it one of before.
        self._bench.set_clock(stamp_from_msg(message.header.stamp) - _BEFORE_S)
        self._images.publish(image)

        def answered() -> Any:
            mine = [m for m in self._seen if m.header.stamp == message.header.stamp]
            return mine or done.is_set()

        self._bench.wait(answered, _IMAGE_S, f"what is seen at {_stamp_text(message)}")
        mine = [m for m in self._seen if m.header.stamp == message.header.stamp]
        if mine:
            result.compared += 1
            result.differences += observation_differences(message, mine[0])

    def _compare_result(
        self, recorded: Localization, done: threading.Event, result: StageResult
    ) -> None:
        if not done.wait(_RESULT_S):
            result.differences.append(
                "localization: more images are wanted than were used, after that of "
                f"{_stamp_text(recorded.observations[-1].message)}"
            )
            self._cancel(done)
            return
        answer = self._answer
        reached = answer.status.code == Status.OK
        if recorded.part_pose is None:
            result.compared += 1
            if reached:
                result.differences.append("localization: failed then, found the part now")
            return
        result.compared += 1
        if not reached:
            result.differences.append(
                f"localization: found the part then, fails now: {answer.status.message}"
            )
            return
        result.differences += part_pose_differences(recorded.part_pose.message, answer.part_pose)

    def _sent(self, first: bool) -> threading.Event:
        """Sends a goal; the event is set when its result is there."""
        self._bench.wait(self._client.server_is_ready, _MATCH_S, "the action localize_part")
        # A job's first look is the one that may move.
        goal = LocalizePart.Goal(part=self._part, may_move=first, new_place=first)
        sent = self._client.send_goal_async(goal)
        self._bench.wait(sent.done, _MATCH_S, "the acceptance of localize_part")
        self._handle = sent.result()
        if not self._handle.accepted:
            raise NotAnsweredError("the localiser refused a goal: another is being worked on")
        done = threading.Event()
        future = self._handle.get_result_async()

        def note(_: Any) -> None:
            self._answer = future.result().result
            done.set()

        future.add_done_callback(note)
        return done

    def _cancel(self, done: threading.Event) -> None:
        self._handle.cancel_goal_async()
        if not done.wait(_RESULT_S):
            raise NotAnsweredError("the localiser did not end a goal that was cancelled")

    def _feed_frames(self, until: Stamped) -> None:
        """Sends the frames that were known when an image was evaluated."""
        stamp_s = stamp_from_msg(until.message.header.stamp)
        edges = []
        while self._next is not None and (
            self._next.at_ns <= until.at_ns or self._base_s < stamp_s
        ):
            for edge in self._next.message.transforms:
                if edge.child_frame_id not in _OWN_FRAMES:
                    edges.append(edge)
                if edge.child_frame_id == _BASE:
                    self._base_s = stamp_from_msg(edge.header.stamp)
            self._next = next(self._moving, None)
        if edges:
            self._tf.publish(TFMessage(transforms=edges))

    def _send_static(self) -> None:
        edges = [edge for item in self._run.all("tf_static") for edge in item.message.transforms]
        self._tf_static.publish(TFMessage(transforms=edges))

    def _wait_matched(self) -> None:
        for publisher in (self._images, self._infos, self._tf, self._tf_static):
            self._bench.wait(publisher.get_subscription_count, _MATCH_S, "the localiser")

    def _on_drive(self, handle: Any) -> NavigateToPose.Result:
        # The base stands where the next recorded image shows it.
        handle.succeed()
        return NavigateToPose.Result()


def _stamp_text(message: Any) -> str:
    stamp = message.header.stamp
    return f"{stamp.sec}.{stamp.nanosec:09d} s"
