"""Whether the supervisor is there and goes on with a job, also after it was started again.

Needs no ROS.
"""

import math

# The supervisor's heartbeat comes every second.
SILENT_S = 12.0
RETURN_S = 60.0


class Absence:
    """Tells when to ask for the job, and when to give it up.

    Args:
        silent_s: Without a heartbeat for so long the supervisor is away [s].
        return_s: So long it may be away, or be back without going on with the job [s].
    """

    def __init__(self, silent_s: float = SILENT_S, return_s: float = RETURN_S) -> None:
        self._silent_s = silent_s
        self._return_s = return_s
        self._pid: int | None = None
        self._seen_s = math.inf
        self._back_s: float | None = None

    @property
    def asking(self) -> bool:
        """Whether it was started again and is not known to go on with the job."""
        return self._back_s is not None

    def expect(self, now_s: float) -> None:
        """Begins to count, at a wall time [s]: from here on it has to be there."""
        self._seen_s = now_s

    def heard(self, pid: int, now_s: float) -> None:
        """Takes a heartbeat."""
        if self._pid is not None and pid != self._pid and math.isfinite(self._seen_s):
            self._back_s = now_s
        self._pid = pid
        if math.isfinite(self._seen_s):
            self._seen_s = now_s

    def goes_on(self) -> None:
        """Takes note that the job is running, or over."""
        self._back_s = None

    def problem(self, now_s: float, state: str) -> str:
        """Returns why the job has to be given up, one sentence; empty = it has not.

        Args:
            now_s: Wall time [s].
            state: What is known of the job, for the sentence.
        """
        if now_s - self._seen_s > self._silent_s + self._return_s:
            return (
                f"the cell supervisor was lost and did not come back within {self._return_s:g} s; "
                f"nobody ends the job"
            )
        if self._back_s is not None and now_s - self._back_s > self._return_s:
            return (
                f"the cell supervisor was started again, but the job did not go on within "
                f"{self._return_s:g} s; it is {state}"
            )
        return ""
