"""The last messages of a run, in bounded memory, for a snapshot."""

from collections import deque

from skinplan.recording.message_queue import QueuedMessage


class SnapshotRing:
    """Keeps the last messages; older ones make room.

    Args:
        most_bytes: Memory [B].
        most_s: How far back it reaches [s]; 0 = as far as the memory does.
    """

    def __init__(self, most_bytes: int, most_s: float) -> None:
        self._most_bytes = most_bytes
        self._most_ns = int(most_s * 1e9)
        self._items: deque[QueuedMessage] = deque()
        self._latched: set[str] = set()
        # The last message of a latched topic holds on, however old.
        self._heads: dict[str, QueuedMessage] = {}
        self.size_bytes = 0

    def latch(self, topic: str) -> None:
        """Has the last message of a topic kept, however old it is."""
        self._latched.add(topic)

    def add(self, message: QueuedMessage) -> None:
        """Takes a message."""
        self._items.append(message)
        self.size_bytes += message.size_bytes
        oldest_ns = message.log_time_ns - self._most_ns if self._most_ns else 0
        while self._items and (
            self.size_bytes > self._most_bytes or self._items[0].log_time_ns < oldest_ns
        ):
            self._release(self._items.popleft())

    def take(self) -> list[QueuedMessage]:
        """Returns what is in it and empties it.

        Returns:
            First the latched messages that held when the oldest of the others came, with its log
            time; then the others in the order of receipt.
        """
        items, self._items = list(self._items), deque()
        if not items:
            return []
        begin_ns = items[0].log_time_ns
        heads = [head._replace(log_time_ns=begin_ns) for head in self._heads.values()]
        for message in items:
            self._release(message)
        return [*heads, *items]

    def _release(self, message: QueuedMessage) -> None:
        self.size_bytes -= message.size_bytes
        if message.topic in self._latched:
            self._heads[message.topic] = message
