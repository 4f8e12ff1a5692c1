"""When a process that died is started again, and when it died too often. Needs no ROS."""

from collections import deque
from dataclasses import dataclass

# Exit code of a node whose parameters can't be used: another start would end the same way.
BAD_PARAMETERS = 2


@dataclass(frozen=True)
class RestartPolicy:
    """How often processes are started again.

    Attributes:
        most: So many restarts of a process within the window; 0 = none.
        window_s: Length of the window, wall time [s].
        first_wait_s: Wait before the first restart [s]; each further one within the window waits
            twice as long.
        longest_wait_s: Longest wait [s].
    """

    most: int = 0
    window_s: float = 120.0
    first_wait_s: float = 0.2
    longest_wait_s: float = 5.0


NO_RESTARTS = RestartPolicy()


class RestartCounter:
    """The restarts of one process.

    Args:
        policy: How often it may be restarted.
    """

    def __init__(self, policy: RestartPolicy) -> None:
        self._policy = policy
        self._deaths: deque[float] = deque()
        self.total = 0

    @property
    def recent(self) -> int:
        """Deaths within the window before the last one, and that one."""
        return len(self._deaths)

    def wait_after(self, code: int, now_s: float) -> float | None:
        """Counts a death.

        Args:
            code: Return code; negative = signal.
            now_s: Wall time [s].

        Returns:
            How long to wait before the restart [s]; None = it is not restarted.
        """
        policy = self._policy
        while self._deaths and now_s - self._deaths[0] > policy.window_s:
            self._deaths.popleft()
        self._deaths.append(now_s)
        if code == BAD_PARAMETERS or len(self._deaths) > policy.most:
            return None
        self.total += 1
        return float(
            min(policy.longest_wait_s, policy.first_wait_s * 2.0 ** (len(self._deaths) - 1))
        )
