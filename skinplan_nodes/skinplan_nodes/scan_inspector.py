"""Node ``scan_inspector``: collects scan frames in the tracker frame and measures the part."""

import math
import sys
import threading
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import JumpThreshold, TimeJump
from rclpy.duration import Duration
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState, PointCloud2
from skinplan_msgs import msg as messages
from skinplan_msgs.msg import Status
from skinplan_msgs.srv import InspectionFinish, InspectionStart
from std_msgs.msg import Bool
from tf2_msgs.msg import TFMessage

from skinplan.errors import InputError, SkinplanError
from skinplan.inspection.frame_check import FrameCheck
from skinplan.inspection.spool import SpoolOwner
from skinplan.robot.arm import ArmModel
from skinplan.scanner.model import ScannerModel
from skinplan.transforms import Array
from skinplan_nodes.conversions import (
    CoverageProgress,
    coverage_progress_to_msg,
    inspection_to_msg,
    joint_state_from_msg,
    part_pose_from_msg,
    pose_stamped_from_msg,
    raw_stamp_s,
    scan_frame_from_msg,
    stamp_from_msg,
)
from skinplan_nodes.draining import subscribe_draining
from skinplan_nodes.frame_tree import Frames
from skinplan_nodes.node import CellNode
from skinplan_nodes.parameters import CELL_FILE, load
from skinplan_nodes.part_cache import PartCache
from skinplan_nodes.planning import configured_cell
from skinplan_nodes.qos import LATCHED, STATE
from skinplan_nodes.replies import RefusedError, replies_in_thread
from skinplan_nodes.run import run_node
from skinplan_nodes.scan_intake import (
    INVALID,
    NOT_FINITE,
    POSES_REFUSED,
    ScanIntake,
    require_not_ahead,
)
from skinplan_nodes.scan_session import ScanSession, SessionSettings
from skinplan_nodes.scan_start import SCAN, begin, check_request, cloud_path, require_same
from skinplan_nodes.scan_tracks import Tracks
from skinplan_nodes.time_ack import TimeAck

# At the end of a scan: frames have come in when none came for so long, wall time [s].
_WAIT_S, _WAITS = 0.3, 50
# The newest scanner pose may be so much older than now, cell time [s].
_LATE_S = 0.5
# Older than this, the tracker does not see the scanner: nothing more will come [s].
_LOST_S = 30.0
# A clock that is set back by more is named [s].
_BACK_S = 0.05


