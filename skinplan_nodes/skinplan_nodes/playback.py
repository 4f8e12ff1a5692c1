"""Plays recorded messages in time: rate, pause, step, burst, seek, loop. Needs no ROS."""

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from skinplan.errors import InputError
from skinplan.recording.latched import latched_state
from skinplan.recording.model import BagMessage
from skinplan.recording.read_ahead import ReadAhead
from skinplan.recording.reader import BagReader

# The clock goes on while no message is due; not more often, however fast time runs.
_LONGEST_WAIT_S = 0.02
_LATE_S = 0.05


@dataclass(frozen=True)
class PlaybackSettings:
    """How a bag is played.

    Attributes:
        rate: Times faster than recorded.
        start_offset_s: Where to start, from the first message [s].
        duration_s: So much of the recording is played [s]; 0 = up to its end.
        until_s: Where to end, from the first message [s]; 0 = at its end.
        loop: Start again at the end.
        start_paused: Wait for the first resume.
        hold_at_end: Wait for a seek at the end, in the place of ending.
        tick_s: The clock is told at least so often, wall time [s].
        read_ahead_bytes: So much is read in advance [B].
    """

    rate: float = 1.0
    start_offset_s: float = 0.0
    duration_s: float = 0.0
    until_s: float = 0.0
    loop: bool = False
    start_paused: bool = False
    hold_at_end: bool = False
    tick_s: float = _LONGEST_WAIT_S
    read_ahead_bytes: int = 2**26


class Listener(Protocol):
    """What is told while a bag is played, in the thread of `Playback.run`."""

    def on_message(self, message: BagMessage, late: bool) -> None:
        """Gets each message when it is due, and whether time has run ahead of the player."""

    def on_time(self, now_ns: int) -> None:
        """Gets the time of the recording [ns], often."""

    def on_state(self, state: Mapping[str, list[BagMessage]]) -> None:
        """Gets the state of the latched topics before playing starts at another place."""


