"""Of ``part_recognizer``: the action ``locate_part_by_shape``, for parts without markers."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from rclpy.action.server import ServerGoalHandle
from skinplan_msgs.action import LocalizePart
from skinplan_msgs.msg import PartPose, Status
from tf2_msgs.msg import TFMessage

from skinplan.errors import NoCloudError
from skinplan.localization.chain import LocatedPart
from skinplan.localization.loop import cancelled
from skinplan.localization.model import WorkpiecePose
from skinplan.mesh.model import SurfaceMesh
from skinplan.part.model import Part
from skinplan.recognition.shape_gate import (
    GateSettings,
    judge_shape,
    shape_quality,
)
from skinplan.recognition.shape_pose import ShapePose, ShapeSettings, locate_shape
from skinplan.recognition.shape_search import ShapeEstimate, ShapeLoop, ShapeLoopSettings
from skinplan.recognition.view import ViewSettings
from skinplan.robot.cell import CellConfig
from skinplan.transforms import Array, inverse
from skinplan_nodes.base_driver import BaseDriver
from skinplan_nodes.conversions import (
    part_pose_to_msg,
    pose_stamped_to_msg,
    transform_stamped_to_msg,
)
from skinplan_nodes.depth_views import DepthView, DepthViews
from skinplan_nodes.frame_tree import Frames
from skinplan_nodes.localize_server import LocalizeServer, asked_quality
from skinplan_nodes.parameters import load
from skinplan_nodes.part_cache import PartCache
from skinplan_nodes.qos import LATCHED, STATE, STATIC_TF
from skinplan_nodes.replies import RefusedError

_END_TIMEOUT_S = 8.0


class ShapeLocator:
    """Serves ``locate_part_by_shape``; publishes the pose and its frames as the localiser does.

    Args:
        node: The recognizer.
        cell: The cell.
        parts: Parts by reference.
        frames: The frame tree.
        view: When a view counts as a part.
    """

    def __init__(
        self, node: Any, cell: CellConfig, parts: PartCache, frames: Frames, view: ViewSettings
    ) -> None:
        self._node, self._cell, self._parts, self.frames = node, cell, parts, frames
        self._view, self._values = view, node.values
        self.depth = DepthViews(node)
        self.base = BaseDriver(node, node.values.drive_timeout_s)
        self._T_map_workpiece: Array | None = None
        self._places: dict[tuple[str, str], Array] = {}
        self._part_pose = node.create_publisher(PartPose, "part_pose", LATCHED)
        self._tf = node.create_publisher(TFMessage, "tf", STATE)
        self._tf_static = node.create_publisher(TFMessage, "tf_static", STATIC_TF)
        node.create_subscription(PartPose, "part_pose", self._on_part_pose, LATCHED)
        self._timer = node.create_timer(1.0 / node.values.tf_rate_hz, self._publish_frame)
        # Most cells never locate by shape: no work for them.
        self._timer.cancel()
        self._server = LocalizeServer(node, "locate_part_by_shape", self._locate)

    def close(self) -> None:
        """Waits, bounded, for the goal that is being worked on."""
        self._server.wait_idle()

    def _locate(self, handle: ServerGoalHandle, result: LocalizePart.Result) -> None:
        goal = handle.request
        part, prepared = self._parts.prepared(goal.part)
        start = None if goal.new_place else self._places.get((part.id, part.mesh_sha256))
        cell = _GoalCell(
            self,
            prepared.mesh,
            part.T_map_workpiece if start is None else start,
            handle,
            lambda: handle.is_cancel_requested or self._node.ended(),
        )
        loop = ShapeLoop(cell, self._cell, prepared.mesh, self._loop_settings(goal))
        try:
            estimate = loop.run()
        finally:
            result.attempts, result.quality = loop.attempts, loop.best_quality
        self._publish(part, estimate, result)
        self._node.set_health("ok", f"located {part.id}: {estimate.reason}")

    def _loop_settings(self, goal: LocalizePart.Goal) -> ShapeLoopSettings:
        return ShapeLoopSettings(
            asked_quality(goal) or 1.0,
            goal.max_attempts or self._values.max_attempts,
            goal.may_move,
        )

    def _publish(self, part: Part, estimate: ShapeEstimate, result: LocalizePart.Result) -> None:
        located = estimate.located
        pose = self.frames.lookup("map", "arm_base") @ located.T_arm_base_workpiece
        self._T_map_workpiece = self._places[part.id, part.mesh_sha256] = pose
        result.part_pose = part_pose_to_msg(located)
        result.map_pose = pose_stamped_to_msg(pose, "map", located.stamp_s)
        result.quality = located.quality
        self._part_pose.publish(result.part_pose)
        edge = ("workpiece", "fixture", part.fixture.T_workpiece_fixture)
        self._tf_static.publish(
            TFMessage(transforms=[transform_stamped_to_msg(*edge, self._node.now_s())])
        )
        self._publish_frame()
        self._timer.reset()

    def _on_part_pose(self, message: PartPose) -> None:
        # Located by markers: who has done that publishes its frame from now on.
        if message.marker_ids:
            self._T_map_workpiece = None
            self._timer.cancel()

    def _publish_frame(self) -> None:
        pose = self._T_map_workpiece
        if pose is not None:
            edge = transform_stamped_to_msg("map", "workpiece", pose, self._node.now_s())
            self._tf.publish(TFMessage(transforms=[edge]))


class _GoalCell:
    """The cell as one goal sees it; implements `skinplan.recognition.shape_search.Cell`."""

    def __init__(
        self,
        locator: ShapeLocator,
        mesh: SurfaceMesh,
        T_map_workpiece: Array,
        handle: ServerGoalHandle,
        is_cancelled: Callable[[], bool],
    ) -> None:
        self._locator, self._mesh, self._handle = locator, mesh, handle
        self._node, self._values = locator._node, locator._values
        self._T_map_workpiece = T_map_workpiece
        self._is_cancelled = is_cancelled
        self._not_before_s = self._node.now_s()

    def estimate(self) -> ShapeEstimate:
        """Takes images and looks for the part in them."""
        if self._is_cancelled():
            raise cancelled()
        values, frames = self._values, self._locator.frames
        since_s = max(self._not_before_s, frames.moved_s + values.settle_s)
        seen = self._locator.depth.take(
            values.depth_images, since_s, values.camera_timeout_s, self._is_cancelled
        )
        if frames.moved_s > since_s:
            raise RefusedError(
                Status.STALE_IMAGE,
                f"depth images of a base that stands since {since_s:.3f} s were waited for, but it "
                f"has moved at {frames.moved_s:.3f} s",
            )
        start = inverse(frames.lookup("map", seen.frame)) @ self._T_map_workpiece
        try:
            found = locate_shape(seen.points, self._mesh, start, load(values, ShapeSettings))
        except NoCloudError as error:
            raise RefusedError(Status.PART_NOT_SEEN, str(error)) from error
        return self._estimated(seen, found)

    def _estimated(self, seen: DepthView, found: ShapePose) -> ShapeEstimate:
        verdict = judge_shape(seen.points, seen.camera, self._mesh, found, self._locator._view)
        if not verdict.is_judged:
            raise RefusedError(Status.PART_NOT_SEEN, f"of the part {verdict.reason}")
        camera = self._locator._cell.camera
        located = LocatedPart.from_camera(
            _as_pose(found),
            self._locator.frames.lookup("arm_base", seen.frame),
            seen.stamp_s,
            camera.mounting_error_m,
            camera.mounting_error_rad,
        )
        gate = load(self._values, GateSettings)
        return ShapeEstimate(
            located,
            found.T_camera_workpiece,
            seen.camera,
            verdict,
            shape_quality(located, self._mesh, gate),
            gate.sigmas,
        )

    def place(self) -> Array:
        """Returns ``T_map_base_link``."""
        return self._locator.frames.lookup("map", "base_link")

    def drive(self, T_map_base_link: Array) -> None:
        """Drives the base."""
        arrived = self._locator.base.drive(T_map_base_link, self._is_cancelled)
        self._not_before_s = self._node.now_s()
        if not arrived:
            raise cancelled()

    def told(self, phase: str, attempt: int, estimate: ShapeEstimate) -> None:
        """Sends an estimate as feedback."""
        feedback = LocalizePart.Feedback(phase=phase, attempt=attempt)
        feedback.quality = estimate.quality
        feedback.distance = float(np.linalg.norm(estimate.T_camera_workpiece[:3, 3]))
        feedback.angle = math.nan
        self._handle.publish_feedback(feedback)


def _as_pose(found: ShapePose) -> WorkpiecePose:
    none = np.zeros(0, dtype=np.int64)
    return WorkpiecePose(found.T_camera_workpiece, found.covariance, 0.0, 0.0, 0.0, 0.0, none)
