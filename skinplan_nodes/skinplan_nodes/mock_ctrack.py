"""Mock of tracker and scanner: frames of points in the tracker frame, by rays at the true mesh."""

import math
import sys
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Bool
from std_srvs.srv import SetBool

from skinplan.errors import CellInvalidError, SkinplanError
from skinplan.mesh.load import load_mesh
from skinplan.mock.scanner import MockScanner, MockTracker
from skinplan.mock.truth import Truth
from skinplan.robot.arm import ArmModel
from skinplan.scanner.model import ScannerModel
from skinplan.transforms import Array, apply, inverse
from skinplan_nodes.conversions import (
    ScanFrame,
    joint_state_from_msg,
    pose_stamped_from_msg,
    pose_stamped_to_msg,
    scan_frame_to_msg,
    stamp_from_msg,
)
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


class MockCtrack(CellNode):
    """Tracks the scanner all the time, and scans while it is switched on and seen."""

    NAME = "mock_ctrack"
    THREADS = 1
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
        self._T_workpiece_map = inverse(Truth(part, cell, seed).T_map_workpiece)
        mesh = load_mesh(part.mesh_path, part.unit)
        self._scanner = MockScanner(
            mesh, ScannerModel.from_settings(part.scan), seed, self.values.rays
        )
        if cell.propose_tracker:
            raise CellInvalidError(
                "the cell gives no place for the tracker (T_map_tracker is null); to run, the "
                "place is needed: `skinplan plan` proposes one"
            )
        figures = cell.tracker
        self._tracker = MockTracker(
            cell.T_map_tracker,
            seed,
            (figures.range_min_m, figures.range_max_m),
            figures.cone_rad,
        )
        # Begin and end of scanning on the cell's clock: joint states that still wait when the
        # scanner is switched belong to the time before.
        self._intervals: deque[list[float]] = deque(maxlen=_INTERVALS)
        self._next_s = self._told_s = -math.inf
        self._seen = False
        self._T_map_base_link: Array | None = None
        self._points = self.create_publisher(PointCloud2, "scanner/points", STATE)
        self._pose = self.create_publisher(PoseStamped, "tracker/scanner_pose", STATE)
        self._visible = self.create_publisher(Bool, "tracker/visible", STATE)
        self.create_subscription(PoseStamped, "truth/base_pose", self._on_base_pose, STATE)
        self.create_subscription(JointState, "joint_states", self._on_joint_state, STATE)
        self.create_service(SetBool, "scanner/enable", self._on_enable)

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        on = bool(self._intervals) and math.isinf(self._intervals[-1][1])
        if request.data and not on:
            self._intervals.append([self.now_s(), math.inf])
        elif on and not request.data:
            self._intervals[-1][1] = self.now_s() + _SWITCH_OFF_S
        response.success = True
        response.message = "scanner on" if request.data else "scanner off"
        return response

    def _on_base_pose(self, message: PoseStamped) -> None:
        self._T_map_base_link = pose_stamped_from_msg(message, "map", "true pose of the base")

    def _on_joint_state(self, message: JointState) -> None:
        stamp_s = stamp_from_msg(message.header.stamp)
        period_s = 1.0 / self.values.rate_hz
        # A millisecond early counts: stamps are rounded.
        if self._T_map_base_link is None or stamp_s < self._next_s - 1e-3:
            return
        self._next_s = (math.floor(stamp_s / period_s + 1e-3) + 1) * period_s
        try:
            joints, _ = joint_state_from_msg(message, self._model.joint_names)
        except SkinplanError as error:
            self.get_logger().warning(str(error))
            return
        T_arm_base_scanner = self._model.forward_scanner(joints[None, :])[0]
        self._track(
            self._T_map_base_link @ self._T_base_link_arm_base @ T_arm_base_scanner, stamp_s
        )

    def _track(self, T_map_scanner: Array, stamp_s: float) -> None:
        seen = self._tracker.sees(T_map_scanner)
        scanning = any(begin <= stamp_s <= end for begin, end in self._intervals)
        if scanning or seen != self._seen or stamp_s - self._told_s >= _TOLD_S:
            self._seen, self._told_s = seen, stamp_s
            self._visible.publish(Bool(data=seen))
        if not seen:
            return
        T_tracker_scanner = self._tracker.measure(T_map_scanner)
        self._pose.publish(pose_stamped_to_msg(T_tracker_scanner, "tracker", stamp_s))
        if not scanning:
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
