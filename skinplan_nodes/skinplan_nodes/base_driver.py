"""Drives the base through the action ``navigate_to_pose``."""

import hashlib
import secrets
import threading
import time
from collections.abc import Callable
from typing import Any

from action_msgs.msg import GoalStatus, GoalStatusArray
from action_msgs.srv import CancelGoal
from nav2_msgs.action import NavigateToPose
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import qos_profile_action_status_default
from unique_identifier_msgs.msg import UUID

from skinplan.errors import BaseBlockedError, BaseRefusedError
from skinplan.transforms import Array
from skinplan_nodes.action_client import ThreadedActionClient
from skinplan_nodes.conversions import pose_stamped_to_msg

_POLL_S = 0.05
_SERVER_S = 5.0
_CANCEL_S = 5.0
_MARK_BYTES = 8
_ACTIVE = (GoalStatus.STATUS_ACCEPTED, GoalStatus.STATUS_EXECUTING)


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
        # The ids of this node's goals begin alike, so that its next process knows them.
        name = node.get_fully_qualified_name().encode()
        self._mark = hashlib.sha256(name).digest()[:_MARK_BYTES]
        self._sent: set[bytes] = set()
        self._orphans = node.create_client(CancelGoal, "navigate_to_pose/_action/cancel_goal")
        node.create_subscription(
            GoalStatusArray,
            "navigate_to_pose/_action/status",
            self._on_goals,
            qos_profile_action_status_default,
        )

    def drive(self, T_map_base_link: Array, is_cancelled: Callable[[], bool]) -> bool:
        """Drives to a pose.

        Args:
            T_map_base_link: Goal on the floor, shape (4, 4) [m].
            is_cancelled: Asked while driving; the base is stopped then.

        Returns:
            True when it arrived, False when it was cancelled.

        Raises:
            BaseRefusedError: The navigator does not take the goal.
            BaseBlockedError: The base did not arrive.
        """
        if not self._client.wait_for_server(_SERVER_S):
            raise BaseRefusedError("a drive was asked for, but no navigator answers")
        goal = NavigateToPose.Goal()
        stamp_s = self._node.get_clock().now().nanoseconds * 1e-9
        goal.pose = pose_stamped_to_msg(T_map_base_link, "map", stamp_s)
        place = f"({T_map_base_link[0, 3]:.2f}, {T_map_base_link[1, 3]:.2f}) m"
        sent = self._client.send_goal_async(goal, goal_uuid=self._new_id())
        if not _wait(sent, _SERVER_S) or not sent.result().accepted:
            raise BaseRefusedError(
                f"a drive to {place} was asked for, the navigator refused it; a pose that is free "
                f"and in reach is accepted"
            )
        return self._follow(sent.result(), place, is_cancelled)

    def _new_id(self) -> UUID:
        number = self._mark + secrets.token_bytes(16 - _MARK_BYTES)
        self._sent.add(number)
        return UUID(uuid=list(number))

    def _on_goals(self, msg: GoalStatusArray) -> None:
        """Stops drives that this node began before it was started anew: nobody follows them."""
        for item in msg.status_list:
            number = bytes(item.goal_info.goal_id.uuid)
            orphan = number.startswith(self._mark) and number not in self._sent
            if orphan and item.status in _ACTIVE and self._orphans.service_is_ready():
                self._sent.add(number)
                self._node.get_logger().warning("stopping a drive of an earlier process")
                request = CancelGoal.Request()
                request.goal_info.goal_id = item.goal_info.goal_id
                self._orphans.call_async(request)

    def _follow(self, handle: Any, place: str, is_cancelled: Callable[[], bool]) -> bool:
        result = handle.get_result_async()
        deadline = time.monotonic() + self._timeout_s
        while not _wait(result, _POLL_S):
            late = time.monotonic() > deadline
            stop = True
            try:
                stop = late or is_cancelled()
            finally:
                if stop:
                    _stop(handle, result)
            if stop:
                if not late:
                    return False
                raise BaseBlockedError(
                    f"a drive to {place} was asked for, the base has not arrived after "
                    f"{self._timeout_s:g} s"
                )
        answer = result.result()
        if answer.status == GoalStatus.STATUS_SUCCEEDED:
            return True
        raise BaseBlockedError(
            f"a drive to {place} was asked for, the navigator gave up: "
            f"{answer.result.error_msg or 'without a reason'} (code {answer.result.error_code})"
        )


def _stop(handle: Any, result: Any) -> None:
    """Cancels a drive and waits for its end; a new process of the base knows nothing of it."""
    asked = handle.cancel_goal_async()
    if not _wait(asked, _CANCEL_S) or asked.result().goals_canceling:
        _wait(result, _CANCEL_S)


def _wait(future: Any, timeout_s: float) -> bool:
    """Waits for a future that another thread of the executor completes."""
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    return future.done() or done.wait(timeout_s)
