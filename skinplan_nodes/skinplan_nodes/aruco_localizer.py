"""Node ``aruco_localizer``: finds the part by its markers, with the approach-retry loop of M1.2."""

import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.timer import Timer
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from skinplan_msgs import msg as messages
from skinplan_msgs.action import LocalizePart
from tf2_msgs.msg import TFMessage

from skinplan.errors import PartInvalidError, PartMovedError
from skinplan.localization.chain import LocatedPart, moved_by
from skinplan.localization.loop import ApproachLoop, ApproachSettings
from skinplan.localization.loop_cell import Estimate, View
from skinplan.localization.model import Sighting
from skinplan.part.files import load_part
from skinplan.part.model import Part
from skinplan.transforms import Array
from skinplan_nodes.base_driver import BaseDriver
from skinplan_nodes.camera_feed import CameraFeed, FeedSettings, Frames
from skinplan_nodes.conversions import (
    observations_to_msg,
    part_pose_to_msg,
    pose_stamped_to_msg,
    transform_stamped_to_msg,
)
from skinplan_nodes.draining import subscribe_draining
from skinplan_nodes.localize_server import LocalizeServer, asked_quality
from skinplan_nodes.marker_watch import DetectionRecord, MarkerWatcher
from skinplan_nodes.node import CellNode
from skinplan_nodes.parameters import CELL_FILE, Parameter, load
from skinplan_nodes.part_cache import PartCache
from skinplan_nodes.planning import configured_cell
from skinplan_nodes.qos import IMAGE, LATCHED, SENSOR, STATE, STATIC_TF
from skinplan_nodes.run import run_node

_UNKNOWN = float("nan")
# A goal that is worked on at the node's end gets so long to stop the base and to answer.
_END_TIMEOUT_S = 8.0


class GoalCell:
    """The cell as one goal of the localiser sees it.

    Args:
        node: The node.
        handle: The goal.
    """

    def __init__(self, node: "ArucoLocalizer", handle: ServerGoalHandle) -> None:
        self._node = node
        self._handle = handle
        # An image from before the goal, or before the end of a drive, may show another place: on a
        # busy machine the news that the base has moved can come later than that image.
        self._not_before_s = node.now_s()

    def look(self, after_s: float, is_cancelled: Callable[[], bool]) -> View:
        """Waits for a new image."""
        return self._node.feed.look(max(after_s, self._not_before_s), is_cancelled)

    def lookup(self, target: str, source: str) -> Array:
        """Returns ``T_target_source``."""
        return self._node.frames.lookup(target, source)

    def drive(self, T_map_base_link: Array, is_cancelled: Callable[[], bool]) -> bool:
        """Drives the base; False = cancelled."""
        arrived = self._node.base.drive(T_map_base_link, is_cancelled)
        self._not_before_s = self._node.now_s()
        return arrived

    def glance(self) -> View | None:
        """Returns the newest image, also while the base moves."""
        return self._node.feed.next(0.0)

    def seen(self, sighting: Sighting, view: View) -> None:
        """Publishes what was seen."""
        self._node.publish_observations(sighting, view)

    def told(self, estimate: Estimate) -> None:
        """Sends the estimate as feedback."""
        feedback = LocalizePart.Feedback(phase=estimate.phase, attempt=estimate.attempt)
        pose = estimate.pose
        feedback.quality = estimate.quality
        feedback.distance = _UNKNOWN if pose is None else pose.distance_m
        feedback.angle = _UNKNOWN if pose is None else pose.angle_rad
        self._handle.publish_feedback(feedback)


