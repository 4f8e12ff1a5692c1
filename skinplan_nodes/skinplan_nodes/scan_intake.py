"""Scan frames on their way into a session: checked, placed by the tracker alone, counted.

Needs no ROS but the conversions' types.
"""

import math
from collections import Counter, deque

import numpy as np

from skinplan.errors import InputError, SkinplanError
from skinplan.inspection.frame_check import FrameCheck
from skinplan.inspection.spool_records import FrameRecord
from skinplan.transforms import Array
from skinplan_nodes.conversions import ScanFrame
from skinplan_nodes.scan_session import ScanSession
from skinplan_nodes.scan_tracks import Tracks

# Scan frames that wait for the scanner's pose at their time; under load they may be many.
_PENDING = 5000
# Frames may overtake each other by so much; older ones are left out [s].
_DISORDER_S = 2.0
# The node's own clock may lag behind the frames by so much; frames beyond it are nobody's [s].
_AHEAD_S = 10.0
_STAMPS = 1000

DUPLICATE = "frames_duplicate"
STALE = "frames_stale"
AHEAD = "frames_ahead_of_time"
INVALID = "frames_invalid"
OVERFLOW = "frames_overflow"
NOT_FINITE = "points_not_finite"
POSES_REFUSED = "poses_refused"


class ScanIntake:
    """Hands frames on to a session; needs no lock of its own.

    Args:
        session: Takes the frames.
        tracks: Where the scanner was.
        check: Which points can be used.
        began_s: Frames from before belong to an earlier scan [s].
    """

    def __init__(
        self, session: ScanSession, tracks: Tracks, check: FrameCheck, began_s: float
    ) -> None:
        self.session = session
        self.counts: Counter[str] = Counter()
        self._tracks = tracks
        self._check = check
        self._began_s = began_s
        self._newest_s = -math.inf
        self._pending: deque[ScanFrame] = deque()
        self._unplaced: deque[float] = deque(maxlen=_PENDING)
        self._stamps: deque[float] = deque(maxlen=_STAMPS)
        self._stamp_set: set[float] = set()

    @property
    def waiting(self) -> int:
        """Number of frames whose scanner pose is not known yet."""
        return len(self._pending)

    @property
    def unplaced(self) -> int:
        """Number of frames that the part's place has not been estimated at yet."""
        return len(self._unplaced)

    @property
    def needs_joints(self) -> bool:
        """Whether nobody knows where the part stands, and joint states under way may tell."""
        if not self._unplaced or self.session.is_placed:
            return False
        stamp_s = self._unplaced[0]
        return not self._tracks.joints_passed(stamp_s) and self._tracks.joints(stamp_s) is None

    def offer(self, frame: ScanFrame, now_s: float) -> str:
        """Takes a frame in, to be placed as soon as its scanner pose is known.

        Returns:
            Why it is left out, one sentence; empty = it is not.
        """
        name, sentence = self._judged(frame.stamp_s, now_s)
        if name:
            self.counts[name] += 1
            return sentence
        if len(self._pending) >= _PENDING:
            self._pending.popleft()
            self.counts[OVERFLOW] += 1
        self._remember(frame.stamp_s)
        self._newest_s = max(self._newest_s, frame.stamp_s)
        self._pending.append(frame)
        return ""

    def advance(self) -> str:
        """Hands on the frames whose scanner pose is known; a pose may come after its frame.

        Returns:
            Why one was left out, one sentence; empty = none was.
        """
        said = ""
        for _ in range(len(self._pending)):
            frame = self._pending.popleft()
            T_tracker_scanner = self._tracks.scanner(frame.stamp_s)
            if T_tracker_scanner is not None:
                said = self._place(frame, T_tracker_scanner) or said
            elif self._tracks.passed(frame.stamp_s):
                self.session.add_hidden()
            else:
                self._pending.append(frame)
        return said

    def estimate(self, base_moved_s: float) -> None:
        """Estimates where the part stands, at frames whose joint positions are known.

        Args:
            base_moved_s: When the base moved last [s]; it has to stand where it located the part.
        """
        located = self._tracks.located
        if located is None or base_moved_s > located.stamp_s:
            return
        for _ in range(len(self._unplaced)):
            stamp_s = self._unplaced.popleft()
            T_tracker_workpiece = self._tracks.coarse(stamp_s)
            if T_tracker_workpiece is None:
                self._unplaced.append(stamp_s)
            elif stamp_s >= located.stamp_s:
                self.session.add_coarse(located.stamp_s, T_tracker_workpiece)

    def _judged(self, stamp_s: float, now_s: float) -> tuple[str, str]:
        if stamp_s in self._stamp_set:
            return DUPLICATE, f"a scan frame of {stamp_s:.3f} s came twice; it is left out"
        oldest_s = max(self._began_s, self._newest_s - _DISORDER_S)
        if stamp_s < oldest_s:
            return STALE, (
                f"a scan frame of {stamp_s:.3f} s came, frames from {oldest_s:.3f} s on are "
                f"accepted; it is left out"
            )
        if stamp_s > now_s + _AHEAD_S:
            return AHEAD, (f"a scan frame of {stamp_s:.3f} s came at {now_s:.3f} s; it is left out")
        return "", ""

    def _remember(self, stamp_s: float) -> None:
        if len(self._stamps) == _STAMPS:
            self._stamp_set.discard(self._stamps[0])
        self._stamps.append(stamp_s)
        self._stamp_set.add(stamp_s)

    def _place(self, frame: ScanFrame, T_tracker_scanner: Array) -> str:
        try:
            record = self._record(frame, T_tracker_scanner)
            self.session.add_frame(record)
        except SkinplanError as error:
            self.counts[INVALID] += 1
            return str(error)
        self._unplaced.append(frame.stamp_s)
        return ""

    def _record(self, frame: ScanFrame, T_tracker_scanner: Array) -> FrameRecord:
        none = np.full(len(frame.points), np.nan)
        intensity = frame.values.get("intensity", none)
        incidence = frame.values.get("incidence", none)
        usable = self._check.usable(frame.points, T_tracker_scanner, incidence)
        return FrameRecord(
            frame.stamp_s,
            T_tracker_scanner[:3, 0],
            not bool(usable.all()),
            frame.points[usable],
            intensity[usable],
            incidence[usable],
        )


def require_not_ahead(stamp_s: float, now_s: float, what: str) -> None:
    """Checks that a stamp is not of a time to come.

    Raises:
        InputError: It is, by more than this node's clock can lag behind.
    """
    if stamp_s > now_s + _AHEAD_S:
        raise InputError(f"{what} of {stamp_s:.3f} s came at {now_s:.3f} s; it is left out")
