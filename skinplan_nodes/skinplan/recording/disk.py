"""The disk under a bag: how much is free, and whether an error says that it is full."""

import errno
import fcntl
import os
from pathlib import Path

from skinplan.errors import BagNotWritableError, DiskFullError

# No space, over the quota, larger than a file may be.
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def require_space(folder: Path, needed_bytes: int, least_free_bytes: int) -> None:
    """Makes sure that a disk has enough left after something is written.

    Args:
        folder: Existing folder on that disk.
        needed_bytes: What is about to be written [B].
        least_free_bytes: So much has to stay free [B].

    Raises:
        DiskFullError: It would have less.
    """
    if least_free_bytes <= 0:
        return
    found = os.statvfs(folder)
    free = found.f_bavail * found.f_frsize
    if free - needed_bytes < least_free_bytes:
        raise DiskFullError(
            f"{folder}: {free} bytes are free on the disk; at least {least_free_bytes} have to "
            f"stay free beside the {needed_bytes} to be written"
        )


def is_full(error: BaseException | None) -> bool:
    """Whether a full disk is behind an error, or behind one that it was raised from."""
    # An error that was raised from itself has itself as its cause.
    looked_at: list[BaseException] = []
    while error is not None and error not in looked_at:
        if isinstance(error, OSError) and error.errno in _FULL:
            return True
        looked_at.append(error)
        error = error.__cause__
    return False


def write_error(path: Path, error: OSError) -> BagNotWritableError:
    """Names an error of writing to a bag; a full disk has a class of its own."""
    kind = DiskFullError if error.errno in _FULL else BagNotWritableError
    return kind(f"{path}: the bag can't be written ({error.strerror or error})")


def write_all(handle: int, parts: tuple[bytes, ...]) -> None:
    """Writes parts one after the other, with as few calls as the system allows.

    Raises:
        OSError: The disk does not take it; part of it may be written.
    """
    waiting = [memoryview(part) for part in parts if part]
    while waiting:
        written = os.writev(handle, waiting)
        while waiting and written >= len(waiting[0]):
            written -= len(waiting.pop(0))
        if written:
            waiting[0] = waiting[0][written:]


def lock_file(handle: int) -> bool:
    """Marks a file as being written, until it is closed or its process ends in any way.

    Returns:
        False when another holds it.
    """
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        # A file system without locks: nobody can tell, so nobody is kept off.
        return True
    return True


def sync_folder(folder: Path) -> None:
    """Brings a folder's entries to the disk: files created, renamed, removed."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
