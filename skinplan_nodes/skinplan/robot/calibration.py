"""Facts about the calibration of a cell: a YAML file beside the cell file.

``cell.calibration.yaml`` stands beside ``cell.yaml``. Each entry names the file that the
calibration has left, and is about that file only: another one under the same name is not
calibrated. Unknown keys are refused::

    hand_eye:                                # camera against arm base
      file: hand_eye-20261103.json           # relative to this file, or absolute
      sha256: 0123...                        # of that file
      date: 2026-11-03T08:15:00Z             # when it was made
      due: 2027-02-01                        # valid until the end of this day (UTC)
      residual: 0.00031
      unit: m
    tool: {...}                              # scanner and its targets against the flange
    tracker_position: {...}                  # tracker in the shop
    camera: {...}                            # focal lengths, centre, distortion
"""

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from datetime import UTC, date, datetime, time
from pathlib import Path
from typing import Any

import yaml

from skinplan.errors import CalibrationInvalidError, PartInvalidError
from skinplan.part.fields import Fields
from skinplan.part.fixture_file import read_yaml
from skinplan.whole_file import whole_file

#: What a cell is calibrated for.
NAMES = ("hand_eye", "tool", "tracker_position", "camera")
VALID, DUE, MISSING = "valid", "due", "missing"
_KEYS = ("file", "sha256", "date", "due", "residual", "unit")
_LONGEST_UNIT = 16
_LENGTH_OF_DAY = len("2026-11-03")
_LARGEST_FILE_BYTES = 50_000_000


@dataclass(frozen=True)
class CalibrationFact:
    """One calibration.

    Attributes:
        name: One of `NAMES`.
        file: Absolute path of what it has left; empty = there is none.
        sha256: Hash of that file, as it was noted.
        date: When it was made, ISO 8601 in UTC; empty = not noted.
        due: Until when it is valid, ISO 8601 in UTC; empty = not noted.
        residual: What was left over, in `unit`; None = not noted.
        unit: Of the residual.
        state: ``valid``, ``due`` (out of date) or ``missing``.
        reason: Why it is missing; empty = it is not.
    """

    name: str
    file: str = ""
    sha256: str = ""
    date: str = ""
    due: str = ""
    residual: float | None = None
    unit: str = ""
    state: str = MISSING
    reason: str = "no entry"

    def document(self) -> dict[str, Any]:
        """Returns the entry of ``calibration`` in ``summary.json``."""
        values = asdict(self)
        del values["reason"]
        return values


def calibration_path(cell_file: Path | str | None) -> Path | None:
    """Returns where the facts about a cell stand; None = nowhere, for the default cell."""
    if not cell_file:
        return None
    return Path(cell_file).with_suffix(".calibration.yaml")


def load_calibration(path: Path | None, now: datetime) -> tuple[CalibrationFact, ...]:
    """Reads the facts about a cell.

    Args:
        path: The file; None, or one that does not exist = nothing is calibrated.
        now: The time, for the states.

    Returns:
        One fact for each of `NAMES`, in their order.

    Raises:
        CalibrationInvalidError: An unknown key, or a value that can't be used.
    """
    if path is None or not path.is_file():
        return tuple(CalibrationFact(name) for name in NAMES)
    try:
        fields = Fields(read_yaml(path, "calibration") or {}, "", path.name, NAMES)
        return tuple(_fact(fields, name, path.parent, now) for name in NAMES)
    except PartInvalidError as error:  # the reader of part files is used for the keys
        raise CalibrationInvalidError(str(error)) from error


def note_calibration(
    path: Path, name: str, file: Path, made: datetime, due: date, residual: float, unit: str
) -> CalibrationFact:
    """Writes a fact about a cell, in the place of an earlier one of that name.

    Args:
        path: The file of facts; made when it does not exist.
        name: One of `NAMES`.
        file: What the calibration has left.
        made: When.
        due: Until the end of this day it is valid.
        residual: What was left over.
        unit: Of the residual.

    Raises:
        CalibrationInvalidError: Another name, no such file, or a file of facts that can't be used.
    """
    if name not in NAMES:
        raise CalibrationInvalidError(
            f"calibration {name!r} was to be noted; accepted are {', '.join(NAMES)}"
        )
    digest = _sha256(file)
    if digest is None:
        raise CalibrationInvalidError(f"{file} was to be noted; a file that exists is accepted")
    load_calibration(path, made)
    known = read_yaml(path, "calibration") if path.is_file() else {}
    document = dict(known) if isinstance(known, Mapping) else {}
    beside = file.resolve().parent == path.resolve().parent
    document[name] = {
        "file": file.name if beside else str(file.resolve()),
        "sha256": digest,
        "date": made.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "due": due.isoformat(),
        "residual": float(residual),
        "unit": unit,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary:
        temporary.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
    return load_calibration(path, made)[NAMES.index(name)]


def _fact(fields: Fields, name: str, folder: Path, now: datetime) -> CalibrationFact:
    if not fields.has(name):
        return CalibrationFact(name)
    entry = Fields(fields.values[name], name, fields.source, _KEYS)
    file = folder / entry.text("file", "the path of a file")
    made, due = _moment(entry, "date", time.min), _moment(entry, "due", time.max)
    unit = entry.text("unit", "a unit, e.g. m") if entry.has("unit") else ""
    if len(unit) > _LONGEST_UNIT:
        raise entry.error("unit", repr(unit[:_LONGEST_UNIT]), f"up to {_LONGEST_UNIT} characters")
    residual = None
    if entry.has("residual"):
        residual = entry.number("residual", 0.0, 1e9, "a number from 0 on")
    stated = entry.text("sha256").lower() if entry.has("sha256") else ""
    found = CalibrationFact(
        name, str(file.resolve()), stated, _iso(made), _iso(due), residual, unit, VALID, ""
    )
    return _judged(found, file, due, now)


def _judged(fact: CalibrationFact, file: Path, due: datetime, now: datetime) -> CalibrationFact:
    digest = _sha256(file)
    if digest is None:
        return replace(fact, state=MISSING, reason=f"{file} is no file that can be read")
    if fact.sha256 and fact.sha256 != digest:
        reason = f"{file} is another file than the one that was noted"
        return replace(fact, state=MISSING, reason=reason)
    return replace(fact, sha256=digest, state=DUE if now > due else VALID)


def _moment(entry: Fields, key: str, of_day: time) -> datetime:
    accepted = "a day or a time, e.g. 2026-11-03 or 2026-11-03T08:15:00Z"
    value = entry.values.get(key)
    if isinstance(value, str):
        kind = date if len(value) == _LENGTH_OF_DAY else datetime
        try:
            value = kind.fromisoformat(value)
        except ValueError:
            value = None
    if isinstance(value, date) and not isinstance(value, datetime):
        value = datetime.combine(value, of_day.replace(microsecond=0))
    if not isinstance(value, datetime):
        raise entry.error(key, repr(entry.values.get(key))[:80], accepted)
    return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


def _iso(moment: datetime) -> str:
    return moment.strftime("%Y-%m-%dT%H:%M:%SZ")


def _sha256(file: Path) -> str | None:
    try:
        if not file.is_file() or file.stat().st_size > _LARGEST_FILE_BYTES:
            return None
        with file.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except (OSError, ValueError):
        return None
