"""Simulated time as a function of wall time: it never runs back and waits for slow nodes.

Needs no ROS.
"""

import os
import struct
import zlib
from pathlib import Path

_TIME = struct.Struct("<qI")


class SimTime:
    """Simulated time.

    Args:
        start_s: Time at the first tick [s].
        factor: Times faster than wall time, where nothing lags.
        longest_step_s: Longest step of wall time that counts [s]: a tick that comes late makes time
            go slower, not jump.
    """

    def __init__(self, start_s: float, factor: float, longest_step_s: float) -> None:
        self.now_ns = round(start_s * 1e9)
        self.held = False
        self._factor = factor
        self._longest_ns = round(longest_step_s * 1e9)
        self._wall_ns: int | None = None

    def tick(self, wall_ns: int, limit_ns: int | None = None) -> int:
        """Moves on to a wall time.

        Args:
            wall_ns: Wall time [ns].
            limit_ns: Time does not go beyond [ns]; None = no limit.

        Returns:
            The time [ns]; `held` tells whether the limit held it back.
        """
        wanted_ns = self.now_ns
        if self._wall_ns is not None:
            step_ns = min(max(wall_ns - self._wall_ns, 0), self._longest_ns)
            wanted_ns += round(step_ns * self._factor)
        self._wall_ns = wall_ns
        allowed_ns = wanted_ns if limit_ns is None else max(self.now_ns, min(wanted_ns, limit_ns))
        self.now_ns, self.held = allowed_ns, allowed_ns < wanted_ns
        return self.now_ns

    def run_at(self, factor: float) -> None:
        """Changes how many times faster than wall time it runs from here on."""
        self._factor = factor

    def jump(self, ahead_ns: int) -> None:
        """Jumps ahead.

        Args:
            ahead_ns: How far, not below 0 [ns].
        """
        self.now_ns += max(0, ahead_ns)


class SlowNodes:
    """How far the nodes have come that time waits for.

    A node that has not told anything yet is not waited for; nor is one that makes no progress while
    time stands still for it: it is dead, or has nothing to work off.

    Args:
        names: Nodes that time waits for.
        lag_max_s: They may be so far behind [s].
        wait_max_s: Time stands still for a node without progress for so long of wall time [s].
    """

    def __init__(self, names: list[str], lag_max_s: float, wait_max_s: float) -> None:
        self._names = frozenset(names)
        self._lag_ns = round(lag_max_s * 1e9)
        self._wait_max_s = wait_max_s
        # Name -> time that it has come to [ns] and wall time at which it told so [s].
        self._told: dict[str, tuple[int, float]] = {}
        self._given_up: set[str] = set()

    def tell(self, name: str, stamp_ns: int, wall_s: float) -> None:
        """Takes note of how far a node has come; 0 = there is nothing to wait for."""
        if name not in self._names:
            return
        before = self._told.get(name)
        if stamp_ns == 0:
            self._told.pop(name, None)
        elif before is None or stamp_ns > before[0] or name in self._given_up:
            self._told[name] = (stamp_ns, wall_s)
        self._given_up.discard(name)

    def limit_ns(self) -> int | None:
        """Returns how far time may go [ns]; None = as it likes."""
        waited = [stamp for name, (stamp, _) in self._told.items() if name not in self._given_up]
        return min(waited) + self._lag_ns if waited else None

    def give_up(self, now_ns: int, wall_s: float) -> list[str]:
        """Returns the nodes that time stops waiting for: behind, and without progress for too long.

        Args:
            now_ns: Time of the cell, held back [ns].
            wall_s: Wall time [s].
        """
        late = [
            name
            for name, (stamp_ns, told_s) in self._told.items()
            if name not in self._given_up
            and stamp_ns + self._lag_ns <= now_ns
            and wall_s - told_s > self._wait_max_s
        ]
        self._given_up.update(late)
        return late


class TimeFile:
    """Keeps the time for a clock that is started again, however the program ended.

    Args:
        path: The file; None = nothing is kept.
    """

    def __init__(self, path: Path | None) -> None:
        self._descriptor = -1
        if path is not None:
            self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)

    def read(self) -> int | None:
        """Returns the time kept last [ns]; None = none."""
        if self._descriptor < 0:
            return None
        data = os.pread(self._descriptor, _TIME.size, 0)
        if len(data) != _TIME.size:
            return None
        now_ns, checksum = _TIME.unpack(data)
        return int(now_ns) if zlib.crc32(data[:8]) == checksum and now_ns > 0 else None

    def write(self, now_ns: int) -> None:
        """Keeps a time [ns].

        Raises:
            OSError: The disk does not take it.
        """
        if self._descriptor >= 0:
            data = _TIME.pack(now_ns, 0)[:8]
            os.pwrite(self._descriptor, data + struct.pack("<I", zlib.crc32(data)), 0)

    def close(self) -> None:
        """Ends keeping."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
