"""What becomes of a job after a failure, by its status code. Needs no ROS."""

from dataclasses import dataclass
from enum import Enum

from skinplan_nodes.supervisor.control import StepError

# Numbers of ``skinplan_msgs/Status``; a test holds them against the message.
NO_IMAGE, STALE_IMAGE, NO_MARKER, AMBIGUOUS_POSE = 200, 201, 202, 204
QUALITY_NOT_REACHED, BASE_REFUSED, BASE_BLOCKED, SAFE_DISTANCE_REACHED = 205, 206, 207, 208
PART_MOVED, LOCALIZATION_CANCELLED, IMAGE_INVALID, NO_TRANSFORM = 209, 210, 211, 212
PLANNING_CANCELLED = 502
DEVICE_NOT_READY, DEVICE_REFUSED, DEVICE_FAILED, NODE_LOST = 600, 601, 602, 603
DEVICE_TIMEOUT, DEVICE_STOPPED, PROTECTIVE_STOP, EMERGENCY_STOP = 604, 605, 606, 607
BASE_LOST, TRACKER_LOST, CLOCK_JUMPED, STEP_TIMEOUT = 608, 609, 610, 611
BAG_NOT_WRITABLE, RECORDER_BUSY, DISK_FULL = 702, 703, 705
NOT_INSPECTING, PART_NOT_SEEN = 903, 905


class Answer(Enum):
    """What is done about a failure."""

    AUTOMATIC = "goes on by itself"
    OPERATOR = "goes on when the operator says RESUME"
    FATAL = "ends the job"


#: Nobody was in danger, and trying again may help.
AUTOMATIC = frozenset(
    {
        NO_IMAGE,
        STALE_IMAGE,
        NO_MARKER,
        AMBIGUOUS_POSE,
        QUALITY_NOT_REACHED,
        LOCALIZATION_CANCELLED,
        IMAGE_INVALID,
        NO_TRANSFORM,
        PLANNING_CANCELLED,
        DEVICE_NOT_READY,
        NODE_LOST,
        DEVICE_TIMEOUT,
        TRACKER_LOST,
        CLOCK_JUMPED,
        STEP_TIMEOUT,
        NOT_INSPECTING,
    }
)
#: Somebody has to look before anything moves again.
OPERATOR = frozenset(
    {
        BASE_REFUSED,
        BASE_BLOCKED,
        SAFE_DISTANCE_REACHED,
        PART_MOVED,
        DEVICE_REFUSED,
        DEVICE_FAILED,
        DEVICE_STOPPED,
        PROTECTIVE_STOP,
        EMERGENCY_STOP,
        BASE_LOST,
        BAG_NOT_WRITABLE,
        RECORDER_BUSY,
        DISK_FULL,
        PART_NOT_SEEN,
    }
)
#: A job that meets these at its start has nothing to lose, and ends with them.
ENDS_A_START = frozenset({DEVICE_NOT_READY, BAG_NOT_WRITABLE, RECORDER_BUSY})
#: After these the base may stand elsewhere than where it located the part.
BASE_MAY_HAVE_MOVED = frozenset(
    {BASE_REFUSED, BASE_BLOCKED, BASE_LOST, SAFE_DISTANCE_REACHED, PART_MOVED, CLOCK_JUMPED}
)


def answer_to(code: int) -> Answer:
    """Returns what is done about a failure of this status code."""
    if code in AUTOMATIC:
        return Answer.AUTOMATIC
    return Answer.OPERATOR if code in OPERATOR else Answer.FATAL


# How long a job waits before it goes on by itself for the first, the second ... time [s].
_PATIENCE_S = (0.0, 2.0, 5.0, 10.0)


@dataclass
class Interruption:
    """One time that a job stood still without being over.

    Attributes:
        time_s: When, on the cell's clock [s].
        state: State in which it happened.
        code: Status code; 0 = a command.
        reason: One sentence.
        node: Node that caused it; may be empty.
        resumed_after_s: How long it stood, wall time [s]; None = it did not go on.
    """

    time_s: float
    state: str
    code: int
    reason: str
    node: str = ""
    resumed_after_s: float | None = None


class Attempts:
    """Counts how often a job went on by itself after the same failure at the same node."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._made: dict[tuple[int, str], int] = {}

    def another(self, error: StepError) -> float | None:
        """Counts one more; returns how long to wait before it [s], None = there were enough.

        The first comes at once; a camera or a driver that starts anew takes some seconds.
        """
        key = error.code, error.node
        made = self._made.get(key, 0)
        self._made[key] = made + 1
        return _PATIENCE_S[min(made, len(_PATIENCE_S) - 1)] if made < self._most else None

    def forget(self) -> None:
        """Counts from the begin again: somebody has looked at what failed."""
        self._made.clear()
