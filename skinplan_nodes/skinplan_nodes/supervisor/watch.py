"""Which nodes of the cell are alive, judged by their heartbeats and by the graph. Needs no ROS."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import psutil


def process_runs(pid: int) -> bool:
    """Whether a process of this machine runs; a dead one that nobody has waited for does not."""
    try:
        return pid > 0 and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.Error:
        return False


@dataclass
class NodeWatch:
    """Heartbeats of the nodes that a job needs, on wall time.

    A node is lost when it was seen alive and then either stays silent or is no longer in the graph.
    A machine that is too busy also silences nodes, so one whose process still runs gets longer.

    Attributes:
        required: Names of the nodes, without namespace.
        silent_max_s: A node that is silent for longer and whose process is gone is lost [s].
        patience: A node whose process runs is lost after so many times longer [1].
        process_runs: Tells whether a process of this machine runs.
    """

    required: tuple[str, ...]
    silent_max_s: float = 5.0
    patience: float = 4.0
    process_runs: Callable[[int], bool] = process_runs
    _last_beat_s: dict[str, float] = field(default_factory=dict)
    _pids: dict[str, int] = field(default_factory=dict)
    _gone: dict[str, int] = field(default_factory=dict)
    _here: set[str] = field(default_factory=set)

    # The graph of a loaded machine may miss a node for one look: two in a row count.
    _LOOKS = 2

    def beat(self, node: str, now_s: float, pid: int = 0) -> bool:
        """Notes a heartbeat of a node and its process.

        Args:
            node: Fully qualified name or plain name.
            now_s: Any clock that does not jump [s].
            pid: Its process.

        Returns:
            Whether it is another process than before: the node has lost what it knew.
        """
        name = node.rsplit("/", 1)[-1]
        another = self._pids.get(name, pid) != pid
        self._last_beat_s[name] = now_s
        if name not in self._here or another:
            (self._here.add if self.process_runs(pid) else self._here.discard)(name)
        self._pids[name] = pid
        self._gone.pop(name, None)
        return another

    def last_beat_s(self, name: str) -> float:
        """Returns when a node was last heard; infinitely long ago = never [s]."""
        return self._last_beat_s.get(name, float("-inf"))

    def pid(self, name: str, now_s: float) -> int:
        """Returns the process of a node; 0 = it was never seen, or is lost."""
        return 0 if self.is_lost(name, now_s) else self._pids.get(name, 0)

    def absent(self, now_s: float) -> tuple[str, ...]:
        """Returns the required nodes that were never seen, or are lost."""
        never = set(self.missing())
        return tuple(n for n in self.required if n in never or self.is_lost(n, now_s))

    def look(self, names_in_graph: Iterable[str]) -> None:
        """Notes which nodes the graph shows."""
        present = set(names_in_graph)
        for name in self._last_beat_s:
            self._gone[name] = 0 if name in present else self._gone.get(name, 0) + 1

    def dead(self) -> str | None:
        """Returns the first required node whose process, seen on this machine, runs no more.

        It is known at once, before the node is missed: for whoever asks why a job is aborted.
        """
        here = (name for name in self.required if name in self._here)
        return next((name for name in here if not self.process_runs(self._pids[name])), None)

    def missing(self) -> tuple[str, ...]:
        """Returns the required nodes that were never seen."""
        return tuple(name for name in self.required if name not in self._last_beat_s)

    def lost(self, now_s: float) -> str | None:
        """Returns the first required node that is lost, None when all are well.

        Args:
            now_s: The same clock as in `beat` [s].
        """
        return next((name for name in self.required if self.is_lost(name, now_s)), None)

    def is_lost(self, name: str, now_s: float) -> bool:
        """Whether a node was seen and is silent, or gone from the graph, since."""
        if name not in self._last_beat_s:
            return False
        if self._gone.get(name, 0) >= self._LOOKS:
            return True
        silent_s = now_s - self._last_beat_s[name]
        if silent_s <= self.silent_max_s:
            return False
        return silent_s > self.patience * self.silent_max_s or not self.process_runs(
            self._pids[name]
        )
