"""Node ``scan_inspector``: collects scan frames in the tracker frame and measures the part."""

import re
import sys
import threading
import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from sensor_msgs.msg import JointState, PointCloud2
from skinplan_msgs import msg as messages
from skinplan_msgs.msg import Status
from skinplan_msgs.srv import InspectionFinish, InspectionStart
from std_msgs.msg import Bool
from tf2_msgs.msg import TFMessage

from skinplan.errors import SkinplanError
from skinplan.robot.arm import ArmModel
from skinplan_nodes.camera_feed import Frames
from skinplan_nodes.conversions import (
    CoverageProgress,
    ScanFrame,
    coverage_progress_to_msg,
    inspection_to_msg,
    joint_state_from_msg,
    part_pose_from_msg,
    pose_stamped_from_msg,
    scan_frame_from_msg,
    stamp_from_msg,
)
from skinplan_nodes.node import CellNode
from skinplan_nodes.parameters import CELL_FILE, Parameter, load
from skinplan_nodes.part_cache import PartCache
from skinplan_nodes.planning import configured_cell
from skinplan_nodes.qos import LATCHED, STATE
from skinplan_nodes.replies import RefusedError, replies_in_thread
from skinplan_nodes.run import run_node
from skinplan_nodes.scan_session import ScanSession, SessionSettings
from skinplan_nodes.scan_tracks import Tracks

_JOB_ID = re.compile(r"[A-Za-z0-9_.-]{1,64}")
# Scan frames that wait for the scanner's pose at their time; under load they may be many.
_PENDING = 5000
# At the end of a scan: frames have come in when none came for so long, wall time [s].
_WAIT_S, _WAITS = 0.3, 50
# The newest scanner pose may be so much older than now, cell time [s].
_LATE_S = 0.5
# Older than this, the tracker does not see the scanner: nothing more will come [s].
_LOST_S = 30.0


