"""Whether the cell makes sure that the part on the fixture is the one that the job says.

::

    recognition:
      check: true                    # before anything is planned; left out: not checked
      others: [../rib/part.yaml]     # what else may stand there, so that it can be named; relative
          to the part file, or absolute
"""

from dataclasses import dataclass
from pathlib import Path

from skinplan.part.fields import Fields

_KEYS = ("check", "others")
_MOST = 50
_ACCEPTED = f"a list of up to {_MOST} paths of part files, each once"


@dataclass(frozen=True)
class RecognitionPlan:
    """Whether and against what the part is checked.

    Attributes:
        check: The part is identified before it is measured.
        others: Part files of what else may stand on the fixture, absolute.
    """

    check: bool = False
    others: tuple[Path, ...] = ()


def read_recognition(values: object, folder: Path, source: str) -> RecognitionPlan:
    """Reads the key ``recognition`` of a part file.

    Args:
        values: What stands there.
        folder: Of the part file.
        source: Its name, for messages.

    Raises:
        PartInvalidError: A key is unknown, or a value is out of range. Whether the other part
            files can be read shows when they are needed.
    """
    fields = Fields(values, "recognition", source, _KEYS)
    check = fields.flag("check") if fields.has("check") else False
    listed = fields.values.get("others") or []
    if not isinstance(listed, list) or len(listed) > _MOST:
        raise fields.error("others", f"{str(listed)[:60]!r}", _ACCEPTED)
    for name in listed:
        if not isinstance(name, str) or not name.strip() or "\0" in name:
            raise fields.error("others", f"{str(name)[:60]!r}", _ACCEPTED)
    others = tuple((folder / name).resolve() for name in listed)
    if len(set(others)) != len(others):
        raise fields.error("others", "a path twice", _ACCEPTED)
    return RecognitionPlan(check, others)


def recognition_fields(plan: RecognitionPlan) -> dict[str, object]:
    """Returns a plan in the form in which `read_recognition` reads it."""
    return {"check": plan.check, "others": [str(path) for path in plan.others]}
