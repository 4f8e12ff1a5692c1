"""When the job on the cell will be over, by the time that passes. Needs no ROS."""

import math
from collections import deque
from dataclasses import replace

from skinplan.jobs.model import JobRecord, JobState

# The cell's clock is compared with wall time over so many looks.
_LOOKS = 20
_SLOWEST = 0.01


class TimeLeft:
    """Takes the time that has passed since the last step off what was left then.

    A mock cell has a clock of its own: how fast it runs is measured.
    """

    def __init__(self) -> None:
        self._looks: deque[tuple[float, float]] = deque(maxlen=_LOOKS)
        self._job_id = ""
        self._left_s = math.nan
        self._at_s = math.nan

    def look(self, cell_s: float, wall_s: float) -> None:
        """Looks at both clocks [s]; to be called about once a second."""
        if self._looks and cell_s < self._looks[-1][0]:
            self._looks.clear()
        self._looks.append((cell_s, wall_s))

    def begin(self, record: JobRecord, cell_s: float) -> None:
        """Takes what is left at the begin of a step, at this cell time [s]."""
        self._job_id, self._left_s, self._at_s = record.job.job_id, record.time_left_s, cell_s

    def now(self, record: JobRecord, cell_s: float, wall_s: float) -> JobRecord:
        """Returns a record with what is left by now.

        Args:
            record: The job; only one that runs has an expected end.
            cell_s: Cell time [s].
            wall_s: Wall time, since the epoch [s].
        """
        running = record.state is JobState.RUNNING and record.job.job_id == self._job_id
        if not running or not math.isfinite(self._left_s):
            return record
        left_s = max(0.0, self._left_s - max(0.0, cell_s - self._at_s))
        end_ns = round((wall_s + left_s / self.rate()) * 1e9)
        return replace(record, time_left_s=left_s, expected_end_ns=end_ns)

    def rate(self) -> float:
        """Returns how fast the cell's clock runs against wall time [1]; 1 where not known."""
        if len(self._looks) < 2:
            return 1.0
        (cell_0, wall_0), (cell_1, wall_1) = self._looks[0], self._looks[-1]
        return max(_SLOWEST, (cell_1 - cell_0) / (wall_1 - wall_0)) if wall_1 > wall_0 else 1.0
