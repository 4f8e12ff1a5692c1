"""The bag of a run in parts: a recorder that was lost and came back begins a new one.

Needs no ROS.
"""

import logging
import time
from collections.abc import Mapping
from typing import Any

from skinplan.errors import SkinplanError
from skinplan_nodes.supervisor.cell import Cell
from skinplan_nodes.supervisor.control import InterruptError, StepError
from skinplan_nodes.supervisor.record import RunRecord

# A recorder that can't write is asked again at most so often, wall time [s].
_AGAIN_S = 20.0
_log = logging.getLogger(__name__)


class BagParts:
    """Opens and closes the parts of a bag; what is on disk is never touched again.

    Args:
        cell: The cell.
        record: Told about every part.
        metadata: Goes into every part.
        needed: Whether the job waits for a recorder that is lost.
    """

    def __init__(
        self, cell: Cell, record: RunRecord, metadata: Mapping[str, str], needed: bool
    ) -> None:
        self._cell = cell
        self._record = record
        self._metadata = dict(metadata)
        self._needed = needed
        self._pid = 0
        self._open = False
        self._refused_s = float("-inf")
        self.part = 0
        self._closed: list[dict[str, Any]] = []

    def restore(self, part: int, recorder_pid: int, opened: bool) -> None:
        """Takes over what the journal says about the newest part."""
        self.part, self._pid, self._open = part, recorder_pid, opened

    def open(self) -> None:
        """Opens the next part, unless the one that is open is still being written.

        Raises:
            StepError: The recorder did not open it, and the job waits for it.
        """
        if self._open and not self._cell.recorder_failure() and self._is_written():
            return
        self._end_part()
        pid, part = self._cell.recorder_pid(), self.part + 1
        try:
            # It may have been asked for before, and the answer was not heard.
            while self._record.folder.bag(part).exists() and not self._is_recorded(part):
                part += 1
            self._cell.start_recording(self._record.folder.bag(part), self._metadata)
        except InterruptError:
            raise
        except StepError as error:
            self._refused_s = time.monotonic()
            if self.part and not self._needed:
                _log.warning("the recorder does not record: %s", error)
                self._record.folder.note(f"goes on without recorder: {error}")
                return
            raise
        self.part, self._pid, self._open = part, pid, True
        self._write_down()

    def _is_written(self) -> bool:
        """Whether the recorder writes the open part.

        One that came back may have begun it before it was heard that it is another process.
        """
        pid = self._cell.recorder_pid()
        if pid and pid != self._pid and self._is_recorded(self.part):
            self._pid = pid
            self._write_down()
        return pid == self._pid

    def _is_recorded(self, part: int) -> bool:
        return self._cell.is_recorded(self._record.folder.bag(part), self._metadata)

    def tend(self) -> None:
        """Begins another part when the recorder is another process, or can't write this one."""
        pid = self._cell.recorder_pid()
        waited = time.monotonic() - self._refused_s > _AGAIN_S
        lost = not self._open or pid != self._pid or self._cell.recorder_failure()
        if self.part and pid and lost and waited:
            self.open()

    def close(self) -> dict[str, Any]:
        """Closes the open part; returns the figures of the bag. What fails is noted, not raised."""
        self._end_part()
        return self._figures()

    def _end_part(self) -> None:
        """Closes the open part, or notes that nobody can close it any more."""
        if not self._open:
            return
        self._open = False
        folder = self._record.folder
        lost: dict[str, Any] = {"path": str(folder.bag(self.part)), "closed": False}
        try:
            if self._is_written():
                lost = self._cell.stop_recording()
        except Exception as error:  # whatever it is, the summary has to say so
            expected = isinstance(error, SkinplanError | OSError)
            folder.note(f"closing the bag: {error}")
            _log.error("closing the bag: %s", error, exc_info=None if expected else error)
            lost["error"] = str(error) or type(error).__name__
        self._closed.append(lost)
        self._write_down()

    def _write_down(self) -> None:
        try:
            self._record.bag(self.part, self._pid, self._open)
        except OSError as error:
            # What can't be written down can't be resumed, but it can be brought to its end.
            _log.error("the journal can't be written: %s", error)

    def _figures(self) -> dict[str, Any]:
        """The newest closed part's figures, and all parts where there are several."""
        if not self._closed:
            return {}
        whole = [part for part in self._closed if part.get("closed", True)]
        found = dict(whole[-1] if whole else self._closed[-1])
        return found if len(self._closed) == 1 else {**found, "parts": self._closed}
