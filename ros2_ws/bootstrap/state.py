"""What of the set-up is done: one small file in the virtual environment, written in one step."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable
from pathlib import Path


class State:
    """Which steps finished, each with the key (hash of all that it depends on) it finished with.

    A step has begun (its entry is there and says not done) from before its first change until after
    its last, so that a set-up that was killed in the middle is recognised.
    """

    def __init__(self, file: Path) -> None:
        """Read the state.

        Args:
            file: The file; missing or unreadable = nothing is known to be done.
        """
        self._file = file
        self._steps: dict[str, dict[str, object]] = {}
        try:
            steps = json.loads(file.read_text(encoding="utf-8"))
            self._steps = {name: dict(entry) for name, entry in steps.items()}
        except (OSError, ValueError, AttributeError, TypeError):
            self._steps = {}

    def is_done(self, step: str, key: str) -> bool:
        """Tell whether the step finished with this key."""
        return self._steps.get(step) == {"key": key, "done": True}

    def is_broken(self, step: str) -> bool:
        """Tell whether the step began and did not finish."""
        entry = self._steps.get(step)
        return entry is not None and entry.get("done") is not True

    def begin(self, step: str, key: str) -> None:
        """Note that the step is about to change things."""
        self._steps[step] = {"key": key, "done": False}
        self._write()

    def finish(self, step: str, key: str) -> None:
        """Note that the step has finished."""
        self._steps[step] = {"key": key, "done": True}
        self._write()

    def _write(self) -> None:
        self._file.parent.mkdir(parents=True, exist_ok=True)
        new = self._file.with_suffix(".new")
        with new.open("w", encoding="utf-8") as handle:
            json.dump(self._steps, handle, indent=1)
            handle.flush()
            os.fsync(handle.fileno())
        new.replace(self._file)


def hash_of(*parts: str | Path) -> str:
    """Hash texts, files (by content) and folders (by the names and contents of all files in them).

    Args:
        parts: Texts, or paths of files and folders. A missing path counts as such.

    Returns:
        Hexadecimal SHA-256.
    """
    digest = hashlib.sha256()
    for part in parts:
        for name, content in _contents(part):
            digest.update(f"{len(name)}:{name}:{len(content)}:".encode())
            digest.update(content)
    return digest.hexdigest()


def _contents(part: str | Path) -> Iterable[tuple[str, bytes]]:
    if isinstance(part, str):
        yield "text", part.encode()
    elif part.is_dir():
        for file in sorted(part.rglob("*")):
            if file.is_file() and "__pycache__" not in file.parts:
                yield str(file.relative_to(part)), file.read_bytes()
    elif part.is_file():
        yield part.name, part.read_bytes()
    else:
        yield part.name, b"missing"