class ScanInspector(CellNode):
    """Serves ``inspection/start`` and ``inspection/finish``; publishes ``coverage`` meanwhile."""

    NAME = "scan_inspector"
    PARAMETERS = (
        CELL_FILE,
        Parameter("voxel_m", 0.001, "One point is kept per voxel of this side [m].", 1e-4, 0.1),
        Parameter("points_max", 3_000_000, "At most so many points [1].", 1000, 50_000_000),
        Parameter("coverage_spacing_m", 0.005, "Spacing of surface samples [m].", 0.001, 0.05),
        Parameter(
            "coverage_radius_m", 0.008, "A sample is measured by a point so near [m].", 0.001, 0.05
        ),
        Parameter("coverage_rate_hz", 1.0, "Rate of the topic coverage [Hz].", 0.1, 10.0),
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._parts = PartCache()
        self._frames = Frames()
        self._tracks = Tracks(ArmModel.load(configured_cell(self.values.cell_file)))
        self._session: ScanSession | None = None
        self._pending: deque[ScanFrame] = deque(maxlen=_PENDING)
        self._unplaced: deque[float] = deque(maxlen=_PENDING)
        self._lock = threading.Lock()
        self._received = 0
        self._coverage = self.create_publisher(messages.CoverageState, "coverage", STATE)
        self._make_subscriptions()
        serving = MutuallyExclusiveCallbackGroup()
        self.create_service(
            InspectionStart, "inspection/start", self._on_start, callback_group=serving
        )
        self.create_service(
            InspectionFinish, "inspection/finish", self._on_finish, callback_group=serving
        )
        self.create_timer(
            1.0 / self.values.coverage_rate_hz,
            self._on_coverage,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )

    def _make_subscriptions(self) -> None:
        group = MutuallyExclusiveCallbackGroup()
        for kind, topic, handler, qos in (
            (PointCloud2, "scanner/points", self._on_points, STATE),
            (PoseStamped, "tracker/scanner_pose", self._on_scanner_pose, STATE),
            (Bool, "tracker/visible", self._on_visible, STATE),
            (JointState, "joint_states", self._on_joint_state, STATE),
            (messages.PartPose, "part_pose", self._on_part_pose, LATCHED),
            (TFMessage, "tf", self._on_tf, STATE),
        ):
            self.create_subscription(kind, topic, handler, qos, callback_group=group)

    @replies_in_thread(invalid=Status.PART_INVALID)
    def _on_start(self, request: InspectionStart.Request, _: InspectionStart.Response) -> None:
        if not _JOB_ID.fullmatch(request.job_id):
            raise RefusedError(
                Status.JOB_INVALID,
                f"job id {request.job_id!r} was given; 1 to 64 of letters, digits, '_', '.', '-' "
                f"are accepted",
            )
        part, prepared = self._parts.prepared(request.part)
        session = ScanSession(request.job_id, prepared, load(self.values, SessionSettings))
        with self._lock:
            replaced, self._session = self._session, session
            self._pending.clear()
            self._unplaced.clear()
        if replaced is not None:
            self.get_logger().warning(f"the scan of job {replaced.job_id} was never finished")
        self.set_health("ok", f"collecting for job {request.job_id}", part=part.id)

    @replies_in_thread(invalid=Status.NO_CLOUD)
    def _on_finish(
        self, request: InspectionFinish.Request, response: InspectionFinish.Response
    ) -> None:
        cloud = _cloud_path(request.cloud_uri)
        self._wait_for_frames()
        with self._lock:
            session = self._session
            if session is None or session.job_id != request.job_id:
                running = "none" if session is None else session.job_id
                raise RefusedError(
                    Status.NOT_INSPECTING,
                    f"the end of job {request.job_id!r} was asked for; the job that frames are "
                    f"collected for is accepted, that is {running}",
                )
            self._session = None
            self._pending.clear()
            self._unplaced.clear()
        self._publish(session)
        inspection = session.finish(cloud)
        uri = "" if cloud is None else str(cloud)
        response.result = inspection_to_msg(inspection, session.job_id, uri)
        self.set_health("ok", f"measured job {session.job_id}", points=inspection.points)

    def _wait_for_frames(self) -> None:
        """Waits, bounded, until the frames that are under way have come in.

        The tracker tells the scanner's pose also while nothing is scanned: when its newest pose is
        of now, the frames before it have come, too.
        """
        asked_s = self.now_s()
        for _ in range(_WAITS):
            before = self._received
            time.sleep(_WAIT_S)
            late = _LATE_S < asked_s - self._tracks.newest_s() < _LOST_S
            if self._received == before and not self._pending and not late:
                return

    def _on_points(self, msg: PointCloud2) -> None:
        if self._session is None:
            return
        try:
            frame = scan_frame_from_msg(msg, "tracker")
        except SkinplanError as error:
            self.get_logger().warning(str(error), throttle_duration_sec=5.0)
            return
        with self._lock:
            self._received += 1
            self._pending.append(frame)
            self._take_pending()

    def _on_scanner_pose(self, msg: PoseStamped) -> None:
        try:
            T_tracker_scanner = pose_stamped_from_msg(msg, "tracker", "pose of the scanner")
        except SkinplanError as error:
            self.get_logger().warning(str(error), throttle_duration_sec=5.0)
            return
        with self._lock:
            self._tracks.add_pose(stamp_from_msg(msg.header.stamp), T_tracker_scanner)
            self._take_pending()

    def _take_pending(self) -> None:
        """Hands on the frames whose scanner pose is known; a pose may come after its frame."""
        while self._pending and self._session is not None:
            T_tracker_scanner = self._tracks.scanner(self._pending[0].stamp_s)
            if T_tracker_scanner is None and not self._tracks.passed(self._pending[0].stamp_s):
                break
            frame = self._pending.popleft()
            if T_tracker_scanner is None:
                self._session.add_hidden()
                continue
            try:
                self._session.add_frame(frame.points, frame.values, T_tracker_scanner[:3, 0])
            except SkinplanError as error:
                self.get_logger().warning(str(error), throttle_duration_sec=5.0)
                continue
            self._unplaced.append(frame.stamp_s)
        self._estimate()

    def _estimate(self) -> None:
        """Estimates where the part stands, at scan frames whose joint positions are known."""
        located = self._tracks.located
        if self._session is None or located is None or self._frames.moved_s > located.stamp_s:
            # Only while the base stands where it located the part.
            return
        waiting = [self._unplaced.popleft() for _ in range(len(self._unplaced))]
        for stamp_s in waiting:
            T_tracker_workpiece = self._tracks.coarse(stamp_s)
            if T_tracker_workpiece is None:
                self._unplaced.append(stamp_s)
            elif stamp_s >= located.stamp_s:
                self._session.add_coarse(located.stamp_s, T_tracker_workpiece)

    def _on_visible(self, msg: Bool) -> None:
        session = self._session
        if session is not None and not msg.data:
            session.add_hidden()

    def _on_joint_state(self, msg: JointState) -> None:
        try:
            positions, _ = joint_state_from_msg(msg)
        except SkinplanError as error:
            self.get_logger().warning(str(error), throttle_duration_sec=5.0)
            return
        with self._lock:
            self._tracks.add_joints(stamp_from_msg(msg.header.stamp), np.asarray(positions))
            if self._unplaced:
                self._estimate()

    def _on_part_pose(self, msg: messages.PartPose) -> None:
        try:
            located = part_pose_from_msg(msg)
        except SkinplanError as error:
            self.get_logger().warning(str(error))
            return
        with self._lock:
            self._tracks.located = located

    def _on_tf(self, msg: TFMessage) -> None:
        self._frames.take(msg)

    def _on_coverage(self) -> None:
        session = self._session
        if session is not None:
            self._publish(session)

    def _publish(self, session: ScanSession) -> None:
        progress = CoverageProgress(session.job_id, **vars(session.progress()))
        self._coverage.publish(coverage_progress_to_msg(progress, self.now_s()))


def _cloud_path(uri: str) -> Path | None:
    if not uri:
        return None
    path = Path(uri.removeprefix("file://"))
    if not path.is_absolute() or path.suffix != ".ply" or not path.parent.is_dir():
        raise RefusedError(
            Status.NO_CLOUD,
            f"a cloud in {uri!r} was asked for; the absolute path of a .ply file in an existing "
            f"folder is accepted",
        )
    return path


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    return run_node(ScanInspector, arguments)


if __name__ == "__main__":
    sys.exit(main())
