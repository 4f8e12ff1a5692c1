"""Shared memory that Fast DDS keeps of processes that were killed. Needs no ROS.

A participant that ends takes its segment away. One that is killed can't, and nobody else does: up
to 34 MiB of memory for each node that died, until the machine starts anew.
"""

import contextlib
import fcntl
import re
import time
from pathlib import Path

_FOLDER = Path("/dev/shm")
_LOCK = re.compile(r"(fastrtps|fastdds)_[0-9a-f]{16}_el")
# A segment's lock is made before it is taken.
_SETTLED_S = 5.0


def remove_orphaned_segments(folder: Path = _FOLDER) -> int:
    """Removes segments whose owner, which holds a lock on a file beside as long as it lives, died.

    Names of segments are drawn at random: none is taken twice. Ports have fixed names, and Fast DDS
    takes those over itself.

    Args:
        folder: Where shared memory shows as files; one that isn't there has none.

    Returns:
        How many bytes were given back.
    """
    freed = 0
    for lock in sorted(folder.glob("fast*_el")):
        # Others may do the same at this moment, or own the files.
        with contextlib.suppress(OSError):
            if _LOCK.fullmatch(lock.name) and time.time() - lock.stat().st_mtime > _SETTLED_S:
                freed += _remove_if_orphaned(lock)
    return freed


def _remove_if_orphaned(lock: Path) -> int:
    segment = lock.with_name(lock.name.removesuffix("_el"))
    with lock.open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        size = segment.stat().st_size if segment.exists() else 0
        segment.unlink(missing_ok=True)
        lock.unlink()
    return size
