"""The newest image of a camera, and whether the base has moved since."""

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from skinplan.errors import (
    LocalizationError,
    NoImageError,
    StaleImageError,
)
from skinplan.localization.loop import cancelled
from skinplan.localization.loop_cell import View
from skinplan_nodes.conversions import (
    camera_info_from_msg,
    compressed_image_from_msg,
    image_from_msg,
    stamp_from_msg,
)
from skinplan_nodes.frame_tree import Frames as Frames

_POLL_S = 0.05
_RATE_IMAGES = 30


@dataclass(frozen=True)
class FeedSettings:
    """When an image is good enough to be used.

    Attributes:
        settle_s: It must have been taken so long after the last motion of the base [s].
        image_timeout_s: So long is waited for it, on the cell's clock [s].
        wall_timeout_s: So long at most on wall time, for a cell whose clock stands [s].
    """

    settle_s: float = 0.5
    image_timeout_s: float = 5.0
    wall_timeout_s: float = 30.0


@dataclass(frozen=True)
class FeedCounts:
    """What became of the images so far.

    Attributes:
        received: Images that came.
        used: Images that were looked at.
        dropped: Images that were replaced by a newer one while somebody wanted images.
        rate_hz: Images per second of their own stamps, of the last ones; NaN = fewer than two.
    """

    received: int
    used: int
    dropped: int
    rate_hz: float


class CameraFeed:
    """Holds the newest image and camera model; gives out an image that is new enough.

    Nothing queues: an image that nobody took is replaced by the next one.

    Args:
        frames: Knows when the base moved.
        now_s: The cell's clock [s].
        settings: When an image is good enough.
        rectified: The images are rectified.
    """

    def __init__(
        self,
        frames: Frames,
        now_s: Callable[[], float],
        settings: FeedSettings,
        rectified: bool = False,
    ) -> None:
        self._frames = frames
        self._now_s = now_s
        self._settings = settings
        self._rectified = rectified
        self._image: Image | CompressedImage | None = None
        self._info: CameraInfo | None = None
        self._arrived = threading.Condition()
        self._stamps: deque[float] = deque(maxlen=_RATE_IMAGES)
        self._received = self._used = self._dropped = 0
        self._taken = True
        self.wanted = False
        # An image comes before the pose of the base that tells whether it counts: who waits for
        # it looks again then, or a newer image would always be there of which it is not known.
        frames.on_base(self._look_again)

    def take_image(self, msg: Image | CompressedImage) -> None:
        """Takes an image in."""
        with self._arrived:
            self._received += 1
            self._dropped += self.wanted and not self._taken
            self._image, self._taken = msg, False
            self._stamps.append(stamp_from_msg(msg.header.stamp))
            self._arrived.notify_all()

    def take_info(self, msg: CameraInfo) -> None:
        """Takes a camera model in."""
        with self._arrived:
            self._info = msg
            self._arrived.notify_all()

    def _look_again(self) -> None:
        with self._arrived:
            self._arrived.notify_all()

    def counts(self) -> FeedCounts:
        """Returns what became of the images so far."""
        with self._arrived:
            span_s = self._stamps[-1] - self._stamps[0] if len(self._stamps) > 1 else 0.0
            rate_hz = (len(self._stamps) - 1) / span_s if span_s > 0.0 else math.nan
            return FeedCounts(self._received, self._used, self._dropped, rate_hz)

    def next(self, timeout_s: float) -> View | None:
        """Returns the newest image that nobody took, wherever the base is; None = none came.

        Args:
            timeout_s: So long is waited for it, on wall time [s].

        Raises:
            ImageInvalidError: The image or the camera model can't be used.
        """
        with self._arrived:
            if not self._arrived.wait_for(
                lambda: not self._taken and self._info is not None, timeout_s
            ):
                return None
            image, info = self._take()
        return self._view(image, info)

    def look(self, after_s: float, is_cancelled: Callable[[], bool]) -> View:
        """Waits for an image that was taken after a time and after the base has come to rest.

        Args:
            after_s: The image must be newer than this [s].
            is_cancelled: Asked while waiting.

        Raises:
            NoImageError: None came.
            StaleImageError: None that is new enough.
            LocalizationCancelledError: It was cancelled.
            ImageInvalidError: The image or the camera model can't be used.
        """
        begin_s, begin_wall = self._now_s(), time.monotonic()
        with self._arrived:
            while not self._fresh(after_s):
                if is_cancelled():
                    raise cancelled()
                waited_s = self._now_s() - begin_s
                if (
                    waited_s > self._settings.image_timeout_s
                    or time.monotonic() - begin_wall > self._settings.wall_timeout_s
                ):
                    raise self._missing(after_s)
                self._arrived.wait(_POLL_S)
            image, info = self._take()
        return self._view(image, info)

    def _take(self) -> tuple[Image | CompressedImage, CameraInfo]:
        assert self._image is not None and self._info is not None
        self._used += 1
        self._taken = True
        return self._image, self._info

    def _view(self, image: Image | CompressedImage, info: CameraInfo) -> View:
        stamp_s = stamp_from_msg(image.header.stamp)
        compressed = isinstance(image, CompressedImage)
        pixels = compressed_image_from_msg(image) if compressed else image_from_msg(image)
        return View(
            pixels,
            camera_info_from_msg(info, self._rectified),
            image.header.frame_id,
            stamp_s,
            max(0.0, self._now_s() - stamp_s),
        )

    def _fresh(self, after_s: float) -> bool:
        if self._image is None or self._info is None:
            return False
        stamp_s = stamp_from_msg(self._image.header.stamp)
        if stamp_s <= after_s or stamp_s > self._frames.known_s:
            return False
        return stamp_s >= self._frames.moved_s + self._settings.settle_s

    def _missing(self, after_s: float) -> LocalizationError:
        if self._image is None or self._info is None:
            what = "image" if self._image is None else "camera info"
            return NoImageError(
                f"an image was waited for {self._settings.image_timeout_s} s, but no {what} came; "
                "a camera that publishes both is needed"
            )
        stamp_s = stamp_from_msg(self._image.header.stamp)
        needed_s = max(after_s, self._frames.moved_s + self._settings.settle_s)
        return StaleImageError(
            f"an image taken after {needed_s:.3f} s (the base moved until "
            f"{self._frames.moved_s:.3f} s) was waited for, the newest one is of {stamp_s:.3f} s"
        )
