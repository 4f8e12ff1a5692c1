"""Plays recorded messages in time: rate, pause, seek, loop. Needs no ROS."""

import threading
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass

from skinplan.errors import InputError
from skinplan.recording.model import BagInfo, BagMessage
from skinplan.recording.reader import read_messages

# The clock goes on while no message is due; not more often, however fast time runs.
_LONGEST_WAIT_S = 0.02


@dataclass(frozen=True)
class PlaybackSettings:
    """How a bag is played.

    Attributes:
        rate: Times faster than recorded.
        start_offset_s: Where to start, from the first message [s].
        loop: Start again at the end.
        start_paused: Wait for the first resume.
    """

    rate: float = 1.0
    start_offset_s: float = 0.0
    loop: bool = False
    start_paused: bool = False


class Playback:
    """One bag being played; `run` is called in a thread of its own, the rest from any.

    Args:
        bag: The bag.
        topics: Topics to play.
        settings: How.
        on_message: Gets each message when it is due.
        on_time: Gets the time of the recording [ns], at most every 20 ms of wall time.

    Raises:
        InputError: A rate or an offset out of range.
    """

    def __init__(
        self,
        bag: BagInfo,
        topics: Collection[str],
        settings: PlaybackSettings,
        on_message: Callable[[BagMessage], None],
        on_time: Callable[[int], None],
    ) -> None:
        self._bag = bag
        self._topics = frozenset(topics)
        self._loop = settings.loop
        self._on_message = on_message
        self._on_time = on_time
        self._changed = threading.Condition()
        self._rate = _checked_rate(settings.rate)
        self._paused = settings.start_paused
        self._stopped = False
        self._seek_ns: int | None = self._place(settings.start_offset_s)
        self._now_ns = self._seek_ns
        self._anchor = (time.monotonic(), self._now_ns)

    def run(self) -> None:
        """Plays until the end of the bag or `stop`."""
        messages: Iterator[BagMessage] = iter(())
        while True:
            with self._changed:
                if self._stopped:
                    return
                if self._seek_ns is not None:
                    messages = read_messages(self._bag, self._topics, self._seek_ns)
                    self._set_now(self._seek_ns)
                    self._seek_ns = None
            message = next(messages, None)
            if message is None:
                if not self._loop or self._bag.messages == 0:
                    return
                self.seek(0.0)
            elif self._wait_for(message.log_time_ns):
                self._on_message(message)

    def pause(self) -> None:
        """Stops the time of the recording."""
        with self._changed:
            self._set_now(self._time_ns())
            self._paused = True
            self._changed.notify_all()

    def resume(self) -> None:
        """Lets the time of the recording go on."""
        with self._changed:
            self._set_now(self._time_ns())
            self._paused = False
            self._changed.notify_all()

    def toggle(self) -> bool:
        """Pauses or resumes; returns whether it is paused now."""
        with self._changed:
            self._set_now(self._time_ns())
            self._paused = not self._paused
            self._changed.notify_all()
            return self._paused

    def stop(self) -> None:
        """Ends `run`."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def seek(self, offset_s: float) -> None:
        """Moves to another place.

        Args:
            offset_s: From the first message [s].

        Raises:
            InputError: Before the first or behind the last message.
        """
        place = self._place(offset_s)
        with self._changed:
            self._seek_ns = place
            self._changed.notify_all()

    def set_rate(self, rate: float) -> None:
        """Changes the speed.

        Args:
            rate: Times faster than recorded.

        Raises:
            InputError: Not above 0, or not finite.
        """
        checked = _checked_rate(rate)
        with self._changed:
            self._set_now(self._time_ns())
            self._rate = checked
            self._changed.notify_all()

    def _wait_for(self, due_ns: int) -> bool:
        """Waits until a time of the recording; False = something else is to be played."""
        while True:
            with self._changed:
                if self._stopped or self._seek_ns is not None:
                    return False
                now_ns = min(self._time_ns(), due_ns)
                self._now_ns = max(self._now_ns, now_ns)
            self._on_time(self._now_ns)
            if now_ns >= due_ns and not self._paused:
                return True
            with self._changed:
                wait_s = (due_ns - now_ns) * 1e-9 / self._rate
                most = _LONGEST_WAIT_S
                self._changed.wait(most if self._paused else max(0.0, min(wait_s, most)))

    def _time_ns(self) -> int:
        wall_s, at_ns = self._anchor
        if self._paused:
            return at_ns
        return at_ns + int((time.monotonic() - wall_s) * self._rate * 1e9)

    def _set_now(self, now_ns: int) -> None:
        self._now_ns = now_ns
        self._anchor = (time.monotonic(), now_ns)

    def _place(self, offset_s: float) -> int:
        if not 0.0 <= offset_s <= max(self._bag.duration_s, 0.0):
            raise InputError(
                f"a place {offset_s:g} s behind the first message was asked for; 0 to "
                f"{self._bag.duration_s:.3f} s is accepted"
            )
        return self._bag.start_ns + round(offset_s * 1e9)


def _checked_rate(rate: float) -> float:
    if not 0.0 < rate < float("inf"):
        raise InputError(f"the rate {rate:g} was asked for; a finite number above 0 is accepted")
    return rate
