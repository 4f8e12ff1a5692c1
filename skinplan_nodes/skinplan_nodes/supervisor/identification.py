"""What stands on the fixture, as a job is told, and what becomes of it. Needs no ROS."""

from dataclasses import dataclass

from skinplan_nodes.supervisor.control import StepError

_WRONG_PART, _UNKNOWN_PART = 904, 900
RECOGNIZER = "part_recognizer"
#: Keys of ``identification`` in ``summary.json``.
IDENTIFICATION_KEYS = ("part", "fits", "alike", "seen_ratio", "text")


@dataclass(frozen=True)
class Identified:
    """Answer of the recognizer.

    Attributes:
        fits: Whether it may be the job's part, and each of the others.
        names: Their ids, in the same order.
        seen_ratio: Share of the job's part that the answer rests on [1].
        text: The answer as a sentence.
    """

    fits: tuple[bool, ...]
    names: tuple[str, ...]
    seen_ratio: float
    text: str

    @property
    def alike(self) -> tuple[str, ...]:
        """The others that it may be as well."""
        return tuple(name for name, fits in zip(self.names[1:], self.fits[1:], strict=True) if fits)

    def require(self) -> None:
        """Refuses another part than the job's.

        Raises:
            StepError: Another part, by name, or one that is not known.
        """
        if self.fits[0]:
            return
        asked = self.names[0]
        if self.alike:
            found = " or ".join(self.alike)
            text = f"the job is for part {asked}, on the fixture is {found} ({self.text})"
            raise StepError(_WRONG_PART, text, RECOGNIZER)
        text = f"the job is for part {asked}, on the fixture is another one: {self.text}"
        raise StepError(_UNKNOWN_PART, text, RECOGNIZER)

    def document(self) -> dict[str, object]:
        """Returns the answer as ``identification`` of ``summary.json`` has it."""
        found = (self.names[0], self.fits[0], list(self.alike), self.seen_ratio, self.text)
        return dict(zip(IDENTIFICATION_KEYS, found, strict=True))
