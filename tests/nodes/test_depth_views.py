"""Depth images that a frozen camera repeats, before those of a camera that runs."""

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo, PointCloud2
from skinplan_msgs.msg import Status

from nodes.bench import Bench
from skinplan.localization.camera import camera_model
from skinplan.robot.cell import CellConfig
from skinplan_nodes.conversions import ScanFrame, camera_info_to_msg, scan_frame_to_msg
from skinplan_nodes.depth_views import DepthViews
from skinplan_nodes.qos import IMAGE
from skinplan_nodes.replies import RefusedError

FRAME = "camera"


class Camera:
    """Publishes depth images to somebody who takes them."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        create = bench.tester.create_publisher
        self.clouds = create(PointCloud2, "camera/depth/color/points", IMAGE)
        self.infos = create(CameraInfo, "camera/color/camera_info", IMAGE)
        self.views = DepthViews(bench.tester)
        self.info = camera_model(CellConfig().camera)

    def send(self, z_m: float, stamp_s: float) -> None:
        """Publishes an image that shows one depth."""
        frame = ScanFrame(np.full((10, 3), z_m), {}, FRAME, stamp_s)
        self.infos.publish(camera_info_to_msg(self.info, FRAME, stamp_s))
        self.clouds.publish(scan_frame_to_msg(frame))

    def taken(self, count: int, timeout_s: float, depths_m: list[float]) -> Any:
        """Sends images of these depths, one after the other, and returns what was taken."""
        found: list[Any] = []

        def take() -> None:
            try:
                found.append(self.views.take(count, 0.0, timeout_s))
            except RefusedError as error:
                found.append(error)

        thread = threading.Thread(target=take)
        thread.start()
        self.bench.wait(lambda: self.clouds.get_subscription_count() == 1)
        for n, z_m in enumerate(depths_m):
            self.send(z_m, 10.0 + n)
            self.bench.wait(self._has_come(z_m, 10.0 + n))
        thread.join(20.0)
        return found[0]

    def _has_come(self, z_m: float, stamp_s: float) -> Callable[[], bool]:
        def come() -> bool:
            newest = self.views._newest
            return newest is not None and newest.header.stamp.sec == int(stamp_s)

        return come


@pytest.mark.parametrize("before", [[0.9, 0.9], [0.9, 0.9, 0.9, 0.9]])
def test_what_is_repeated_is_taken_back(bench: Bench, before: list[float]) -> None:
    """The camera was frozen elsewhere and runs again: only what it shows now is taken."""
    taken = Camera(bench).taken(3, 15.0, [*before, 0.5, 0.6, 0.7])
    assert np.unique(taken.points[:, 2]).tolist() == pytest.approx([0.5, 0.6, 0.7])


def test_a_camera_that_stays_frozen_is_named(bench: Bench) -> None:
    refused = Camera(bench).taken(2, 3.0, [0.9, 0.9, 0.9])
    assert isinstance(refused, RefusedError) and refused.code == Status.STALE_IMAGE
    assert "2 new depth images were waited for; 0 came within 3 s, and 2 times" in str(refused)
