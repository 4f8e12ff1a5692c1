"""An action client that may be used from any thread."""

import threading
from typing import Any

from action_msgs.srv import CancelGoal
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

    def cancel_everything_async(self) -> Future:
        """Asks the server to cancel all of its goals, whoever sent them.

        A request without goal id and time means all (``action_msgs/srv/CancelGoal``); rclpy's own
        methods only know the goals of this client.
        """
        with self._noting:
            number = self._client_handle.send_cancel_request(CancelGoal.Request())
            answer = Future()
            self._pending_cancel_requests[number] = answer
            answer.add_done_callback(self._remove_pending_cancel_request)
            self.add_future(answer)
        return answer

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
