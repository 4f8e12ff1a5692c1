"""Node ``part_recognizer``: which part is on the fixture, judged by the points scanned so far."""

import sys
import threading
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from sensor_msgs.msg import PointCloud2
from skinplan_msgs.msg import Status
from skinplan_msgs.srv import IdentifyPart

from skinplan.errors import NoCloudError, PartInvalidError, SkinplanError
from skinplan.inspection.merge import MergedCloud
from skinplan.recognition.identify import IdentifySettings, identify
from skinplan_nodes.conversions import pose_stamped_to_msg, scan_frame_from_msg
from skinplan_nodes.node import CellNode
from skinplan_nodes.parameters import Parameter, load
from skinplan_nodes.part_cache import PartCache
from skinplan_nodes.qos import STATE
from skinplan_nodes.replies import replies_in_thread
from skinplan_nodes.run import run_node

# The tracker looks at the side that is scanned: its origin is outside of every part.
_TRACKER = np.zeros(3)
_DEFAULTS = IdentifySettings()


class PartRecognizer(CellNode):
    """Serves ``identify_part``; collects ``scanner/points``."""

    NAME = "part_recognizer"
    PARAMETERS = (
        Parameter("voxel_m", 0.003, "One point is kept per voxel of this side [m].", 1e-4, 0.1),
        Parameter("points_max", 1_000_000, "At most so many points [1].", 1000, 50_000_000),
        Parameter(
            "session_gap_s",
            600.0,
            "Points after a pause so long are of another part; the earlier ones are dropped [s].",
            1.0,
            1e6,
        ),
        Parameter("residual_m", _DEFAULTS.residual_m, "Largest residual of a fit [m].", 1e-5, 0.1),
        Parameter(
            "inlier_ratio_min",
            _DEFAULTS.inlier_ratio_min,
            "At least this share of the points lies on the part [1].",
            0.0,
            1.0,
        ),
        Parameter(
            "complete_ratio_min",
            _DEFAULTS.complete_ratio_min,
            "At least this share of the part lies below points [1].",
            0.0,
            1.0,
        ),
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._parts = PartCache(16)
        self._lock = threading.Lock()
        self._cloud = self._empty_cloud()
        self._stamp_s = 0.0
        self.create_subscription(
            PointCloud2,
            "scanner/points",
            self._on_points,
            STATE,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )
        self.create_service(
            IdentifyPart,
            "identify_part",
            self._on_identify_part,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )

    def _empty_cloud(self) -> MergedCloud:
        return MergedCloud(self.values.voxel_m, self.values.points_max)

    def _on_points(self, msg: PointCloud2) -> None:
        try:
            frame = scan_frame_from_msg(msg, "tracker")
            with self._lock:
                gap_s = frame.stamp_s - self._stamp_s
                # A clock that went back was started anew.
                if not 0.0 <= gap_s <= self.values.session_gap_s:
                    self._cloud = self._empty_cloud()
                self._stamp_s = frame.stamp_s
                self._cloud.add(frame.points)
        except SkinplanError as error:
            self.get_logger().warning(str(error), throttle_duration_sec=5.0)

    @replies_in_thread(invalid=Status.PART_INVALID, blank={"index": -1})
    def _on_identify_part(
        self, request: IdentifyPart.Request, response: IdentifyPart.Response
    ) -> Status | None:
        begin = time.perf_counter()
        if not request.candidates:
            raise PartInvalidError("0 candidates were given; at least 1 is accepted")
        with self._lock:
            points, stamp_s = self._cloud.points()[0].copy(), self._stamp_s
        if len(points) == 0:
            raise NoCloudError(
                "a part was to be identified, but no points have been scanned; a scan that covers "
                "most of the part is needed"
            )
        meshes = {
            str(number): self._parts.prepared(reference)[1].mesh
            for number, reference in enumerate(request.candidates)
        }
        found = identify(points, meshes, load(self.values, IdentifySettings), _TRACKER)
        response.residuals = [found.residuals_m[name] for name in meshes]
        response.index = -1 if found.name is None else int(found.name)
        self.set_health("ok", found.reason, duration_s=f"{time.perf_counter() - begin:.2f}")
        if found.T_cloud_workpiece is None:
            return Status(code=Status.UNKNOWN_PART, message=found.reason)
        response.pose = pose_stamped_to_msg(found.T_cloud_workpiece, "tracker", stamp_s)
        return None


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    return run_node(PartRecognizer, arguments)


if __name__ == "__main__":
    sys.exit(main())