class Playback:
    """One bag being played; `run` is called in a thread of its own, the rest from any.

    Args:
        reader: The bag; used by `run` alone from now on.
        topics: Topics to play.
        latched: Latched ones of them -> how many of its last messages a late subscriber gets.
        settings: How.
        listener: Is told.

    Raises:
        InputError: A rate or a place out of range.
    """

    def __init__(
        self,
        reader: BagReader,
        topics: frozenset[str],
        latched: Mapping[str, int],
        settings: PlaybackSettings,
        listener: Listener,
    ) -> None:
        self._reader = reader
        self._bag = reader.info
        self._topics = topics
        self._latched = latched
        self._settings = settings
        self._listener = listener
        self._changed = threading.Condition()
        self._rate = _checked_rate(settings.rate)
        self._paused = settings.start_paused
        self._stopped = self._over = False
        self._to_burst = self._bursts = 0
        self._round_s = 0.0
        self._start_ns = self._place(settings.start_offset_s)
        self._end_ns = self._last_place()
        self._seek_ns: int | None = self._start_ns
        self._anchor = (time.monotonic(), self._start_ns)

    def run(self) -> None:
        """Plays until the end of the bag or `stop`.

        Raises:
            BagInvalidError: The bag is damaged.
        """
        ahead: ReadAhead | None = None
        try:
            while not self._stopped:
                place = self._take_seek()
                if place is not None:
                    ahead = self._moved(place, ahead)
                assert ahead is not None
                message = ahead.next()
                if message is None:
                    if not self._go_on_at_end():
                        return
                elif self._wait_for(message.log_time_ns):
                    self._listener.on_message(message, self._is_late(message.log_time_ns))
                    self._note_burst()
        finally:
            if ahead is not None:
                ahead.close()
            with self._changed:
                self._over = True
                self._changed.notify_all()

    @property
    def paused(self) -> bool:
        """Whether the time of the recording stands."""
        return self._paused

    @property
    def rate(self) -> float:
        """Times faster than recorded."""
        return self._rate

    @property
    def offset_s(self) -> float:
        """Place of the play head, from the first message [s]."""
        with self._changed:
            if self._seek_ns is not None:
                return (self._seek_ns - self._bag.start_ns) * 1e-9
            now_ns = min(self._time_ns(), self._end_ns)
            return (now_ns - self._bag.start_ns) * 1e-9

    def pause(self) -> None:
        """Stops the time of the recording."""
        self._set_paused(True)

    def resume(self) -> None:
        """Lets the time of the recording go on."""
        self._set_paused(False)

    def toggle(self) -> bool:
        """Pauses or resumes; returns whether it is paused now."""
        with self._changed:
            self._set_paused(not self._paused)
            return self._paused

    def stop(self) -> None:
        """Ends `run`."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def wait_stopped(self, timeout_s: float) -> bool:
        """Waits for `stop`; returns whether it was asked for."""
        with self._changed:
            return self._changed.wait_for(lambda: self._stopped, timeout_s)

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
            self._to_burst = 0
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

    def burst(self, messages: int) -> int:
        """Plays the next messages at once, while paused; waits for it.

        Args:
            messages: So many at most; 0 = all up to the end.

        Returns:
            How many were played; fewer at the end, or when a seek or a stop came between.

        Raises:
            InputError: It is not paused, or another burst is being played.
        """
        with self._changed:
            if not self._paused:
                raise InputError(
                    "messages were asked for one by one while the bag is playing; a paused "
                    "player is accepted"
                )
            if self._to_burst:
                raise InputError("a burst was asked for while another is being played; wait for it")
            before = self._bursts
            self._to_burst = messages or 2**63
            self._changed.notify_all()
            while self._to_burst and self._paused and not (self._stopped or self._over):
                self._changed.wait()
            self._to_burst = 0
            return self._bursts - before

    def _set_paused(self, paused: bool) -> None:
        with self._changed:
            self._set_now(self._time_ns())
            self._paused = paused
            self._changed.notify_all()

    def _take_seek(self) -> int | None:
        with self._changed:
            place, self._seek_ns = self._seek_ns, None
            if place is not None:
                # Time stands while the state is looked up and published.
                self._anchor = (float("inf"), place)
            return place

    def _moved(self, place: int, ahead: ReadAhead | None) -> ReadAhead:
        """Restores the state of a place and reads on from there."""
        if ahead is not None:
            ahead.close()
        self._listener.on_time(place)
        self._listener.on_state(latched_state(self._reader, self._latched, place))
        found = self._reader.messages(self._topics, place, self._end_ns + 1)
        made = ReadAhead(found, self._settings.read_ahead_bytes)
        with self._changed:
            self._set_now(place)
            self._round_s = time.monotonic()
        return made

    def _go_on_at_end(self) -> bool:
        """Starts again or waits for a seek at the end; False = that was all."""
        with self._changed:
            self._to_burst = 0
            self._changed.notify_all()
            if self._seek_ns is not None:
                return True
            if self._settings.loop and self._bag.messages:
                self._seek_ns = self._start_ns
                # A round without anything to wait for does not keep the processor busy.
                if time.monotonic() - self._round_s < _LONGEST_WAIT_S:
                    self._changed.wait(_LONGEST_WAIT_S)
                return True
            if not self._settings.hold_at_end:
                return False
            while self._seek_ns is None and not self._stopped:
                self._set_now(self._end_ns)
                if self._to_burst:
                    self._to_burst = 0
                    self._changed.notify_all()
                self._changed.wait(_LONGEST_WAIT_S)
            return True

    def _wait_for(self, due_ns: int) -> bool:
        """Waits until a time of the recording; False = something else is to be played."""
        while True:
            with self._changed:
                if self._stopped or self._seek_ns is not None:
                    return False
                if self._to_burst:
                    self._set_now(due_ns)
                now_ns = min(self._time_ns(), due_ns)
                due = now_ns >= due_ns and (not self._paused or self._to_burst > 0)
            self._listener.on_time(now_ns)
            if due:
                return True
            with self._changed:
                if self._stopped or self._seek_ns is not None or self._to_burst:
                    continue
                wait_s = (due_ns - self._time_ns()) * 1e-9 / self._rate
                most = self._settings.tick_s
                self._changed.wait(most if self._paused else max(0.0, min(wait_s, most)))

    def _is_late(self, due_ns: int) -> bool:
        """Tells whether the gaps are lost already, so that nothing is lost by waiting."""
        behind_s = (self._time_ns() - due_ns) * 1e-9 / self._rate
        return behind_s > _LATE_S or self._to_burst > 0

    def _note_burst(self) -> None:
        if self._to_burst:
            with self._changed:
                self._bursts += 1
                self._to_burst -= self._to_burst > 0
                if self._to_burst == 0:
                    self._changed.notify_all()

    def _time_ns(self) -> int:
        wall_s, at_ns = self._anchor
        if self._paused or wall_s == float("inf"):
            return at_ns
        return at_ns + int((time.monotonic() - wall_s) * self._rate * 1e9)

    def _set_now(self, now_ns: int) -> None:
        self._anchor = (time.monotonic(), now_ns)

    def _place(self, offset_s: float) -> int:
        if not 0.0 <= offset_s <= max(self._bag.duration_s, 0.0):
            raise InputError(
                f"a place {offset_s:g} s behind the first message was asked for; 0 to "
                f"{self._bag.duration_s:.3f} s is accepted"
            )
        return self._bag.start_ns + round(offset_s * 1e9)

    def _last_place(self) -> int:
        settings, found = self._settings, self._bag.end_ns
        if settings.duration_s > 0.0:
            found = min(found, self._start_ns + round(settings.duration_s * 1e9))
        if settings.until_s > 0.0:
            found = min(found, self._bag.start_ns + round(settings.until_s * 1e9))
        if found < self._start_ns:
            raise InputError(
                f"an end {settings.until_s:g} s behind the first message was asked for; one "
                f"behind the start at {settings.start_offset_s:g} s is accepted"
            )
        return found


def _checked_rate(rate: float) -> float:
    if not 0.0 < rate < float("inf"):
        raise InputError(f"the rate {rate:g} was asked for; a finite number above 0 is accepted")
    return rate
