"""Mock of tracker and scanner: frames of points in the tracker frame, by rays at the true mesh."""

import math
import sys
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Bool

from skinplan.errors import CellInvalidError, SkinplanError
from skinplan.mesh.load import load_mesh
from skinplan.mock.faults import Fault, FaultKind
from skinplan.mock.scanner import MockScanner
from skinplan.mock.tracker import LineOfSight, MockTracker
from skinplan.mock.truth import Truth
from skinplan.robot.arm import ArmModel
from skinplan.scanner.model import ScannerModel
from skinplan.transforms import Array, apply, inverse
from skinplan_nodes.conversions import (
    ScanFrame,
    joint_state_from_msg,
    pose_stamped_from_msg,
    pose_stamped_to_msg,
    raw_stamp_s,
    scan_frame_to_msg,
    stamp_from_msg,
)
from skinplan_nodes.draining import subscribe_draining
from skinplan_nodes.mock_device import FAULTS, DeviceFace, FaultFace
from skinplan_nodes.mock_parts import SHOP, part_of
from skinplan_nodes.node import CellNode
from skinplan_nodes.parameters import Parameter
from skinplan_nodes.planning import configured_cell
from skinplan_nodes.qos import STATE
from skinplan_nodes.run import run_node

# While the scanner is off, ``tracker/visible`` is repeated so often [s].
_TOLD_S = 1.0
# The node's clock may lag behind the joint states by so much under load [s].
_SWITCH_OFF_S = 0.3
_INTERVALS = 16
# Faults begin and end also while nothing comes from the arm, cell time [s].
_LOOK_S = 0.2
# The base tells where it is at least so often; what comes this much later than the joint states is
# waited for no longer, cell time [s]. So many of its poses are kept.
_BASE_TICK_S, _BASE_LATE_S, _BASES = 0.1, 1.0, 2000
HIDDEN, LOST, DROPS_FRAMES = "hidden", "lost", "drops_frames"
_KINDS = (FaultKind(HIDDEN), FaultKind(LOST), FaultKind(DROPS_FRAMES, {"share": (0.5, 0.0, 1.0)}))
_REASONS = {
    HIDDEN: "something stands between tracker and scanner",
    LOST: "the tracker has lost its targets",
}


