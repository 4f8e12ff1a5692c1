"""Reads messages in a thread of its own, a bounded number of bytes ahead of whoever takes them."""

import threading
from collections import deque
from collections.abc import Iterator

from skinplan.recording.model import BagMessage

_JOIN_S = 30.0
# A message costs about so much beside its data [B].
_OVERHEAD = 200


class ReadAhead:
    """Takes messages from an iterator before they are asked for.

    Args:
        messages: Where they come from; used in the thread only.
        most_bytes: So much waits at most; one message always does.
    """

    def __init__(self, messages: Iterator[BagMessage], most_bytes: int) -> None:
        self._messages = messages
        self._most = most_bytes
        self._waiting: deque[BagMessage] = deque()
        self._bytes = 0
        self._changed = threading.Condition()
        self._ended = self._closed = False
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._read, name="read ahead", daemon=True)
        self._thread.start()

    def next(self) -> BagMessage | None:
        """Returns the next message; None = there are no more.

        Raises:
            BagInvalidError: The bag is damaged behind the messages that were returned.
        """
        with self._changed:
            while not self._waiting and not self._ended:
                self._changed.wait()
            if self._waiting:
                message = self._waiting.popleft()
                self._bytes -= len(message.data) + _OVERHEAD
                # Woken when there is room for more than a trickle.
                if self._bytes < self._most // 2:
                    self._changed.notify_all()
                return message
            if self._error is not None:
                raise self._error
            return None

    def close(self) -> None:
        """Ends the thread; the iterator may be used by others afterwards."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join(_JOIN_S)

    def _read(self) -> None:
        try:
            for message in self._messages:
                with self._changed:
                    while self._bytes > self._most and not self._closed:
                        self._changed.wait()
                    if self._closed:
                        return
                    self._waiting.append(message)
                    self._bytes += len(message.data) + _OVERHEAD
                    if len(self._waiting) == 1:
                        self._changed.notify_all()
        except Exception as error:
            self._error = error
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify_all()
