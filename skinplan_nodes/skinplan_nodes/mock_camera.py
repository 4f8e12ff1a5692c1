"""Mock of the localisation camera: renders the markers from where the camera truly is."""

import sys
from collections.abc import Sequence
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.timer import Timer
from sensor_msgs.msg import CameraInfo, Image

from skinplan.errors import SkinplanError
from skinplan.localization.camera import camera_model
from skinplan.mock.camera import MockCamera as CameraModel
from skinplan.transforms import Array, inverse
from skinplan_nodes.conversions import (
    camera_info_to_msg,
    image_to_msg,
    pose_stamped_from_msg,
    stamp_from_msg,
)
from skinplan_nodes.mock_parts import SHOP, part_of
from skinplan_nodes.node import AUTOSTART, CellLifecycleNode
from skinplan_nodes.parameters import Parameter
from skinplan_nodes.planning import configured_cell
from skinplan_nodes.qos import IMAGE, LATCHED, STATE
from skinplan_nodes.run import run_node

FRAME = "camera_color_optical_frame"


class MockCamera(CellLifecycleNode):
    """Publishes images while active; the other mocks tell where base and part truly are."""

    NAME = "mock_camera"
    THREADS = 1
    PARAMETERS = (
        *SHOP,
        Parameter("rate_hz", 1.0, "Images per second of simulated time [Hz].", 0.1, 30.0),
        AUTOSTART,
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._cell, self._part = configured_cell(self.values.cell_file), part_of(self.values)
        self._info = camera_model(self._cell.camera)
        self._camera: CameraModel | None = None
        self._timer: Timer | None = None
        self._base: tuple[float, Array] | None = None
        self._T_map_workpiece: Array | None = None
        self._images = self.create_publisher(Image, "camera/color/image_raw", IMAGE)
        self._infos = self.create_publisher(CameraInfo, "camera/color/camera_info", IMAGE)
        self.create_subscription(PoseStamped, "truth/base_pose", self._on_base_pose, STATE)
        self.create_subscription(
            PoseStamped, "truth/workpiece_pose", self._on_workpiece_pose, LATCHED
        )
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
        if self._camera is None or self._base is None or self._T_map_workpiece is None:
            return
        # The stamp is that of the pose which is rendered: on a busy machine the newest one known
        # may be some time old, and an image must not claim to be newer than what it shows.
        stamp_s, T_map_base_link = self._base
        T_map_camera = T_map_base_link @ self._cell.camera.T_base_link_optical
        image = self._camera.render(inverse(T_map_camera) @ self._T_map_workpiece)
        self._infos.publish(camera_info_to_msg(self._info, FRAME, stamp_s))
        self._images.publish(image_to_msg(image, FRAME, stamp_s))


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    return run_node(MockCamera, arguments)


if __name__ == "__main__":
    sys.exit(main())
