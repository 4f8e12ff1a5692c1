"""What healing a bag did, and what was lost."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class HealedFile:
    """What was done with one file.

    Attributes:
        path: The file.
        healed: It was written anew; False = it was in order.
        messages: Messages that it holds.
        start_ns: Log time of the first message [ns]; 0 without messages.
        end_ns: Log time of the last message [ns]; 0 without messages.
        bytes_before: Size before [B].
        bytes_lost: Bytes of records that could not be used [B].
        messages_undescribed: Messages whose channel is described nowhere any more.
        damaged: Places in the middle that were damaged: begin and size [B].
        kept: The old file, where something in the middle was damaged.
    """

    path: Path
    healed: bool
    messages: int
    start_ns: int
    end_ns: int
    bytes_before: int
    bytes_lost: int = 0
    messages_undescribed: int = 0
    damaged: tuple[tuple[int, int], ...] = ()
    kept: Path | None = None

    def sentence(self) -> str:
        """Says what was lost."""
        if not self.healed:
            return f"{self.path.name}: in order, {self.messages} messages"
        text = (
            f"{self.path.name}: healed, {self.messages} messages up to log time {self.end_ns} ns, "
            f"{self.bytes_lost} of {self.bytes_before} bytes lost"
        )
        if self.messages_undescribed:
            text += f", {self.messages_undescribed} messages of topics without description lost"
        if self.kept is not None:
            text += f", {len(self.damaged)} places damaged, the old file is {self.kept.name}"
        return text


@dataclass(frozen=True)
class HealReport:
    """What was done with a bag.

    Attributes:
        path: Bag folder or file.
        files: Its files in the order of recording.
        metadata_rebuilt: ``metadata.yaml`` was written anew.
    """

    path: Path
    files: tuple[HealedFile, ...]
    metadata_rebuilt: bool

    @property
    def healed(self) -> bool:
        """Whether anything was done."""
        return self.metadata_rebuilt or any(file.healed for file in self.files)

    def sentence(self) -> str:
        """Says what was lost."""
        return "; ".join(file.sentence() for file in self.files)
