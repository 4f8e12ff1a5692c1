"""Which part the camera sees on the fixture: recognizer and mock camera as real nodes."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import PointCloud2
from skinplan_msgs.msg import Status
from skinplan_msgs.srv import IdentifyPart, InjectFault
from tf2_msgs.msg import TFMessage

from nodes.bench import Bench
from nodes.small_part import reference, write_small_part
from skinplan.part.files import load_part, save_part
from skinplan.part.model import Part
from skinplan.robot.cell import CellConfig
from skinplan.transforms import Array, inverse, transform
from skinplan_nodes.conversions import (
    LocatedPart,
    part_pose_to_msg,
    pose_stamped_to_msg,
    transform_stamped_to_msg,
)
from skinplan_nodes.mock_camera import DEPTH, MockCamera
from skinplan_nodes.mock_mir100 import static_transforms
from skinplan_nodes.part_recognizer import PartRecognizer
from skinplan_nodes.qos import IMAGE, LATCHED, STATE, STATIC_TF

CELL = CellConfig()
BASE = CELL.T_map_work


def part_in(folder: Path, name: str, height_m: float) -> Part:
    """Writes a part under a name of its own; all of them have the same fixture."""
    folder.mkdir()
    written = replace(write_small_part(folder, height_m), id=name)
    assert written.source is not None
    save_part(written, written.source)
    return load_part(written.source)


@pytest.fixture
def parts(tmp_path: Path) -> dict[str, Part]:
    """Three parts, two of which no depth camera tells apart."""
    heights = {"rib": 0.03, "twin": 0.0305, "other": 0.055}
    return {name: part_in(tmp_path / name, name, height) for name, height in heights.items()}


class Cell:
    """A camera before a part, and the recognizer."""

    def __init__(self, bench: Bench, stands: Part) -> None:
        self.bench = bench
        create = bench.tester.create_publisher
        base = create(PoseStamped, "truth/base_pose", STATE)
        place = create(PoseStamped, "truth/workpiece_pose", LATCHED)
        frames = create(TFMessage, "tf_static", STATIC_TF)
        bench.start(MockCamera, part_uri=str(stands.source), rate_hz=10.0)
        self.recognizer = bench.start(PartRecognizer, camera_timeout_s=5.0)
        self.moving = create(TFMessage, "tf", STATE)
        frames.publish(TFMessage(transforms=static_transforms(CELL)))
        bench.wait(lambda: base.get_subscription_count() and place.get_subscription_count())
        place.publish(pose_stamped_to_msg(stands.T_map_workpiece, "map"))
        base.publish(pose_stamped_to_msg(BASE, "map", 2.0))
        self.base = base
        self.T_arm_base_workpiece: Array = (
            inverse(BASE @ CELL.T_base_link_arm_base) @ stands.T_map_workpiece
        )

    def ask(self, *candidates: Part, pose: Array | None = None, source: int = 1) -> Any:
        """Asks which of the parts it is."""
        request = IdentifyPart.Request(
            candidates=[reference(part) for part in candidates], source=source
        )
        if pose is not None:
            located = LocatedPart(
                pose, np.zeros((6, 6)), 0.9, 0.1, np.zeros(0, dtype=np.int64), 1.0
            )
            request.part_pose = part_pose_to_msg(located)
        self.bench.turn_clock(self.bench.now_s + 0.5)
        return self.bench.call(IdentifyPart, "identify_part", request, turning=True)

    def ask_after_a_drive(self, part: Part) -> Any:
        """Asks with a pose from before the base has moved."""
        for x_m, stamp_s in ((0.0, 5.0), (0.1, 6.0)):
            edge = transform_stamped_to_msg(
                "odom", "base_link", transform((x_m, 0.0, 0.0)), stamp_s
            )
            self.moving.publish(TFMessage(transforms=[edge]))
        self.bench.wait(lambda: self.recognizer._frames.moved_s == 6.0)
        return self.ask_here(part)

    def ask_here(self, *candidates: Part) -> Any:
        """Asks, and says where the part stands."""
        return self.ask(*candidates, pose=self.T_arm_base_workpiece)


def test_the_part_on_the_fixture_is_told(bench: Bench, parts: dict[str, Part]) -> None:
    cell = Cell(bench, parts["rib"])
    right = cell.ask_here(parts["rib"], parts["other"])
    assert right.status.code == Status.OK, right.status.message
    assert (right.index, right.fits) == (0, [True, False])
    assert right.status.message.startswith("rib, residual ")
    found = np.array([getattr(right.pose.pose.position, axis) for axis in "xyz"])
    assert np.abs(found - cell.T_arm_base_workpiece[:3, 3]).max() < 0.005
    assert right.pose.header.frame_id == "arm_base" and min(right.seen_ratios) > 0.5
    wrong = cell.ask_here(parts["other"], parts["rib"])
    assert (wrong.index, wrong.fits) == (1, [False, True])
    alike = cell.ask_here(parts["rib"], parts["twin"])
    assert (alike.index, alike.fits) == (-1, [True, True])
    assert alike.status.code == Status.UNKNOWN_PART
    assert alike.status.message == "rib and twin can't be told apart"
    none = cell.ask_here(parts["other"])
    assert (none.index, none.fits) == (-1, [False])
    assert none.status.message.startswith("unknown part (other: ")


def test_a_frozen_camera_is_no_answer(bench: Bench, parts: dict[str, Part]) -> None:
    """It repeats what it saw before the base came here, under new stamps."""
    cell = Cell(bench, parts["rib"])
    assert cell.ask_here(parts["rib"]).status.code == Status.OK
    fault = InjectFault.Request(fault="frozen")
    assert bench.call(InjectFault, "mock_camera/inject_fault", fault).status.code == Status.OK
    # The first one shows when the camera froze, not that it did.
    cell.ask_here(parts["rib"])
    frozen = cell.ask_here(parts["rib"])
    assert frozen.status.code == Status.STALE_IMAGE, frozen.status.message
    assert "times the camera repeated the same one under a new stamp" in frozen.status.message
    thawed = InjectFault.Request(fault="")
    assert bench.call(InjectFault, "mock_camera/inject_fault", thawed).status.code == Status.OK
    assert cell.ask_here(parts["rib"]).status.code == Status.OK


def test_questions_that_can_not_be_answered_are_named(bench: Bench, parts: dict[str, Part]) -> None:
    cell = Cell(bench, parts["rib"])
    unplaced = cell.ask(parts["rib"])
    assert unplaced.status.code == Status.REQUEST_INVALID and unplaced.index == -1
    assert "without part_pose" in unplaced.status.message
    unknown = cell.ask(parts["rib"], source=7)
    assert unknown.status.code == Status.REQUEST_INVALID
    assert "source 7 was given; 0 (SCANNED) and 1 (CAMERA)" in unknown.status.message
    unreal = np.eye(4)
    unreal[0, 3] = np.nan
    nowhere = cell.ask(parts["rib"], pose=unreal)
    assert nowhere.status.code == Status.PART_INVALID and nowhere.index == -1
    aside = cell.ask(parts["rib"], pose=transform((5.0, 0.0, 0.0)) @ cell.T_arm_base_workpiece)
    assert aside.status.code == Status.PART_NOT_SEEN
    assert "can be seen from here" in aside.status.message
    stale = cell.ask_after_a_drive(parts["rib"])
    assert stale.status.code == Status.STALE_IMAGE
    assert "one from after its last motion is accepted" in stale.status.message


def test_without_depth_images_the_camera_is_missed(bench: Bench, parts: dict[str, Part]) -> None:
    bench.start(PartRecognizer, camera_timeout_s=0.3)
    located = LocatedPart(np.eye(4), np.zeros((6, 6)), 0.9, 0.1, np.zeros(0, dtype=np.int64), 1.0)
    request = IdentifyPart.Request(
        candidates=[reference(parts["rib"])], source=1, part_pose=part_pose_to_msg(located)
    )
    answer = bench.call(IdentifyPart, "identify_part", request)
    assert answer.status.code == Status.NO_IMAGE
    assert "0 images and no camera_info came within 0.3 s" in answer.status.message


def test_depth_is_made_only_while_somebody_looks(bench: Bench, parts: dict[str, Part]) -> None:
    cell = Cell(bench, parts["rib"])
    camera = next(node for node in bench._nodes if isinstance(node, MockCamera))
    bench.turn_clock(bench.now_s + 1.0)
    assert camera._depth_camera is None
    clouds = bench.collect(PointCloud2, DEPTH, IMAGE)
    bench.wait(lambda: clouds, turning=True)
    assert cell.base.get_subscription_count()
