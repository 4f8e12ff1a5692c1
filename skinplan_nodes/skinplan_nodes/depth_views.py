"""Depth images of the camera, taken while somebody asks for them."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, PointCloud2
from skinplan_msgs.msg import Status

from skinplan.localization.loop import cancelled
from skinplan.localization.model import CameraModel
from skinplan.transforms import Array
from skinplan_nodes.conversions import camera_info_from_msg, scan_frame_from_msg, stamp_from_msg
from skinplan_nodes.qos import IMAGE
from skinplan_nodes.replies import RefusedError

_POLL_S = 0.05


@dataclass(frozen=True, eq=False)
class DepthView:
    """What the camera has seen.

    Attributes:
        points: Of several depth images, optical frame, shape (n, 3) [m].
        frame: Name of that frame.
        camera: The camera.
        stamp_s: Time of the newest image [s].
    """

    points: Array
    frame: str
    camera: CameraModel
    stamp_s: float


class DepthViews:
    """Subscribes the depth images of a camera while they are wanted: they are large.

    Args:
        node: The node.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._group = MutuallyExclusiveCallbackGroup()
        self._lock = threading.Lock()
        self._info: CameraInfo | None = None
        self._clouds: list[PointCloud2] = []
        # The newest image, also of a question before, and how often it came again.
        self._newest: PointCloud2 | None = None
        self._repeats = 0

    def take(
        self,
        count: int,
        since_s: float,
        timeout_s: float,
        is_cancelled: Callable[[], bool] = lambda: False,
    ) -> DepthView:
        """Waits for so many images and returns their points.

        Args:
            count: Number of images.
            since_s: They are not older than this, cell's clock [s].
            timeout_s: Waits at most so long, wall time [s].
            is_cancelled: Asked while waiting.

        Raises:
            RefusedError: They do not come in time (NO_IMAGE), or the camera repeats one image under
                new stamps (STALE_IMAGE): it may be of another place.
            LocalizationCancelledError: It was cancelled.
            InputError: They can't be read, or are of several frames.
        """
        with self._lock:
            self._info, self._clouds, self._repeats = None, [], 0
        subscriptions = [
            self._node.create_subscription(
                CameraInfo,
                "camera/color/camera_info",
                self._on_info,
                IMAGE,
                callback_group=self._group,
            ),
            self._node.create_subscription(
                PointCloud2,
                "camera/depth/color/points",
                lambda message: self._on_cloud(message, since_s),
                IMAGE,
                callback_group=self._group,
            ),
        ]
        try:
            self._wait(count, timeout_s, is_cancelled)
        finally:
            for subscription in subscriptions:
                self._node.destroy_subscription(subscription)
        with self._lock:
            clouds, info = self._clouds[:count], self._info
        assert info is not None
        frames = [scan_frame_from_msg(cloud, clouds[0].header.frame_id) for cloud in clouds]
        points = np.concatenate([frame.points for frame in frames])
        camera = camera_info_from_msg(info)
        return DepthView(points, frames[0].frame, camera, max(frame.stamp_s for frame in frames))

    def _wait(self, count: int, timeout_s: float, is_cancelled: Callable[[], bool]) -> None:
        deadline = time.monotonic() + timeout_s
        while True:
            with self._lock:
                found, informed = len(self._clouds), self._info is not None
                repeats = self._repeats
            if found >= count and informed:
                return
            if is_cancelled():
                raise cancelled()
            if time.monotonic() > deadline and repeats:
                raise RefusedError(
                    Status.STALE_IMAGE,
                    f"{count} new depth images were waited for; {found} came within {timeout_s:g} "
                    f"s, and {repeats} times the camera repeated the same one under a new stamp; a "
                    "camera that runs is accepted",
                )
            if time.monotonic() > deadline:
                raise RefusedError(
                    Status.NO_IMAGE,
                    f"{count} depth images on camera/depth/color/points and a "
                    f"camera/color/camera_info were waited for; {found} images and "
                    f"{'one' if informed else 'no'} camera_info came within {timeout_s:g} s",
                )
            time.sleep(_POLL_S)

    def _on_info(self, message: CameraInfo) -> None:
        with self._lock:
            self._info = message

    def _on_cloud(self, message: PointCloud2, since_s: float) -> None:
        with self._lock:
            before, self._newest = self._newest, message
            # No two images of a camera that runs are the same; only those of nothing are.
            if before is not None and len(message.data) and before.data == message.data:
                self._repeats += 1
                # The one that is repeated may be of another place, too.
                if self._clouds and self._clouds[-1] is before:
                    self._clouds.pop()
            elif stamp_from_msg(message.header.stamp) >= since_s:
                self._clouds.append(message)
