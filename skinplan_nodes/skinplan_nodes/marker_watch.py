"""Of ``aruco_localizer``: the markers between goals, and how well they are found."""

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from skinplan.errors import SkinplanError
from skinplan.localization.loop_cell import View
from skinplan.localization.model import Sighting
from skinplan.localization.tracking import MarkerTracker
from skinplan.part.model import Fixture
from skinplan.robot.cell import CellConfig
from skinplan_nodes.camera_feed import CameraFeed

_WAIT_S = 0.2
_RECORDED = 100
# Share of the period that is waited at least; the next image takes the rest.
_PACE = 0.8


class DetectionRecord:
    """How many of the last images showed markers, and when the last good pose was found."""

    def __init__(self) -> None:
        self._found: deque[bool] = deque(maxlen=_RECORDED)
        self._quality = self._best = self._good_s = math.nan

    def note(self, sighting: Sighting) -> None:
        """Takes what one image showed."""
        self._found.append(bool(sighting.markers))
        self._quality = max((item.quality for item in sighting.markers), default=math.nan)

    def good(self, quality: float, stamp_s: float) -> None:
        """Takes a pose that was good enough."""
        self._best, self._good_s = quality, stamp_s

    def values(self, now_s: float) -> dict[str, Any]:
        """Returns the values for ``/diagnostics``; nan = not known yet."""
        share = sum(self._found) / len(self._found) if self._found else math.nan
        return {
            "detection_rate": f"{share:.2f}",
            "quality": f"{self._quality:.3f}",
            "last_good_quality": f"{self._best:.3f}",
            "last_good_pose_age_s": f"{now_s - self._good_s:.1f}",
        }


class MarkerWatcher:
    """Evaluates the newest image again and again in a thread of its own, while no goal does.

    Args:
        feed: Where the images come from.
        cell: Figures of eq (3), how corners are found.
        rate_hz: Images per second at most; 0 = none are evaluated.
        publish: Takes what was seen.
        ended: Asked whether to end.

    Attributes:
        fixture: What to look for; None = nothing yet.
        paused: Set while a goal evaluates the images.
    """

    def __init__(
        self,
        feed: CameraFeed,
        cell: CellConfig,
        rate_hz: float,
        publish: Callable[[Sighting, View], None],
        ended: Callable[[], bool],
    ) -> None:
        self._feed = feed
        self._cell = cell
        self._rate_hz = rate_hz
        self._publish = publish
        self._ended = ended
        self._thread = threading.Thread(target=self._run, name="watch", daemon=True)
        self.fixture: Fixture | None = None
        self.paused = False

    @property
    def active(self) -> bool:
        """Whether images are evaluated between goals."""
        return self._rate_hz > 0.0

    def start(self) -> None:
        """Begins, where a rate is given."""
        if self.active:
            self._thread.start()

    def join(self, timeout_s: float) -> None:
        """Waits for the end, after `ended` has become true."""
        if self._thread.is_alive():
            self._thread.join(timeout_s)

    def _run(self) -> None:
        tracker: MarkerTracker | None = None
        fixture: Fixture | None = None
        while not self._ended():
            if self.paused or self.fixture is None:
                time.sleep(_WAIT_S)
                continue
            if tracker is None or fixture is not self.fixture:
                fixture = self.fixture
                tracker = MarkerTracker(fixture, self._cell.quality, self._cell.camera.corners)
            self._feed.wanted = True
            begin = time.monotonic()
            self._look(tracker)
            time.sleep(max(0.0, _PACE / self._rate_hz - (time.monotonic() - begin)))

    def _look(self, tracker: MarkerTracker) -> None:
        try:
            view = self._feed.next(_WAIT_S)
            if view is not None and not self.paused:
                self._publish(tracker.observe(view.image, view.camera), view)
        except SkinplanError:
            # Said when a goal needs the images.
            time.sleep(_WAIT_S)
        except Exception:
            if not self._ended():
                raise
