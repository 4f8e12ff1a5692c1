"""Drives the base through the action ``navigate_to_pose``."""

import threading
import time
from collections.abc import Callable
from typing import Any

from action_msgs.msg import GoalStatus
from nav2_msgs.action import NavigateToPose
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from skinplan_msgs.msg import Status

from skinplan.transforms import Array
from skinplan_nodes.action_client import ThreadedActionClient
from skinplan_nodes.conversions import pose_stamped_to_msg
from skinplan_nodes.replies import RefusedError

_POLL_S = 0.05
_SERVER_S = 5.0
_CANCEL_S = 5.0


class BaseDriver:
    """A client of the navigator; its waits are bounded and do not need the calling thread.

    Args:
        node: The node that owns the client.
        wall_timeout_s: Longest drive on wall time [s].
    """

    def __init__(self, node: Node, wall_timeout_s: float) -> None:
        self._node = node
        self._timeout_s = wall_timeout_s
        self._client = ThreadedActionClient(
            node, NavigateToPose, "navigate_to_pose", callback_group=ReentrantCallbackGroup()
        )

    def drive(self, T_map_base_link: Array, is_cancelled: Callable[[], bool]) -> bool:
        """Drives to a pose.

        Args:
            T_map_base_link: Goal on the floor, shape (4, 4) [m].
            is_cancelled: Asked while driving; the base is stopped then.

        Returns:
            True when it arrived, False when it was cancelled.

        Raises:
            RefusedError: BASE_REFUSED or BASE_BLOCKED.
        """
        if not self._client.wait_for_server(_SERVER_S):
            raise RefusedError(
                Status.BASE_REFUSED, "a drive was asked for, but no navigator answers"
            )
        goal = NavigateToPose.Goal()
        stamp_s = self._node.get_clock().now().nanoseconds * 1e-9
        goal.pose = pose_stamped_to_msg(T_map_base_link, "map", stamp_s)
        place = f"({T_map_base_link[0, 3]:.2f}, {T_map_base_link[1, 3]:.2f}) m"
        sent = self._client.send_goal_async(goal)
        if not _wait(sent, _SERVER_S) or not sent.result().accepted:
            raise RefusedError(
                Status.BASE_REFUSED,
                f"a drive to {place} was asked for, the navigator refused it; a pose that is free "
                f"and in reach is accepted",
            )
        return self._follow(sent.result(), place, is_cancelled)

    def _follow(self, handle: Any, place: str, is_cancelled: Callable[[], bool]) -> bool:
        result = handle.get_result_async()
        deadline = time.monotonic() + self._timeout_s
        while not _wait(result, _POLL_S):
            late = time.monotonic() > deadline
            if late or is_cancelled():
                _wait(handle.cancel_goal_async(), _CANCEL_S)
                _wait(result, _CANCEL_S)
                if not late:
                    return False
                raise RefusedError(
                    Status.BASE_BLOCKED,
                    f"a drive to {place} was asked for, the base has not arrived after "
                    f"{self._timeout_s:g} s",
                )
        answer = result.result()
        if answer.status == GoalStatus.STATUS_SUCCEEDED:
            return True
        raise RefusedError(
            Status.BASE_BLOCKED,
            f"a drive to {place} was asked for, the navigator gave up: "
            f"{answer.result.error_msg or 'without a reason'} (code {answer.result.error_code})",
        )


def _wait(future: Any, timeout_s: float) -> bool:
    """Waits for a future that another thread of the executor completes."""
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    return future.done() or done.wait(timeout_s)
