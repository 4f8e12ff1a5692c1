"""Remembers which bags are being recorded, so that the next start heals what was cut off."""

import contextlib
import hashlib
import logging
import os
from pathlib import Path

from skinplan.errors import SkinplanError
from skinplan.recording.heal import heal_bag, is_finished

_LOG = logging.getLogger(__name__)


class UnfinishedBags:
    """A small file per bag under way.

    Args:
        folder: Where the files are; None = ``skinplan/recording`` in the user's state folder.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder if folder is not None else _state_folder()

    def begin(self, bag: Path) -> None:
        """Notes a bag; without a place for the note it can only be healed by command."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._note(bag).write_text(f"{bag}\n", encoding="utf-8")
        except OSError as error:
            _LOG.warning("bag %s is not noted as under way (%s)", bag, error)

    def end(self, bag: Path) -> None:
        """Takes the note of a bag away."""
        with contextlib.suppress(OSError):
            self._note(bag).unlink(missing_ok=True)

    def heal(self) -> list[str]:
        """Heals every bag that was noted and is not being recorded.

        Returns:
            A sentence per bag about what was lost, or why it could not be healed.
        """
        sentences = []
        for note in sorted(self.folder.glob("*.path")) if self.folder.is_dir() else []:
            try:
                bag = Path(note.read_text(encoding="utf-8").strip())
                sentence = self._heal(bag)
            except OSError as error:
                sentence = f"{note}: {error}"
            if sentence:
                sentences.append(sentence)
        return sentences

    def _heal(self, bag: Path) -> str:
        if not bag.is_dir() or is_finished(bag):
            self.end(bag)
            return ""
        try:
            report = heal_bag(bag)
        except SkinplanError as error:
            # Being recorded by another process, or a full disk: tried again at the next start.
            return str(error)
        self.end(bag)
        return f"bag {bag}: {report.sentence()}"

    def _note(self, bag: Path) -> Path:
        return self.folder / f"{hashlib.sha256(os.fsencode(bag)).hexdigest()[:24]}.path"


def _state_folder() -> Path:
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "skinplan" / "recording"
