"""A cell for the tests of the localiser: the real node before the mock base and camera."""

from typing import Any

from action_msgs.msg import GoalStatus
from nav2_msgs.action import NavigateToPose
from rclpy.action import ActionClient
from skinplan_msgs.action import LocalizePart

from nodes.bench import Bench
from skinplan.part.model import Part
from skinplan.transforms import planar
from skinplan_nodes.aruco_localizer import ArucoLocalizer
from skinplan_nodes.conversions import pose_stamped_to_msg
from skinplan_nodes.mock_camera import MockCamera
from skinplan_nodes.mock_mir100 import MockMir100


def start_cell(bench: Bench, part: Part, **parameters: Any) -> None:
    bench.start(MockMir100, part_uri=str(part.source), seed=3)
    bench.start(MockCamera, part_uri=str(part.source), seed=3)
    bench.start(ArucoLocalizer, **parameters)


def send(bench: Bench, goal: LocalizePart.Goal, feedback: list[Any] | None = None) -> Any:
    client = ActionClient(bench.tester, LocalizePart, "localize_part")
    bench.wait(client.server_is_ready)
    told = None if feedback is None else lambda msg: feedback.append(msg.feedback)
    return bench.result(client.send_goal_async(goal, feedback_callback=told), turning=True)


def localize(bench: Bench, goal: LocalizePart.Goal, feedback: list[Any] | None = None) -> Any:
    handle = send(bench, goal, feedback)
    assert handle.accepted
    return bench.result(handle.get_result_async(), turning=True)


def drive(bench: Bench, goal: Any) -> None:
    client = ActionClient(bench.tester, NavigateToPose, "navigate_to_pose")
    bench.wait(client.server_is_ready)
    request = NavigateToPose.Goal(pose=pose_stamped_to_msg(goal, "map"))
    handle = bench.result(client.send_goal_async(request), turning=True)
    result = bench.result(handle.get_result_async(), turning=True)
    assert result.status == GoalStatus.STATUS_SUCCEEDED


def work_place(part: Part) -> Any:
    """A place from which the markers are seen, but not well enough."""
    x = float(part.T_map_workpiece[0, 3])
    return planar(x - 0.3, -2.2, 0.25)
