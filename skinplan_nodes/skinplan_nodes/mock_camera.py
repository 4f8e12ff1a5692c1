"""Mock of the localisation camera: renders the markers from where the camera truly is."""

import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.timer import Timer
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

from skinplan.errors import SkinplanError
from skinplan.localization.camera import camera_model
from skinplan.mesh.load import load_mesh
from skinplan.mock.camera import Image as Picture
from skinplan.mock.camera import MockCamera as CameraModel
from skinplan.mock.depth_camera import DepthCamera
from skinplan.mock.faults import Fault, FaultKind
from skinplan.transforms import Array, inverse
from skinplan_nodes.conversions import (
    ScanFrame,
    camera_info_to_msg,
    image_to_msg,
    pose_stamped_from_msg,
    scan_frame_to_msg,
    stamp_from_msg,
)
from skinplan_nodes.draining import subscribe_draining
from skinplan_nodes.mock_device import FAULTS, DeviceFace, FaultFace
from skinplan_nodes.mock_parts import SHOP, part_of
from skinplan_nodes.node import AUTOSTART, CellLifecycleNode
from skinplan_nodes.parameters import Parameter
from skinplan_nodes.planning import configured_cell
from skinplan_nodes.qos import IMAGE, LATCHED, STATE
from skinplan_nodes.run import run_node

FRAME = "camera_color_optical_frame"
DEPTH = "camera/depth/color/points"
# Depth is made when somebody looks at it; that it is recorded then does not count.
_RECORDER = "run_recorder"
FROZEN, DARK, STALE_STAMPS, NO_IMAGES = "frozen", "dark", "stale_stamps", "no_images"
_KINDS = (
    FaultKind(FROZEN),
    FaultKind(DARK, {"light": (0.01, 0.0, 1.0)}),
    FaultKind(STALE_STAMPS, {"age": (10.0, 0.0, 3600.0)}),
    FaultKind(NO_IMAGES),
)


class MockCamera(CellLifecycleNode):
    """Publishes images while active; the other mocks tell where base and part truly are."""

    NAME = "mock_camera"
    THREADS = 1
    LARGE_MESSAGES = True
    PARAMETERS = (
        *SHOP,
        Parameter("rate_hz", 1.0, "Images per second of simulated time [Hz].", 0.1, 30.0),
        FAULTS,
        AUTOSTART,
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._cell, self._part = configured_cell(self.values.cell_file), part_of(self.values)
        self._info = camera_model(self._cell.camera)
        self._camera: CameraModel | None = None
        self._depth_camera: DepthCamera | None = None
        self._timer: Timer | None = None
        self._base: tuple[float, Array] | None = None
        self._T_map_workpiece: Array | None = None
        self._images = self.create_publisher(Image, "camera/color/image_raw", IMAGE)
        self._infos = self.create_publisher(CameraInfo, "camera/color/camera_info", IMAGE)
        subscribe_draining(self, PoseStamped, "truth/base_pose", self._on_base_pose, STATE)
        self._clouds = self.create_publisher(PointCloud2, DEPTH, IMAGE)
        self.create_subscription(
            PoseStamped, "truth/workpiece_pose", self._on_workpiece_pose, LATCHED
        )
        self._last: Picture | None = None
        self._pictured_from = np.eye(4)
        self._points: Array | None = None
        self._face = DeviceFace(self, "camera")
        self._faults = FaultFace(self, _KINDS, self._on_fault, self._on_fault_end)
        self.autostart()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Opens the device."""
        try:
            self._camera = CameraModel(self._cell.camera, self._part.fixture, self.values.seed)
        except SkinplanError as error:
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begins to publish."""
        self._timer = self.create_timer(1.0 / self.values.rate_hz, self._on_tick)
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Ends publishing."""
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Closes the device."""
        self._camera = None
        return TransitionCallbackReturn.SUCCESS

    def _on_base_pose(self, message: PoseStamped) -> None:
        pose = pose_stamped_from_msg(message, "map", "true pose of the base")
        self._base = (stamp_from_msg(message.header.stamp), pose)

    def _on_workpiece_pose(self, message: PoseStamped) -> None:
        self._T_map_workpiece = pose_stamped_from_msg(message, "map", "true pose of the part")

    def _on_tick(self) -> None:
        place = None if self._base is None else self._base[1][:3, 3]
        self._faults.step(self.now_s(), place)
        self._face.refresh()
        if self._camera is None or self._base is None or self._T_map_workpiece is None:
            return
        # The stamp is that of the pose which is rendered: on a busy machine the newest one known
        # may be some time old, and an image must not claim to be newer than what it shows.
        stamp_s, T_map_base_link = self._base
        if self._face.device.refusal:
            return
        T_map_camera = T_map_base_link @ self._cell.camera.T_base_link_optical
        T_camera_workpiece = inverse(T_map_camera) @ self._T_map_workpiece
        image = self._picture(self._camera, T_camera_workpiece)
        stale = self._faults.book.values(STALE_STAMPS)
        if stale is not None:
            stamp_s = max(stamp_s - stale["age"], 0.0)
        self._infos.publish(camera_info_to_msg(self._info, FRAME, stamp_s))
        self._images.publish(image_to_msg(image, FRAME, stamp_s))
        if self._depth_is_wanted():
            points = self._seen(T_camera_workpiece)
            self._clouds.publish(scan_frame_to_msg(ScanFrame(points, {}, FRAME, stamp_s)))

    def _depth_is_wanted(self) -> bool:
        if not self._clouds.get_subscription_count():
            return False
        listeners = self.get_subscriptions_info_by_topic(self._clouds.topic_name)
        return any(listener.node_name != _RECORDER for listener in listeners)

    def _seen(self, T_camera_workpiece: Array) -> Array:
        """Returns the points of a depth image; a frozen camera repeats that of its picture."""
        if self._faults.book.values(FROZEN) is None:
            self._points = None
            return self._depth().cloud(T_camera_workpiece)
        if self._points is None:
            self._points = self._depth().cloud(self._pictured_from)
        return self._points

    def _depth(self) -> DepthCamera:
        if self._depth_camera is None:
            mesh = load_mesh(self._part.mesh_path, self._part.unit)
            self._depth_camera = DepthCamera(self._cell.camera, mesh, self.values.seed)
        return self._depth_camera

    def _picture(self, camera: CameraModel, T_camera_workpiece: Array) -> Picture:
        if self._last is not None and self._faults.book.values(FROZEN) is not None:
            return self._last
        dark = self._faults.book.values(DARK)
        camera.light = 1.0 if dark is None else dark["light"]
        self._last, self._pictured_from = camera.render(T_camera_workpiece), T_camera_workpiece
        return self._last

    def _on_fault(self, fault: Fault) -> None:
        # Of the others a camera does not know itself.
        if fault.name == NO_IMAGES:
            self._face.fail(fault.name, "the camera gives no images")

    def _on_fault_end(self, name: str) -> None:
        self._face.device.cause_gone(name)
        self._face.refresh()


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    return run_node(MockCamera, arguments)


if __name__ == "__main__":
    sys.exit(main())
