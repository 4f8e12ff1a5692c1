"""An action client that may be used from any thread."""

import threading
from typing import Any

from rclpy.action import ActionClient
from rclpy.task import Future


class ThreadedActionClient(ActionClient):
    """Closes a gap of rclpy: an answer that comes before its request is noted would be dropped.

    rclpy sends a request and notes its number afterwards; where another thread spins, the answer
    can be there in between ("Ignoring unexpected goal response"), and the future never ends.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self._noting = threading.RLock()
        super().__init__(*args, **kwargs)

    def send_goal_async(self, *args: Any, **kwargs: Any) -> Future:
        """Sends a goal; as rclpy's."""
        with self._noting:
            return super().send_goal_async(*args, **kwargs)

    def _cancel_goal_async(self, goal_handle: Any) -> Future:
        with self._noting:
            return super()._cancel_goal_async(goal_handle)

    def _get_result_async(self, goal_handle: Any) -> Future:
        with self._noting:
            return super()._get_result_async(goal_handle)

    async def execute(self, taken_data: Any) -> None:
        """Handles answers, once all requests sent before are noted."""
        with self._noting:
            pass
        await super().execute(taken_data)