class MockCtrack(CellNode):
    """Tracks the scanner all the time, and scans while it is switched on and seen."""

    NAME = "mock_ctrack"
    THREADS = 1
    LARGE_MESSAGES = True
    PARAMETERS = (
        *SHOP,
        Parameter(
            "rate_hz",
            10.0,
            "Scan frames and scanner poses per second of simulated time [Hz].",
            1.0,
            50.0,
        ),
        Parameter("rays", 900, "Rays of a scan frame [1].", 10, 100000),
        Parameter(
            "scanner_noise_m", 3e-5, "Standard deviation of points along the ray [m].", 0.0, 0.01
        ),
        Parameter(
            "tracker_noise_m",
            2e-5,
            "Standard deviation of the scanner's position, each axis [m].",
            0.0,
            0.01,
        ),
        Parameter(
            "tracker_noise_rad",
            3e-5,
            "Standard deviation of the scanner's rotation, each axis [rad].",
            0.0,
            0.1,
        ),
        Parameter(
            "volumetric_m", 6.4e-5, "Greatest error of a length in the volume [m].", 0.0, 0.01
        ),
        FAULTS,
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        cell, part, seed = (
            configured_cell(self.values.cell_file),
            part_of(self.values),
            self.values.seed,
        )
        self._model = ArmModel.load(cell)
        self._T_base_link_arm_base = cell.T_base_link_arm_base
        T_map_workpiece = Truth(part, cell, seed).T_map_workpiece
        self._T_workpiece_map = inverse(T_map_workpiece)
        mesh = load_mesh(part.mesh_path, part.unit)
        self._scanner = MockScanner(
            mesh,
            ScannerModel.from_settings(part.scan),
            seed,
            self.values.rays,
            self.values.scanner_noise_m,
        )
        if cell.propose_tracker:
            raise CellInvalidError(
                "the cell gives no place for the tracker (T_map_tracker is null); to run, the "
                "place is needed: `skinplan plan` proposes one"
            )
        self._tracker = MockTracker(
            cell.T_map_tracker,
            seed,
            self.values.tracker_noise_m,
            self.values.tracker_noise_rad,
            self.values.volumetric_m,
        )
        self._sight = LineOfSight(cell, self._model, mesh, T_map_workpiece)
        self._random = np.random.default_rng([seed, 0xD20F])
        # Begin and end of scanning on the cell's clock: joint states that still wait when the
        # scanner is switched belong to the time before.
        self._intervals: deque[list[float]] = deque(maxlen=_INTERVALS)
        self._next_s = self._told_s = -math.inf
        self._seen = False
        # Where the base truly was, by time; joint states that wait until that is known.
        self._bases: deque[tuple[float, Array]] = deque(maxlen=_BASES)
        self._waiting: deque[tuple[float, bytes]] = deque()
        self._place: Array | None = None
        self._points = self.create_publisher(PointCloud2, "scanner/points", STATE)
        self._pose = self.create_publisher(PoseStamped, "tracker/scanner_pose", STATE)
        self._visible = self.create_publisher(Bool, "tracker/visible", STATE)
        subscribe_draining(self, PoseStamped, "truth/base_pose", self._on_base_pose, STATE)
        subscribe_draining(self, JointState, "joint_states", self._on_joint_state, STATE, raw=True)
        self._tracker_face = DeviceFace(self, "tracker")
        self._scanner_face = DeviceFace(
            self, "scanner", lambda _: self._switch(False), self._switch
        )
        self._scanner_face.device.enabled = False
        self._faults = FaultFace(self, _KINDS, self._on_fault, self._on_fault_end)
        self.create_timer(_LOOK_S, self._on_look)

    def _switch(self, on: bool) -> None:
        was_on = bool(self._intervals) and math.isinf(self._intervals[-1][1])
        if on and not was_on:
            self._intervals.append([self.now_s(), math.inf])
        elif was_on and not on:
            self._intervals[-1][1] = self.now_s() + _SWITCH_OFF_S
        self._scanner_face.device.enabled = on

    def _on_fault(self, fault: Fault) -> None:
        # A scanner that drops frames does not know it.
        if fault.name in _REASONS:
            self._tracker_face.fail(fault.name, _REASONS[fault.name])

    def _on_fault_end(self, name: str) -> None:
        self._tracker_face.device.cause_gone(name)
        self._tracker_face.refresh()

    def _on_look(self) -> None:
        self._faults.step(self.now_s(), self._place)
        self._scanner_face.device.busy = self._is_scanning(self.now_s())
        self._scanner_face.refresh()
        self._tracker_face.refresh()

    def _is_scanning(self, stamp_s: float) -> bool:
        return any(begin <= stamp_s <= end for begin, end in self._intervals)

    def _on_base_pose(self, message: PoseStamped) -> None:
        pose = pose_stamped_from_msg(message, "map", "true pose of the base")
        self._bases.append((stamp_from_msg(message.header.stamp), pose))
        self._catch_up(self._waiting[-1][0] if self._waiting else -math.inf)

    def _on_joint_state(self, raw: bytes) -> None:
        stamp_s = raw_stamp_s(raw)
        period_s = 1.0 / self.values.rate_hz
        # A millisecond early counts: stamps are rounded.
        if self._bases and stamp_s >= self._next_s - 1e-3:
            self._next_s = (math.floor(stamp_s / period_s + 1e-3) + 1) * period_s
            self._waiting.append((stamp_s, raw))
        self._catch_up(stamp_s)

    def _catch_up(self, now_s: float) -> None:
        """Takes the frames of which it is known by now where the base stood.

        On a busy machine either of the two topics comes late; a base that has died tells nothing.
        """
        while self._waiting:
            stamp_s, raw = self._waiting[0]
            known = self._bases[-1][0] >= stamp_s - _BASE_TICK_S
            if not known and now_s - stamp_s < _BASE_LATE_S:
                return
            self._waiting.popleft()
            self._frame(stamp_s, raw, self._base_at(stamp_s))

    def _base_at(self, stamp_s: float) -> Array:
        """Returns the base's last pose up to a time; the first one known before that."""
        for known_s, pose in reversed(self._bases):
            if known_s <= stamp_s + 1e-3:
                return pose
        return self._bases[0][1]

    def _frame(self, stamp_s: float, raw: bytes, T_map_base_link: Array) -> None:
        try:
            message = deserialize_message(raw, JointState)
            joints, _ = joint_state_from_msg(message, self._model.joint_names)
        except SkinplanError as error:
            self.get_logger().warning(str(error))
            return
        T_map_arm_base = T_map_base_link @ self._T_base_link_arm_base
        T_map_scanner = T_map_arm_base @ self._model.forward_scanner(joints[None, :])[0]
        self._place = T_map_scanner[:3, 3]
        self._faults.step(stamp_s, self._place)
        free = not self._tracker_face.device.refusal
        seen = free and not self._sight.hindrance(joints, T_map_arm_base)
        self._track(T_map_scanner, stamp_s, seen)

    def _track(self, T_map_scanner: Array, stamp_s: float, seen: bool) -> None:
        scanning = self._is_scanning(stamp_s)
        if scanning or seen != self._seen or stamp_s - self._told_s >= _TOLD_S:
            self._seen, self._told_s = seen, stamp_s
            self._visible.publish(Bool(data=seen))
        if not seen:
            return
        T_tracker_scanner = self._tracker.measure(T_map_scanner)
        self._pose.publish(pose_stamped_to_msg(T_tracker_scanner, "tracker", stamp_s))
        drops = self._faults.book.values(DROPS_FRAMES)
        if not scanning or (drops is not None and self._random.uniform() < drops["share"]):
            return
        frame = self._scanner.frame(self._T_workpiece_map @ T_map_scanner)
        values = {
            "intensity": np.asarray(frame.intensity),
            "incidence": np.asarray(frame.incidence),
        }
        points = apply(T_tracker_scanner, frame.points)
        self._points.publish(scan_frame_to_msg(ScanFrame(points, values, "tracker", stamp_s)))


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    return run_node(MockCtrack, arguments)


if __name__ == "__main__":
    sys.exit(main())
