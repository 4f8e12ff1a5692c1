"""The stand-ins have the type hashes of the originals, on disk and on the wire."""

import json
from pathlib import Path

import pytest
import rclpy
from ament_index_python import get_package_share_directory
from control_msgs.action import FollowJointTrajectory
from nav2_msgs.action import NavigateToPose
from rclpy.action import ActionServer
from tf2_msgs.msg import TFMessage

RECORDED = json.loads(Path(__file__).with_name("type_hashes.json").read_text())["hashes"]


def built_hashes() -> dict[str, str]:
    """Hashes of all types that the three packages define, by type name."""
    hashes = {}
    for package in sorted({name.partition("/")[0] for name in RECORDED}):
        for file in Path(get_package_share_directory(package)).glob("*/*.json"):
            for entry in json.loads(file.read_text())["type_hashes"]:
                hashes[entry["type_name"]] = entry["hash_string"]
    return hashes


@pytest.mark.parametrize("type_name", sorted(RECORDED))
def test_built_type_has_the_recorded_hash(type_name):
    assert built_hashes().get(type_name) == RECORDED[type_name]


STAND_INS = Path(__file__).resolve().parents[2] / "ros2_ws" / "stand_ins"


def test_every_type_of_the_stand_ins_is_among_them():
    """Nothing that the graph uses of these packages is left unchecked."""
    for package in ("control_msgs", "nav2_msgs", "tf2_msgs"):
        for file in STAND_INS.glob(f"{package}/*/*"):
            if file.suffix in (".msg", ".srv", ".action"):
                assert f"{package}/{file.parent.name}/{file.stem}" in RECORDED


@pytest.fixture
def node():
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("hashes", context=context)
    yield node
    node.destroy_node()
    rclpy.shutdown(context=context)


def published_hash(node, topic: str) -> str:
    (info,) = node.get_publishers_info_by_topic(topic)
    return str(info.topic_type_hash)


def test_message_is_announced_with_the_recorded_hash(node):
    node.create_publisher(TFMessage, "transforms", 1)
    assert published_hash(node, "transforms") == RECORDED["tf2_msgs/msg/TFMessage"]


@pytest.mark.parametrize("action", [FollowJointTrajectory, NavigateToPose])
def test_action_is_announced_with_the_recorded_hash(node, action):
    server = ActionServer(node, action, "do", lambda goal: action.Result())
    package = action.__module__.partition(".")[0]
    expected = RECORDED[f"{package}/action/{action.__name__}_FeedbackMessage"]
    assert published_hash(node, "do/_action/feedback") == expected
    server.destroy()
