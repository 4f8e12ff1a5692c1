"""Node ``part_recognizer``: which part is on the fixture, by scanned points or a depth camera."""

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
from tf2_msgs.msg import TFMessage

from skinplan.errors import NoCloudError, PartInvalidError, SkinplanError
from skinplan.inspection.merge import MergedCloud
from skinplan.mesh.model import SurfaceMesh
from skinplan.part.model import Part
from skinplan.recognition.identify import IdentifySettings, identify
from skinplan.recognition.view import Candidate, ViewSettings, describe, fit_view
from skinplan.transforms import inverse
from skinplan_nodes.conversions import (
    part_pose_from_msg,
    pose_stamped_to_msg,
    scan_frame_from_msg,
)
from skinplan_nodes.depth_views import DepthViews
from skinplan_nodes.draining import subscribe_draining
from skinplan_nodes.frame_tree import Frames
from skinplan_nodes.node import CellNode
from skinplan_nodes.parameters import CELL_FILE, Parameter, load
from skinplan_nodes.part_cache import PartCache
from skinplan_nodes.planning import configured_cell
from skinplan_nodes.qos import STATE, STATIC_TF
from skinplan_nodes.replies import RefusedError, replies_in_thread
from skinplan_nodes.run import run_node
from skinplan_nodes.shape_locator import ShapeLocator
from skinplan_nodes.shape_parameters import SHAPE_PARAMETERS, view_settings

# The tracker looks at the side that is scanned: its origin is outside of every part.
_TRACKER = np.zeros(3)
_DEFAULTS, _VIEW = IdentifySettings(), ViewSettings()


