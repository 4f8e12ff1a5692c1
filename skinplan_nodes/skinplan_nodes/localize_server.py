"""What both localisers, by markers and by shape, have of the action ``LocalizePart``."""

import math
import threading
from collections.abc import Callable
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from skinplan_msgs.action import LocalizePart
from skinplan_msgs.msg import Status

from skinplan_nodes.offload import in_thread
from skinplan_nodes.replies import RefusedError, log_error, ok, status_of

_END_TIMEOUT_S = 8.0


class LocalizeServer:
    """Serves the action under a name, one goal at a time, each in a thread of its own.

    Args:
        node: The node that serves.
        name: Name of the action.
        locate: Works on a goal and fills in the result but for its status; what it raises becomes
            the status.
    """

    def __init__(
        self,
        node: Any,
        name: str,
        locate: Callable[[ServerGoalHandle, LocalizePart.Result], None],
    ) -> None:
        self._node, self._name, self._locate = node, name, locate
        self._busy = threading.Lock()
        self._server = ActionServer(
            node,
            LocalizePart,
            name,
            execute_callback=self._on_execute,
            goal_callback=self._on_goal,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=ReentrantCallbackGroup(),
        )

    def wait_idle(self) -> None:
        """Waits, bounded, for the goal that is being worked on."""
        if self._busy.acquire(timeout=_END_TIMEOUT_S):
            self._busy.release()

    def _on_goal(self, _: LocalizePart.Goal) -> GoalResponse:
        # What is wrong with a goal is said in its result; a second one has to wait for the first.
        if self._busy.acquire(blocking=False):
            return GoalResponse.ACCEPT
        self._node.get_logger().warning(f"{self._name}: refused, another goal is being worked on")
        return GoalResponse.REJECT

    async def _on_execute(self, handle: ServerGoalHandle) -> LocalizePart.Result:
        # Images, tf, the navigator's answers and a cancel go on meanwhile.
        result: LocalizePart.Result = await in_thread(self._node, lambda: self._execute(handle))
        return result

    def _execute(self, handle: ServerGoalHandle) -> LocalizePart.Result:
        result = LocalizePart.Result()
        try:
            self._locate(handle, result)
            result.status = ok()
            handle.succeed()
        # rclpy would answer with a result of zeros: nothing may pass.
        except Exception as error:
            log_error(self._node.get_logger(), self._name, error)
            result.status = status_of(error, Status.PART_INVALID)
            was_cancelled = result.status.code == Status.LOCALIZATION_CANCELLED
            self._node.set_health("ok" if was_cancelled else "warning", result.status.message)
            if was_cancelled and handle.is_cancel_requested:
                handle.canceled()
            else:
                handle.abort()
        finally:
            self._busy.release()
        return result


def asked_quality(goal: LocalizePart.Goal) -> float:
    """Returns the quality that a goal asks for [1]; 0 = it leaves that to the node.

    Raises:
        RefusedError: It is none.
    """
    threshold = float(goal.quality_threshold)
    if not (math.isfinite(threshold) and 0.0 <= threshold <= 1.0):
        raise RefusedError(
            Status.REQUEST_INVALID,
            f"quality_threshold {threshold:g} was asked for; 0 to 1 is accepted",
        )
    return threshold
