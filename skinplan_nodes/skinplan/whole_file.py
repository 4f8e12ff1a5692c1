"""Files that are whole or not there: a reader sees the old one or the new one, never half."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Gives a place beside a file to write to; what stands there in the end takes its place.

    When the writing fails, what was there before is still there, and nothing beside it.

    Args:
        path: The file.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        yield temporary
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
