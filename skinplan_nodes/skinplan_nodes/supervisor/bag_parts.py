"""The bag of a run in parts: a recorder that was lost and came back begins a new one.

Needs no ROS.
"""

import logging
from collections.abc import Mapping
from typing import Any

from skinplan.errors import SkinplanError
from skinplan_nodes.supervisor.cell import Cell
from skinplan_nodes.supervisor.control import StepError
from skinplan_nodes.supervisor.record import RunRecord

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
        pid = self._cell.recorder_pid()
        if self._open and pid == self._pid:
            return
        self._lose()
        part = self.part + 1
        while self._record.folder.bag(part).exists():
            part += 1
        try:
            self._cell.start_recording(self._record.folder.bag(part), self._metadata)
        except StepError as error:
            if self.part and not self._needed:
                _log.warning("the recorder does not record: %s", error)
                self._record.folder.note(f"goes on without recorder: {error}")
                return
            raise
        self.part, self._pid, self._open = part, pid, True
        self._record.bag(part, pid, opened=True)

    def tend(self) -> None:
        """Opens another part when the recorder is another process than that of the open one."""
        pid = self._cell.recorder_pid()
        if self.part and pid and pid != self._pid:
            self.open()

    def close(self) -> dict[str, Any]:
        """Closes the open part; returns the figures of the bag. What fails is noted, not raised."""
        if self._open and self._cell.recorder_pid() == self._pid:
            try:
                self._closed.append(self._cell.stop_recording())
                self._record.bag(self.part, self._pid, opened=False)
            except (SkinplanError, OSError) as error:
                self._record.folder.note(f"closing the bag: {error}")
                _log.error("closing the bag: %s", error)
                self._lose()
        else:
            self._lose()
        self._open = False
        return self._figures()

    def _lose(self) -> None:
        if self._open:
            self._open = False
            folder = self._record.folder.bag(self.part)
            self._closed.append({"path": str(folder), "closed": False})

    def _figures(self) -> dict[str, Any]:
        """The newest closed part's figures, and all parts where there are several."""
        if not self._closed:
            return {}
        whole = [part for part in self._closed if part.get("closed", True)]
        found = dict(whole[-1] if whole else self._closed[-1])
        return found if len(self._closed) == 1 else {**found, "parts": self._closed}