class ArucoLocalizer(CellNode):
    """Serves the action ``localize_part``; publishes observations, part pose and its frames."""

    NAME = "aruco_localizer"
    PARAMETERS = (
        CELL_FILE,
        Parameter("settle_s", 0.5, "Rest of the base before an image counts [s].", 0.0, 60.0),
        Parameter(
            "image_timeout_s",
            5.0,
            "Longest wait for an image, on the cell's clock [s].",
            0.1,
            600.0,
        ),
        Parameter(
            "wall_timeout_s", 30.0, "Longest wait for an image on wall time [s].", 0.1, 3600.0
        ),
        Parameter(
            "drive_timeout_s", 300.0, "Longest drive of the base on wall time [s].", 1.0, 3600.0
        ),
        Parameter("max_misses", 3, "Estimates in a row without a pose, at most [1].", 1, 100),
        Parameter(
            "quality_threshold", 0.0, "T_E of eq (3) [1]; 0 = the one of the cell file.", 0.0, 1.0
        ),
        Parameter("max_attempts", 0, "Estimates at most [1]; 0 = as the cell file says.", 0, 1000),
        Parameter("images", 3, "Images that are averaged for one estimate [1].", 1, 100),
        Parameter(
            "part_moved_m",
            0.25,
            "A part that is farther than this from its last place has moved [m]; allows for the "
            "base's own error at both looks.",
            0.0,
            100.0,
        ),
        Parameter(
            "part_moved_rad", 0.1, "... or that is turned more than this [rad].", 0.0, 3.1416
        ),
        Parameter("compressed", False, "Take compressed images (JPEG or PNG)."),
        Parameter("rectified", False, "The images are rectified: the camera info's P holds."),
        Parameter(
            "watched_part",
            "",
            "Part file whose markers are watched between goals; empty = that of the last goal, "
            "none before the first one.",
        ),
        Parameter(
            "watch_rate_hz",
            0.0,
            "Images evaluated between goals at most [Hz]; 0 = none.",
            0.0,
            60.0,
        ),
        Parameter("tf_rate_hz", 2.0, "Rate of map to workpiece on tf [Hz].", 0.1, 50.0),
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._cell = configured_cell(self.values.cell_file)
        self._parts = PartCache()
        self.frames = Frames()
        self.feed = CameraFeed(
            self.frames, self.now_s, load(self.values, FeedSettings), self.values.rectified
        )
        self.base = BaseDriver(self, self.values.drive_timeout_s)
        self._T_map_workpiece: Array | None = None
        self._places: dict[tuple[str, str], Array] = {}
        self._detections = DetectionRecord()
        self._last_image: NDArray[np.uint8] | None = None
        self._make_publishers()
        self._make_subscriptions()
        self._server = LocalizeServer(self, "localize_part", self._localize)
        self._watcher = MarkerWatcher(
            self.feed, self._cell, self.values.watch_rate_hz, self.publish_observations, self.ended
        )
        if self.values.watched_part:
            self._watcher.fixture = _with_markers(load_part(self.values.watched_part)).fixture
        self._watcher.start()

    def close(self) -> None:
        """Ends the goal that is being worked on: the base stops, the caller gets an error."""
        self.asked_to_end.set()
        self._server.wait_idle()
        self._watcher.join(_END_TIMEOUT_S)

    def health_values(self) -> dict[str, Any]:
        """Returns rates and ages for ``/diagnostics``."""
        if not hasattr(self, "_watcher"):
            return {}
        counts = self.feed.counts()
        return {
            "image_rate_hz": f"{counts.rate_hz:.1f}",
            "images_received": counts.received,
            "images_evaluated": counts.used,
            "images_dropped": counts.dropped,
            **self._detections.values(self.now_s()),
        }

    def publish_observations(self, sighting: Sighting, view: View) -> None:
        """Publishes the markers of one image; an empty list, too."""
        self._detections.note(sighting)
        self._observations.publish(
            observations_to_msg(sighting, self._cell.quality, view.frame, view.stamp_s, view.age_s)
        )

    def _make_publishers(self) -> None:
        self._observations = self.create_publisher(
            messages.MarkerObservations, "markers/observations", STATE
        )
        self._part_pose = self.create_publisher(messages.PartPose, "part_pose", LATCHED)
        self._tf = self.create_publisher(TFMessage, "tf", STATE)
        self._tf_static = self.create_publisher(TFMessage, "tf_static", STATIC_TF)
        self._tf_timer: Timer = self.create_timer(1.0 / self.values.tf_rate_hz, self._publish_frame)

    def _make_subscriptions(self) -> None:
        camera, moving = MutuallyExclusiveCallbackGroup(), MutuallyExclusiveCallbackGroup()
        kind, topic = Image, "camera/color/image_raw"
        if self.values.compressed:
            kind, topic = CompressedImage, f"{topic}/compressed"
        self.create_subscription(kind, topic, self.feed.take_image, IMAGE, callback_group=camera)
        self.create_subscription(
            CameraInfo, "camera/color/camera_info", self.feed.take_info, SENSOR,
            callback_group=camera,
        )  # fmt: skip
        self.create_subscription(messages.PartPose, "part_pose", self._on_part_pose, LATCHED)
        subscribe_draining(self, TFMessage, "tf", self._on_tf, STATE, moving)
        self.create_subscription(
            TFMessage, "tf_static", self._on_tf, STATIC_TF, callback_group=moving
        )

    def _on_tf(self, msg: TFMessage) -> None:
        for reason in self.frames.take(msg):
            self.get_logger().warning(f"tf: {reason}", throttle_duration_sec=5.0)

    def _on_part_pose(self, message: messages.PartPose) -> None:
        # Located by its shape: who has done that publishes its frame from now on.
        if not message.marker_ids:
            self._T_map_workpiece = None

    def _localize(self, handle: ServerGoalHandle, result: LocalizePart.Result) -> None:
        part = _with_markers(self._parts.part(handle.request.part))
        self._watcher.fixture = part.fixture
        self._watcher.paused = self.feed.wanted = True
        loop = ApproachLoop(
            GoalCell(self, handle),
            self._cell,
            part.fixture,
            self._approach_settings(handle.request),
            lambda: handle.is_cancel_requested or self.ended(),
            self._last_image,
        )
        try:
            estimate = loop.run()
        finally:
            self._last_image = loop.last_image
            result.attempts, result.quality = loop.attempts, loop.best_quality
            self._watcher.paused, self.feed.wanted = False, self._watcher.active
        self._publish_result(part, estimate, result, handle.request.new_place)
        self.set_health(
            "ok", f"located {part.id}", quality=f"{result.quality:.3f}", attempts=loop.attempts
        )

    def _approach_settings(self, goal: LocalizePart.Goal) -> ApproachSettings:
        quality = self._cell.quality
        return ApproachSettings(
            asked_quality(goal) or self.values.quality_threshold or quality.threshold,
            goal.max_attempts or self.values.max_attempts or quality.max_attempts,
            self.values.max_misses,
            goal.may_move,
            self.values.images,
        )

    def _publish_result(
        self, part: Part, estimate: Estimate, result: LocalizePart.Result, new_place: bool
    ) -> None:
        assert estimate.pose is not None
        T_arm_base_camera = self.frames.lookup("arm_base", estimate.frame)
        camera = self._cell.camera
        located = LocatedPart.from_camera(
            estimate.pose,
            T_arm_base_camera,
            estimate.stamp_s,
            camera.mounting_error_m,
            camera.mounting_error_rad,
        )
        T_map_workpiece = self.frames.lookup("map", "arm_base") @ located.T_arm_base_workpiece
        self._check_place(part, T_map_workpiece, new_place)
        self._T_map_workpiece = T_map_workpiece
        result.hidden_ids = estimate.pose.hidden_ids.tolist()
        result.rejected_ids = estimate.pose.rejected_ids.tolist()
        self._detections.good(estimate.pose.quality, estimate.stamp_s)
        result.part_pose = part_pose_to_msg(located)
        result.map_pose = pose_stamped_to_msg(self._T_map_workpiece, "map", estimate.stamp_s)
        result.quality = located.quality
        self._part_pose.publish(result.part_pose)
        fixture = part.fixture
        edges = [("workpiece", "fixture", fixture.T_workpiece_fixture)]
        edges += [("fixture", f"marker_{m.id}", m.T_fixture_marker) for m in fixture.markers]
        self._tf_static.publish(
            TFMessage(transforms=[transform_stamped_to_msg(*edge, self.now_s()) for edge in edges])
        )
        self._publish_frame()

    def _check_place(self, part: Part, T_map_workpiece: Array, new_place: bool) -> None:
        """Compares the place of a part with that of its last localisation."""
        key = (part.id, part.mesh_sha256)
        last = self._places.get(key)
        if last is not None and not new_place:
            values = self.values
            moved = moved_by(last, T_map_workpiece, values.part_moved_m, values.part_moved_rad)
            if moved:
                raise PartMovedError(
                    f"{part.id} was looked for at its last place, but {moved}; new_place in the "
                    f"goal accepts another one"
                )
        self._places[key] = T_map_workpiece

    def _publish_frame(self) -> None:
        pose = self._T_map_workpiece
        if pose is not None:
            edge = transform_stamped_to_msg("map", "workpiece", pose, self.now_s())
            self._tf.publish(TFMessage(transforms=[edge]))


def _with_markers(part: Part) -> Part:
    """Returns the part.

    Raises:
        PartInvalidError: Its fixture has no markers.
    """
    if not part.fixture.markers:
        raise PartInvalidError(
            f"{part.id} was to be located by markers, but its part file says that its fixture has "
            "none; a fixture with markers is accepted, or the action locate_part_by_shape"
        )
    return part


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    return run_node(ArucoLocalizer, arguments)


if __name__ == "__main__":
    sys.exit(main())
