"""``skinplan calibration``: the facts about the calibration of a cell."""

from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Annotated

import typer

from skinplan import console
from skinplan.errors import InputError
from skinplan.robot.calibration import (
    NAMES,
    CalibrationFact,
    calibration_path,
    load_calibration,
    note_calibration,
)

calibration_app = typer.Typer(
    no_args_is_help=True, help="Show and note the facts about a cell's calibration."
)

CellArgument = Annotated[Path, typer.Argument(help="The cell file.", show_default=False)]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout.")]
DEFAULT_DAYS = 90


@calibration_app.command()
def show(cell: CellArgument, as_json: JsonOption = False) -> None:
    """Say what a cell is calibrated for, and until when."""
    with console.command(as_json):
        print_facts(load_calibration(calibration_path(cell), datetime.now(UTC)), as_json)


@calibration_app.command()
def note(
    cell: CellArgument,
    name: Annotated[str, typer.Argument(help=f"One of {', '.join(NAMES)}.", show_default=False)],
    file: Annotated[
        Path, typer.Argument(help="What the calibration has left.", show_default=False)
    ],
    residual: Annotated[float, typer.Option(min=0.0, help="What was left over.")],
    unit: Annotated[str, typer.Option(help="Of the residual, e.g. m or px.")] = "m",
    made: Annotated[str, typer.Option("--date", help="When; without it the file's time.")] = "",
    due: Annotated[
        str, typer.Option(help=f"Last day; without it {DEFAULT_DAYS} days after the date.")
    ] = "",
    as_json: JsonOption = False,
) -> None:
    """Note a calibration beside the cell file."""
    with console.command(as_json):
        path = calibration_path(cell)
        assert path is not None
        when = _moment(made) if made else _time_of(file)
        last = _moment(due).date() if due else default_due(when)
        note_calibration(path, name, file, when, last, residual, unit)
        print_facts(load_calibration(path, datetime.now(UTC)), as_json)


def default_due(made: datetime, days: int = DEFAULT_DAYS) -> date:
    """Returns the last day of a calibration."""
    return (made + timedelta(days=days)).date()


def print_facts(facts: tuple[CalibrationFact, ...], as_json: bool) -> None:
    """Prints facts."""
    if as_json:
        console.print_json({"calibration": [fact.document() for fact in facts]})
        return
    rows = [
        (
            fact.name,
            fact.state,
            fact.date,
            fact.due,
            "" if fact.residual is None else f"{fact.residual:g} {fact.unit}",
            fact.reason or fact.file,
        )
        for fact in facts
    ]
    header = ("calibration", "state", "date", "due", "residual", "file")
    console.print_table("Calibration", header, rows)


def _moment(text: str) -> datetime:
    try:
        found = datetime.fromisoformat(text)
    except ValueError as error:
        raise InputError(
            f"{text!r} was given as a time; 2026-11-03 or 2026-11-03T08:15:00Z is accepted"
        ) from error
    return found.replace(tzinfo=UTC) if found.tzinfo is None else found


def _time_of(file: Path) -> datetime:
    if not file.is_file():
        raise InputError(f"{file} was to be noted; a file that exists is accepted")
    return datetime.fromtimestamp(file.stat().st_mtime, UTC)
