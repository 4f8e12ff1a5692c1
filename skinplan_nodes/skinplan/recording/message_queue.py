"""Messages on their way to a bag: a bounded queue, emptied by a thread of its own."""

import logging
import threading
import time
from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

from skinplan.errors import BagNotWritableError
from skinplan.recording.bag import BagWriter

_LOG = logging.getLogger(__name__)
# What a waiting message costs beside its data [B].
_OVERHEAD_BYTES = 200
# So long the thread lets messages gather: one waking for many of them [s].
_GATHER_S = 0.002


class QueuedMessage(NamedTuple):
    """A message on its way.

    Attributes:
        topic: Topic.
        data: Serialised message.
        log_time_ns: When it was received [ns].
        publish_time_ns: When it was published [ns].
    """

    topic: str
    data: bytes
    log_time_ns: int
    publish_time_ns: int

    @property
    def size_bytes(self) -> int:
        """What it takes in memory [B]."""
        return len(self.data) + _OVERHEAD_BYTES


class MessageQueue:
    """Writes messages to a bag in the background; what does not fit is dropped and counted.

    One thread puts, the queue's own takes; neither ever waits for the other.

    Args:
        writer: The bag.
        most_bytes: So much waits at most [B].

    Attributes:
        dropped: Messages dropped so far by topic.
        failure: Why the last message that the bag did not take was refused; None = all is well.
    """

    def __init__(self, writer: BagWriter, most_bytes: int) -> None:
        self._writer = writer
        self._most = most_bytes
        self._items: deque[QueuedMessage] = deque()
        # Each is changed by one thread only: no lock is needed for their difference.
        self._put_bytes = 0
        self._taken_bytes = 0
        self._waiting = threading.Event()
        self._ended = False
        self._failed = False
        self.dropped: dict[str, int] = {}
        self.failure: BagNotWritableError | None = None
        self._thread = threading.Thread(target=self._run, name="bag writer", daemon=True)
        self._thread.start()

    @property
    def waiting_bytes(self) -> int:
        """What waits for the disk now [B]."""
        return self._put_bytes - self._taken_bytes

    def put(self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Takes a message, or drops and counts it."""
        size = len(data) + _OVERHEAD_BYTES
        if self._failed or self._ended or self._put_bytes - self._taken_bytes + size > self._most:
            self.dropped[topic] = self.dropped.get(topic, 0) + 1
            return
        self._put_bytes += size
        self._items.append(QueuedMessage(topic, data, log_time_ns, publish_time_ns))
        if not self._waiting.is_set():
            self._waiting.set()

    def put_all(self, messages: Iterable[QueuedMessage]) -> None:
        """Takes messages that are bounded already, all of them."""
        for message in messages:
            self._put_bytes += message.size_bytes
            self._items.append(message)
        self._waiting.set()

    def finish(self) -> None:
        """Writes what waits, and ends."""
        self._ended = True
        self._waiting.set()
        self._thread.join()

    def _run(self) -> None:
        while True:
            self._waiting.wait()
            self._waiting.clear()
            ending = self._ended
            self._empty()
            if ending:
                return
            time.sleep(_GATHER_S)

    def _empty(self) -> None:
        items, write = self._items, self._writer.write
        while items:
            message = items.popleft()
            try:
                write(*message)
            except Exception as error:  # a thread that died in silence would lose all the rest
                self._refused(message, error)
            self._taken_bytes += message.size_bytes

    def _refused(self, message: QueuedMessage, error: Exception) -> None:
        if self._writer.failure is not None:
            # The disk: the bag counts it, and all that comes, as lost.
            self._failed = True
            return
        _LOG.error("a message of %s is not recorded", message.topic, exc_info=error)
        self.failure = BagNotWritableError(
            f"a message of {message.topic} ({len(message.data)} bytes at {message.log_time_ns} ns) "
            f"could not be written: {error}"
        )
        self.dropped[message.topic] = self.dropped.get(message.topic, 0) + 1
