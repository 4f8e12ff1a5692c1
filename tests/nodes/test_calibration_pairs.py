"""`skinplan calibrate BAG`: pairs of a recorded arm that carries a marker."""

import json
from pathlib import Path

import numpy as np
from rclpy.serialization import serialize_message
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from localization_scene import CAMERA, CELL, project
from skinplan.cli import app
from skinplan.localization.judge import exact_detection, observations
from skinplan.localization.model import Sighting
from skinplan.localization.square import square_corners
from skinplan.part.fields import Fields
from skinplan.part.model import Fixture, Marker
from skinplan.recording.bag import BagWriter
from skinplan.recording.schema import schema_with_dependencies
from skinplan.robot.arm import ArmModel
from skinplan.robot.cell import CellConfig
from skinplan.transforms import apply, difference, inverse, transform
from skinplan_nodes.conversions import joint_state_to_msg, observations_to_msg
from skinplan_nodes.message_types import definition_text

MARKER = Fixture("DICT_5X5_100", np.eye(4), (Marker(3, 0.08, np.eye(4)),))
T_TOOL0_MARKER = transform((0.0, 0.0, 0.02))
# The camera faces the marker from 0.8 m where the arm is at home.
_HOME = ArmModel.load(CellConfig()).forward(np.array(CELL.home_rad)[None])[0]
_FACING = transform((0.0, 0.0, 0.8), Rotation.from_euler("x", np.pi).as_matrix())
T_CAMERA_ARM_BASE = _FACING @ inverse(_HOME @ T_TOOL0_MARKER)
STANDS = 12


def seen_at(T_camera_marker: np.ndarray) -> Sighting:
    corners = project(apply(T_camera_marker, square_corners(0.08)), CAMERA)
    found = exact_detection(np.array([3]), corners[None], 0.02)
    return Sighting(observations(found, CAMERA, MARKER, CELL.quality))


def record(folder: Path) -> None:
    arm, random = ArmModel.load(CellConfig()), np.random.default_rng(2)
    kinds = {
        "/joint_states": "sensor_msgs/msg/JointState",
        "/markers/observations": "skinplan_msgs/msg/MarkerObservations",
    }
    with BagWriter(folder) as bag:
        for topic, kind in kinds.items():
            bag.add_topic(topic, kind, schema_with_dependencies(kind, definition_text))
        stands, now_s = 0, 10.0
        while stands < STANDS:
            joints = np.array(CELL.home_rad) + random.uniform(-0.5, 0.5, 6)
            flange = arm.forward(joints[None])[0]
            T_camera_marker = T_CAMERA_ARM_BASE @ flange @ T_TOOL0_MARKER
            place = T_camera_marker[:3, 3]
            facing = -float(T_camera_marker[:3, 2] @ place) / float(np.linalg.norm(place))
            if place[2] < 0.3 or facing < 0.4:
                continue
            seen = seen_at(T_camera_marker)
            if not seen.markers:
                continue
            stands += 1
            for step in range(11):
                stamp_s = now_s + 0.1 * step
                state = joint_state_to_msg(joints, None, stamp_s)
                bag.write("/joint_states", serialize_message(state), int(stamp_s * 1e9))
            msg = observations_to_msg(seen, CELL.quality, "optical", now_s + 0.5)
            bag.write("/markers/observations", serialize_message(msg), int((now_s + 0.55) * 1e9))
            now_s += 3.0


def test_a_bag_of_stands_gives_the_camera(tmp_path: Path) -> None:
    record(tmp_path / "bag")
    result = CliRunner().invoke(
        app, ["calibrate", str(tmp_path / "bag"), "--marker", "3", "--json"]
    )
    document = json.loads(result.stdout[: result.stdout.rindex("}") + 1])
    assert len(document["pairs"]) == STANDS
    found = Fields(document, "", "answer", document.keys()).pose("T_arm_base_camera")
    assert difference(found, inverse(T_CAMERA_ARM_BASE))[0] < 0.005


def test_a_bag_without_the_marker_says_so(tmp_path: Path) -> None:
    record(tmp_path / "bag")
    result = CliRunner().invoke(app, ["calibrate", str(tmp_path / "bag"), "--marker", "9"])
    assert result.exit_code == 2
    assert "0 observations" in result.stderr
