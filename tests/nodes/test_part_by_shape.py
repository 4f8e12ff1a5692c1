"""Where a part without markers stands, by depth images: recognizer and mock camera as nodes."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.action import ActionClient
from scipy.spatial.transform import Rotation
from skinplan_msgs.action import LocalizePart
from skinplan_msgs.msg import PartPose, Status
from skinplan_msgs.srv import IdentifyPart
from tf2_msgs.msg import TFMessage

from nodes.bench import Bench
from nodes.localizer_cell import drive
from nodes.shape_part import write_shape_part
from nodes.small_part import reference
from shape_parts import flat, two_bumps
from skinplan.mock.truth import Truth
from skinplan.part.model import Part
from skinplan.robot.cell import CellConfig
from skinplan.transforms import Array, inverse, planar, transform
from skinplan_nodes.aruco_localizer import ArucoLocalizer
from skinplan_nodes.conversions import (
    part_pose_from_msg,
    pose_stamped_from_msg,
    pose_stamped_to_msg,
    transform_stamped_to_msg,
)
from skinplan_nodes.mock_camera import MockCamera
from skinplan_nodes.mock_mir100 import MockMir100, static_transforms
from skinplan_nodes.part_recognizer import PartRecognizer
from skinplan_nodes.qos import LATCHED, STATE, STATIC_TF

CELL = CellConfig()
NEAR, FAR = planar(-0.3, -1.0, 0.0), planar(-0.3, -2.0, 0.0)
# Beside its nominal place by 30 mm and 2 degrees.
OFF = transform(
    (0.02, -0.02, 0.01),
    Rotation.from_rotvec(np.radians(2.0) * np.array([0.6, 0.0, 0.8])).as_matrix(),
)


class Cell:
    """A camera before a part that stands beside its nominal place, and the recognizer."""

    def __init__(self, bench: Bench, stands: Part, base: Array, **parameters: Any) -> None:
        self.bench, self.base = bench, base
        create = bench.tester.create_publisher
        true_base = create(PoseStamped, "truth/base_pose", STATE)
        place = create(PoseStamped, "truth/workpiece_pose", LATCHED)
        frames = create(TFMessage, "tf_static", STATIC_TF)
        moving = create(TFMessage, "tf", STATE)
        bench.start(MockCamera, part_uri=str(stands.source), rate_hz=10.0)
        self.recognizer = bench.start(PartRecognizer, camera_timeout_s=5.0, **parameters)
        frames.publish(TFMessage(transforms=static_transforms(CELL)))
        bench.wait(lambda: true_base.get_subscription_count() and place.get_subscription_count())
        bench.wait(lambda: moving.get_subscription_count() >= 1)
        self.T_map_workpiece = stands.T_map_workpiece @ OFF
        place.publish(pose_stamped_to_msg(self.T_map_workpiece, "map"))
        self._true_base, self._moving = true_base, moving
        self.stand(base)

    def stand(self, base: Array) -> None:
        """Puts the base elsewhere."""
        self.base = base
        stamp_s = self.bench.now_s
        edge = transform_stamped_to_msg("map", "base_link", base, stamp_s)
        self._moving.publish(TFMessage(transforms=[edge]))
        # Images of all that follows are new.
        self._true_base.publish(pose_stamped_to_msg(base, "map", stamp_s + 1000.0))
        known = self.recognizer._frames
        self.bench.wait(lambda: known._base is not None and np.allclose(known._base, base))

    @property
    def truth(self) -> Array:
        """``T_arm_base_workpiece``."""
        return inverse(self.base @ CELL.T_base_link_arm_base) @ self.T_map_workpiece


def locate(bench: Bench, part: Part, action: str = "locate_part_by_shape", **goal: Any) -> Any:
    """Asks where a part is."""
    client = ActionClient(bench.tester, LocalizePart, action)
    bench.wait(client.server_is_ready)
    request = LocalizePart.Goal(part=reference(part), **goal)
    handle = bench.result(client.send_goal_async(request), turning=True)
    assert handle.accepted
    return bench.result(handle.get_result_async(), turning=True).result


def errors(found: Array, truth: Array) -> Array:
    """Returns x y z [m] rx ry rz [rad] of a pose against the truth."""
    turned = Rotation.from_matrix(found[:3, :3] @ truth[:3, :3].T).as_rotvec()
    return np.concatenate([found[:3, 3] - truth[:3, 3], turned])


def test_a_part_beside_its_place_is_located(bench: Bench, tmp_path: Path) -> None:
    part = write_shape_part(tmp_path / "part")
    cell = Cell(bench, part, NEAR)
    told = bench.collect(PartPose, "part_pose", LATCHED)
    result = locate(bench, part)
    assert result.status.code == Status.OK, result.status.message
    located = part_pose_from_msg(result.part_pose)
    off = errors(located.T_arm_base_workpiece, cell.truth)
    assert np.linalg.norm(off[:3]) < 0.002 and np.degrees(np.linalg.norm(off[3:])) < 0.2, off
    sigma = np.sqrt(np.diag(located.covariance))
    assert (np.abs(off) < 3.0 * sigma).all(), (off, sigma)
    assert (sigma[:3] < 0.001).all() and (sigma[3:] < np.radians(0.1)).all()
    assert result.quality == 1.0 and result.attempts == 1 and not located.marker_ids.size
    in_map = pose_stamped_from_msg(result.map_pose, "map", "pose of the part")
    assert np.abs(in_map - cell.T_map_workpiece).max() < 0.003
    bench.wait(lambda: told)
    assert told[-1] == result.part_pose
    stands = cell.recognizer._frames
    bench.wait(lambda: np.allclose(stands.lookup("map", "workpiece"), in_map), turning=True)


def test_what_the_shape_leaves_open_is_named(bench: Bench, tmp_path: Path) -> None:
    plate = write_shape_part(tmp_path / "plate", "plate", flat)
    cell = Cell(bench, plate, NEAR)
    result = locate(bench, plate)
    assert result.status.code == Status.AMBIGUOUS_POSE
    assert "the images leave open: shift along" in result.status.message
    assert result.part_pose == PartPose(), "nothing is guessed"
    assert cell.recognizer._locator._T_map_workpiece is None


def test_what_is_not_good_enough_or_not_there_is_named(bench: Bench, tmp_path: Path) -> None:
    part = write_shape_part(tmp_path / "part")
    other = write_shape_part(tmp_path / "other", "other", lambda x, y: 2.0 * two_bumps(-x, y))
    cell = Cell(bench, part, FAR)
    far = locate(bench, part)
    assert far.status.code == Status.QUALITY_NOT_REACHED and 0.0 < far.quality < 1.0
    assert "(3 sigma), up to 2.5 mm was asked for without moving" in far.status.message
    rough = locate(bench, part, quality_threshold=0.05)
    assert rough.status.code == Status.OK and rough.quality == pytest.approx(far.quality, abs=0.2)
    # As the supervisor identifies it.
    request = IdentifyPart.Request(
        candidates=[reference(part), reference(other)], source=1, part_pose=rough.part_pose
    )
    known = bench.call(IdentifyPart, "identify_part", request, turning=True)
    assert (known.index, known.fits) == (0, [True, False]), known.status.message
    wrong = locate(bench, other, quality_threshold=0.05)
    assert wrong.status.code in (Status.ALIGNMENT_FAILED, Status.AMBIGUOUS_POSE)
    odd = locate(bench, part, quality_threshold=2.0)
    assert odd.status.code == Status.REQUEST_INVALID and "0 to 1" in odd.status.message
    cell.stand(planar(3.0, -2.0, 0.0))
    gone = locate(bench, part)
    assert gone.status.code == Status.PART_NOT_SEEN, gone.status.message


@pytest.mark.long
def test_the_base_comes_nearer_and_the_frame_has_one_owner(bench: Bench, tmp_path: Path) -> None:
    part = write_shape_part(tmp_path / "part")
    base = bench.start(MockMir100, part_uri=str(part.source), seed=3)
    bench.start(MockCamera, part_uri=str(part.source), rate_hz=5.0, seed=3)
    recognizer = bench.start(PartRecognizer, camera_timeout_s=10.0)
    localizer = bench.start(ArucoLocalizer)
    refused = locate(bench, part, "localize_part")
    assert refused.status.code == Status.PART_INVALID
    assert "or the action locate_part_by_shape" in refused.status.message
    drive(bench, CELL.T_map_work)
    result = locate(bench, part, may_move=True, new_place=True)
    assert result.status.code == Status.OK, result.status.message
    assert result.attempts > 1 and result.quality == 1.0
    truth = Truth(part, CELL, 3)
    expected = inverse(base._base.true @ CELL.T_base_link_arm_base) @ truth.T_map_workpiece
    off = errors(part_pose_from_msg(result.part_pose).T_arm_base_workpiece, expected)
    assert np.linalg.norm(off[:3]) < 0.002 and np.degrees(np.linalg.norm(off[3:])) < 0.2, off
    # Once somebody locates a part by markers, its frame is his.
    assert recognizer._locator._T_map_workpiece is not None
    assert localizer._T_map_workpiece is None
    marked = bench.tester.create_publisher(PartPose, "part_pose", LATCHED)
    bench.wait(lambda: marked.get_subscription_count() >= 2)
    marked.publish(PartPose(marker_ids=[1]))
    bench.wait(lambda: recognizer._locator._T_map_workpiece is None)