class ScanInspector(CellNode):
    """Serves ``inspection/start`` and ``inspection/finish``; publishes ``coverage`` meanwhile."""

    NAME = "scan_inspector"
    PARAMETERS = (
        CELL_FILE,
        *SCAN,
    )
    # The heartbeat asks for these also while the node is being made.
    _intake: ScanIntake | None = None
    _refused: Mapping[str, int] = {}

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._parts = PartCache()
        self._frames = Frames()
        arm = ArmModel.load(configured_cell(self.values.cell_file))
        self._tracks = Tracks(arm, self._positions_of)
        self._owner: SpoolOwner | None = None
        self._lock = threading.Lock()
        self._received = 0
        self._seen = True
        self._coverage = self.create_publisher(messages.CoverageState, "coverage", STATE)
        self._ack = TimeAck(self)
        self._make_subscriptions()
        self._make_services()
        self.create_timer(
            1.0 / self.values.coverage_rate_hz,
            self._on_coverage,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )
        threshold = JumpThreshold(min_forward=None, min_backward=Duration(seconds=-_BACK_S))
        self._jumps = self.get_clock().create_jump_callback(threshold, post_callback=self._on_jump)

    def health_values(self) -> dict[str, Any]:
        """Returns what was left out so far, by reason."""
        intake = self._intake
        found = Counter(self._refused)
        found.update({} if intake is None else dict(intake.counts))
        return dict(found)

    def _make_subscriptions(self) -> None:
        group = MutuallyExclusiveCallbackGroup()
        for kind, topic, handler, qos in (
            (PointCloud2, "scanner/points", self._on_points, STATE),
            (PoseStamped, "tracker/scanner_pose", self._on_scanner_pose, STATE),
            (Bool, "tracker/visible", self._on_visible, STATE),
            (messages.PartPose, "part_pose", self._on_part_pose, LATCHED),
            (TFMessage, "tf", self._on_tf, STATE),
        ):
            subscribe_draining(self, kind, topic, handler, qos, group)
        subscribe_draining(
            self, JointState, "joint_states", self._on_joint_state, STATE, group, raw=True
        )

    def _make_services(self) -> None:
        group = MutuallyExclusiveCallbackGroup()
        for kind, name, handler in (
            (InspectionStart, "inspection/start", self._on_start),
            (InspectionFinish, "inspection/finish", self._on_finish),
        ):
            self.create_service(kind, name, handler, callback_group=group)

    @replies_in_thread(invalid=Status.PART_INVALID)
    def _on_start(
        self, request: InspectionStart.Request, response: InspectionStart.Response
    ) -> None:
        check_request(request)
        part, prepared = self._parts.prepared(request.part)
        running = self._intake
        if request.resume and running is not None and running.session.job_id == request.job_id:
            assert self._owner is not None
            require_same(self._owner, SpoolOwner(request.job_id, part.id, part.mesh_sha256))
            response.frames = running.session.frames
            return
        begun = begin(request, part, prepared, load(self.values, SessionSettings))
        began_s = -math.inf if request.resume else self.now_s()
        check = FrameCheck(ScannerModel.from_settings(part.scan))
        self._replace(ScanIntake(begun.session, self._tracks, check, began_s), begun.owner)
        response.frames = begun.session.frames
        text = f"collecting for job {request.job_id}"
        if begun.warning:
            self.get_logger().warning(begun.warning)
        level, text = ("warning", begun.warning) if begun.warning else ("ok", text)
        self.set_health(level, text, part=part.id, resumed=response.frames)

    def _replace(self, intake: ScanIntake | None, owner: SpoolOwner | None) -> None:
        with self._lock:
            replaced, self._intake, self._owner = self._intake, intake, owner
        if replaced is not None:
            replaced.session.close()
            self.get_logger().warning(
                f"the scan of job {replaced.session.job_id} was never finished"
            )

    @replies_in_thread(invalid=Status.NO_CLOUD)
    def _on_finish(
        self, request: InspectionFinish.Request, response: InspectionFinish.Response
    ) -> None:
        cloud = cloud_path(request.cloud_uri)
        self._wait_for_frames()
        with self._lock:
            intake = self._intake
            if intake is None or intake.session.job_id != request.job_id:
                running = "none" if intake is None else intake.session.job_id
                raise RefusedError(
                    Status.NOT_INSPECTING,
                    f"the end of job {request.job_id!r} was asked for; the job that frames are "
                    f"collected for is accepted, that is {running}",
                )
            if not request.go_on:
                self._intake = self._owner = None
        session = intake.session
        self._publish(session)
        try:
            inspection = session.finish(cloud, final=not request.go_on)
        finally:
            if not request.go_on:
                session.close()
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
            intake = self._intake
            with self._lock:
                waiting = intake is not None and (intake.waiting > 0 or intake.needs_joints)
            late = self._seen and _LATE_S < asked_s - self._tracks.newest_s() < _LOST_S
            if self._received == before and not waiting and not late:
                return

    def _on_points(self, msg: PointCloud2) -> None:
        if self._intake is None:
            return
        try:
            if msg.width * msg.height > self.values.frame_points_max:
                raise InputError(
                    f"a scan frame of {msg.width * msg.height} points came; up to "
                    f"{self.values.frame_points_max} are accepted (frame_points_max)"
                )
            frame = scan_frame_from_msg(msg, "tracker")
        except SkinplanError as error:
            self._refuse(INVALID, str(error))
            return
        with self._lock:
            intake = self._intake
            if intake is None:
                return
            self._received += 1
            not_finite = msg.width * msg.height - len(frame.points)
            if not_finite:
                intake.counts[NOT_FINITE] += not_finite
            said = intake.offer(frame, self.now_s())
        if said:
            self._warn(said)
        self._advance()

    def _on_scanner_pose(self, msg: PoseStamped) -> None:
        try:
            T_tracker_scanner = pose_stamped_from_msg(msg, "tracker", "pose of the scanner")
            stamp_s = stamp_from_msg(msg.header.stamp)
            require_not_ahead(stamp_s, self.now_s(), "a pose of the scanner")
        except SkinplanError as error:
            self._refuse(POSES_REFUSED, str(error))
            return
        with self._lock:
            self._tracks.add_pose(stamp_s, T_tracker_scanner)
            reached_s = self._tracks.reached_s(self._seen)
        self._advance()
        self._ack.reached(reached_s)

    def _advance(self) -> None:
        """Hands on the frames whose scanner pose is known."""
        with self._lock:
            intake = self._intake
            if intake is None or not (intake.waiting or intake.unplaced):
                return
            said = intake.advance()
            intake.estimate(self._frames.moved_s)
            said = said or intake.session.spool_failure
        if said:
            self._warn(said)

    def _refuse(self, name: str, sentence: str) -> None:
        self._refused = {**self._refused, name: self._refused.get(name, 0) + 1}
        self._warn(sentence)

    def _warn(self, sentence: str) -> None:
        self.get_logger().warning(sentence, throttle_duration_sec=5.0)

    def _on_visible(self, msg: Bool) -> None:
        self._seen = bool(msg.data)
        intake = self._intake
        if intake is not None and not msg.data:
            intake.session.add_hidden()

    def _positions_of(self, state: bytes) -> Array | None:
        try:
            return np.asarray(joint_state_from_msg(deserialize_message(state, JointState))[0])
        except SkinplanError as error:
            self._warn(str(error))
            return None

    def _on_joint_state(self, state: bytes) -> None:
        stamp_s = raw_stamp_s(state)
        with self._lock:
            self._tracks.add_joints(stamp_s, state)
            if self._intake is not None and self._intake.unplaced:
                self._intake.estimate(self._frames.moved_s)
            reached_s = self._tracks.reached_s(self._seen)
        self._ack.reached(reached_s)

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

    def _on_jump(self, jump: TimeJump) -> None:
        """The clock was set back: what was taken stays, where things were is forgotten."""
        delta_s = jump.delta.nanoseconds * 1e-9
        if delta_s >= 0.0:
            return
        with self._lock:
            self._tracks.forget()
        text = (
            f"the clock was set back by {-delta_s:.3f} s; the frames so far stay, and later ones "
            f"count when they are newer than those"
        )
        self.get_logger().warning(text)
        self.set_health("warning", text)

    def _on_coverage(self) -> None:
        intake = self._intake
        if intake is not None:
            self._publish(intake.session)

    def _publish(self, session: ScanSession) -> None:
        progress = CoverageProgress(session.job_id, **vars(session.progress()))
        self._coverage.publish(coverage_progress_to_msg(progress, self.now_s()))


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    return run_node(ScanInspector, arguments)


if __name__ == "__main__":
    sys.exit(main())