class PartRecognizer(CellNode):
    """Serves ``identify_part`` and ``locate_part_by_shape``; collects ``scanner/points``."""

    NAME = "part_recognizer"
    PARAMETERS = (
        CELL_FILE,
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
        Parameter("depth_images", 8, "By so many depth images a part is identified [1].", 1, 100),
        Parameter(
            "camera_timeout_s", 15.0, "They are waited for so long, wall time [s].", 0.1, 600.0
        ),
        Parameter(
            "noise_at_1m_m",
            _VIEW.noise_at_1m_m,
            "Depth camera: noise of a depth of 1 m; grows with its square [m].",
            1e-6,
            0.1,
        ),
        Parameter(
            "tolerance_m",
            _VIEW.tolerance_m,
            "Depth camera: it may be off by this over a whole patch [m].",
            1e-5,
            0.1,
        ),
        Parameter(
            "seen_ratio_min",
            _VIEW.seen_ratio_min,
            "Depth camera: at least this share of the part's area should be seen [1].",
            0.0,
            1.0,
        ),
        *SHAPE_PARAMETERS,
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
        self._frames, self._depth = Frames(), DepthViews(self)
        for topic, qos in (("tf", STATE), ("tf_static", STATIC_TF)):
            subscribe_draining(self, TFMessage, topic, self._on_tf, qos)
        self.create_service(
            IdentifyPart,
            "identify_part",
            self._on_identify_part,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )
        self._locator = ShapeLocator(
            self,
            configured_cell(self.values.cell_file),
            self._parts,
            self._frames,
            view_settings(self.values),
        )

    def close(self) -> None:
        """Ends the search that is being worked on: the base stops, the caller gets an error."""
        self.asked_to_end.set()
        self._locator.close()

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
        answering = {
            IdentifyPart.Request.SCANNED: self._by_scan,
            IdentifyPart.Request.CAMERA: self._by_camera,
        }.get(request.source)
        if answering is None:
            raise RefusedError(
                Status.REQUEST_INVALID,
                f"source {request.source} was given; 0 (SCANNED) and 1 (CAMERA) are accepted",
            )
        status = answering(request, response)
        self.set_health("ok", status.message, duration_s=f"{time.perf_counter() - begin:.2f}")
        return status

    def _by_scan(self, request: IdentifyPart.Request, response: IdentifyPart.Response) -> Status:
        with self._lock:
            points, stamp_s = self._cloud.points()[0].copy(), self._stamp_s
        if len(points) == 0:
            raise NoCloudError(
                "a part was to be identified, but no points have been scanned; a scan that covers "
                "most of the part is needed"
            )
        meshes = self._meshes(request)
        found = identify(points, meshes, load(self.values, IdentifySettings), _TRACKER)
        fits = [found.fits[name] for name in meshes]
        response.residuals = [fit.residual_m for fit in fits]
        response.fits = [not fit.reason for fit in fits]
        response.seen_ratios = [fit.complete_ratio for fit in fits]
        response.index = -1 if found.name is None else int(found.name)
        if found.T_cloud_workpiece is None:
            return Status(code=Status.UNKNOWN_PART, message=found.reason)
        response.pose = pose_stamped_to_msg(found.T_cloud_workpiece, "tracker", stamp_s)
        return Status(code=Status.OK, message=found.reason)

    def _by_camera(self, request: IdentifyPart.Request, response: IdentifyPart.Response) -> Status:
        if not request.part_pose.header.frame_id:
            raise RefusedError(
                Status.REQUEST_INVALID,
                "source CAMERA was given without part_pose; where the part was located is needed",
            )
        located = part_pose_from_msg(request.part_pose)
        if self._frames.moved_s > located.stamp_s:
            raise RefusedError(
                Status.STALE_IMAGE,
                f"part_pose is of {located.stamp_s:.3f} s, and the base has moved at "
                f"{self._frames.moved_s:.3f} s; one from after its last motion is accepted",
            )
        values = self.values
        candidates = self._candidates(request)
        seen = self._depth.take(values.depth_images, located.stamp_s, values.camera_timeout_s)
        T_arm_base_camera = self._frames.lookup("arm_base", seen.frame)
        T_camera_workpiece = inverse(T_arm_base_camera) @ located.T_arm_base_workpiece
        # The fixture holds each of them in its own way.
        first = candidates[0][0].fixture.T_workpiece_fixture
        ids = [part.id for part, _ in candidates]
        names = [f"{k} ({n})" if ids.count(k) > 1 else k for n, k in enumerate(ids)]
        placed = {
            name: Candidate(
                mesh, T_camera_workpiece @ first @ inverse(part.fixture.T_workpiece_fixture)
            )
            for name, (part, mesh) in zip(names, candidates, strict=True)
        }
        fits = fit_view(seen.points, seen.camera, placed, view_settings(values))
        response.residuals = [fit.residual_m for fit in fits.values()]
        response.seen_ratios = [fit.seen_ratio for fit in fits.values()]
        response.fits = [fit.fits for fit in fits.values()]
        if not any(fit.is_judged for fit in fits.values()):
            raise RefusedError(Status.PART_NOT_SEEN, describe(fits))
        good = np.flatnonzero(response.fits)
        response.index = int(good[0]) if len(good) == 1 else -1
        if response.index < 0:
            return Status(code=Status.UNKNOWN_PART, message=describe(fits))
        found = list(fits.values())[response.index].T_camera_workpiece
        assert found is not None
        pose = T_arm_base_camera @ found
        response.pose = pose_stamped_to_msg(pose, "arm_base", seen.stamp_s)
        return Status(code=Status.OK, message=describe(fits))

    def _candidates(self, request: IdentifyPart.Request) -> list[tuple[Part, SurfaceMesh]]:
        found = []
        for reference in request.candidates:
            part, prepared = self._parts.prepared(reference)
            found.append((part, prepared.mesh))
        return found

    def _meshes(self, request: IdentifyPart.Request) -> dict[str, SurfaceMesh]:
        return {str(n): mesh for n, (_, mesh) in enumerate(self._candidates(request))}

    def _on_tf(self, message: TFMessage) -> None:
        for reason in self._frames.take(message):
            self.get_logger().warning(reason, throttle_duration_sec=5.0)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    return run_node(PartRecognizer, arguments)


if __name__ == "__main__":
    sys.exit(main())
