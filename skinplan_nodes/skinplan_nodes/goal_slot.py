"""Goals that are worked on in steps of time: one at a time, a newer one replaces it."""

from dataclasses import dataclass
from enum import Enum
from typing import Any

from rclpy.action import CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from rclpy.task import Future


class GoalEnd(Enum):
    """How a goal came to its end."""

    REACHED = "reached"
    CANCELLED = "cancelled"
    REPLACED = "replaced by a newer goal"


@dataclass(frozen=True)
class GoalFailure:
    """A goal that the device gave up.

    Attributes:
        code: Code of the action's result.
        text: Why, in one sentence.
    """

    code: int
    text: str


class GoalSlot:
    """Holds the goal that a device works on; for nodes with a single-threaded executor.

    The execute callback awaits `begin`; the node's timer looks at `active` and calls `finish`.

    Args:
        node: The node that owns the device.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._handle: ServerGoalHandle | None = None
        self._ended: Future | None = None

    @property
    def active(self) -> ServerGoalHandle | None:
        """The goal that is worked on; None = none."""
        return self._handle

    def begin(self, handle: ServerGoalHandle) -> Future:
        """Takes a goal; one that is worked on ends as REPLACED.

        Returns:
            Future of the goal's `GoalEnd` or `GoalFailure`.
        """
        self.finish(GoalEnd.REPLACED)
        self._handle, self._ended = handle, Future(executor=self._node.executor)
        return self._ended

    def finish(self, end: GoalEnd | GoalFailure) -> None:
        """Ends the goal that is worked on, if there is one."""
        if self._ended is not None:
            ended, self._handle, self._ended = self._ended, None, None
            ended.set_result(end)


def conclude(handle: ServerGoalHandle, end: GoalEnd | GoalFailure) -> None:
    """Makes the one terminal call of a goal."""
    if end is GoalEnd.REACHED:
        handle.succeed()
    elif end is GoalEnd.CANCELLED and handle.is_cancel_requested:
        handle.canceled()
    else:
        handle.abort()


def accept_goal(_: Any) -> GoalResponse:
    """Accepts every goal: one that can't be carried out ends with its reason in the result."""
    return GoalResponse.ACCEPT


def accept_cancel(_: Any) -> CancelResponse:
    """Accepts every request to cancel; rclpy's own callback refuses them."""
    return CancelResponse.ACCEPT
