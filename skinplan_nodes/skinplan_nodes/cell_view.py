"""Node ``cell_view``: what RViz and Foxglove show of the cell beside its own topics."""

import sys
import threading
from collections.abc import Sequence
from typing import Any

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from skinplan_msgs import msg as messages
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from skinplan.errors import SkinplanError
from skinplan.mesh.check import check_mesh
from skinplan.mesh.load import load_mesh
from skinplan.mesh.model import SurfaceMesh
from skinplan.part.files import load_part
from skinplan.part.model import ScanSettings
from skinplan.robot.urdf import DrawnRobot
from skinplan.scan_path.model import ScanPath
from skinplan.scanner.seen_places import seen_places
from skinplan_nodes.cell_markers import (
    coverage_markers,
    frustum_markers,
    part_markers,
    path_markers,
    progress_markers,
    station_markers,
)
from skinplan_nodes.conversions import (
    scan_path_from_msg,
    stamp_from_msg,
    station_plan_from_msg,
    transform_stamped_to_msg,
)
from skinplan_nodes.draining import subscribe_draining
from skinplan_nodes.node import CellNode
from skinplan_nodes.parameters import CELL_FILE, Parameter
from skinplan_nodes.part_cache import part_path
from skinplan_nodes.planning import configured_cell
from skinplan_nodes.qos import LATCHED, STATE
from skinplan_nodes.run import run_node

_JOIN_S = 5.0
# Frames that the driver of the arm publishes itself.
_OWN = ("tool0",)


class CellView(CellNode):
    """Publishes markers, the robot's description and the frames of its links."""

    NAME = "cell_view"
    PARAMETERS = (
        CELL_FILE,
        Parameter(
            "part_uri",
            "",
            "Part to show: absolute path or file:// URI of a part.yaml; empty = none.",
        ),
        Parameter("tf_rate_hz", 5.0, "Frames of the links, wall time [Hz].", 0.1, 50.0),
        Parameter("spacing_m", 0.02, "Distance of the places of view/coverage [m].", 0.002, 0.2),
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._robot = DrawnRobot(configured_cell(self.values.cell_file))
        self._views = {
            name: self.create_publisher(MarkerArray, f"view/{name}", LATCHED)
            for name in ("part", "scan_path", "stations", "frusta", "coverage", "progress")
        }
        self._description = self.create_publisher(String, "robot_description", LATCHED)
        self._tf = self.create_publisher(TFMessage, "tf", STATE)
        self._joints: bytes | None = None
        self._mesh: SurfaceMesh | None = None
        self._settings = ScanSettings()
        self._worker: threading.Thread | None = None
        self._description.publish(String(data=self._robot.text))
        if self.values.part_uri:
            self._show_part(self.values.part_uri)
        self._subscribe()
        self.create_timer(1.0 / self.values.tf_rate_hz, self._publish_links)

    def close(self) -> None:
        """Waits for what is being computed."""
        if self._worker is not None:
            self._worker.join(_JOIN_S)

    def _subscribe(self) -> None:
        for kind, topic, handler, qos in (
            (messages.ScanPath, "scan_path", self._on_scan_path, LATCHED),
            (messages.StationPlan, "station_plan", self._on_station_plan, LATCHED),
            (messages.CoverageState, "coverage", self._on_coverage, STATE),
        ):
            self.create_subscription(kind, topic, handler, qos)
        # Taken apart only as often as the links are published.
        subscribe_draining(self, JointState, "joint_states", self._on_joints, STATE, raw=True)

    def _show_part(self, uri: str) -> None:
        part = load_part(part_path(uri))
        self._settings = part.scan
        self._mesh = check_mesh(load_mesh(part.mesh_path, part.unit))[0]
        self._views["part"].publish(part_markers(self._mesh))

    def _on_scan_path(self, msg: messages.ScanPath) -> None:
        try:
            path = scan_path_from_msg(msg)
        except SkinplanError as error:
            self.get_logger().warning(f"scan_path is not shown: {error}")
            return
        self._views["scan_path"].publish(path_markers(path))
        self._views["frusta"].publish(frustum_markers(path, self._settings))
        if self._mesh is not None:
            self._worker = threading.Thread(
                target=self._show_coverage, args=(self._mesh, path), daemon=True
            )
            self._worker.start()

    def _show_coverage(self, mesh: SurfaceMesh, path: ScanPath) -> None:
        try:
            found = seen_places(mesh, path, self._settings, self.values.spacing_m)
            if not self.ended():
                self._views["coverage"].publish(coverage_markers(*found))
        except Exception as error:
            if not self.ended():
                self.get_logger().warning(f"view/coverage is not shown: {error}")

    def _on_station_plan(self, msg: messages.StationPlan) -> None:
        try:
            self._views["stations"].publish(station_markers(station_plan_from_msg(msg)))
        except SkinplanError as error:
            self.get_logger().warning(f"station_plan is not shown: {error}")

    def _on_coverage(self, msg: messages.CoverageState) -> None:
        self._views["progress"].publish(progress_markers(msg.area_ratio, msg.points))

    def _on_joints(self, raw: bytes) -> None:
        self._joints = raw

    def _publish_links(self) -> None:
        raw, self._joints = self._joints, None
        if raw is None:
            return
        state = deserialize_message(raw, JointState)
        positions = dict(zip(state.name, state.position, strict=False))
        stamp_s = stamp_from_msg(state.header.stamp)
        edges = [
            transform_stamped_to_msg(parent, child, T_parent_child, stamp_s)
            for parent, child, T_parent_child in self._robot.links(positions)
            if child not in _OWN
        ]
        self._tf.publish(TFMessage(transforms=edges))


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    return run_node(CellView, arguments)


if __name__ == "__main__":
    sys.exit(main())
