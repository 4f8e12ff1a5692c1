"""The command ``skinplan markers``: printable sheets of a fixture's markers."""

from pathlib import Path
from typing import Annotated

import typer

from skinplan import console
from skinplan.errors import PartInvalidError
from skinplan.localization.sheets import FORMATS, PAPERS_MM, marker_sheet, write_sheets
from skinplan.part.fixture_file import load_fixture, read_yaml
from skinplan.part.model import Fixture
from skinplan.part.resolve import resolve_part


def markers(
    source: Annotated[
        str,
        typer.Argument(
            metavar="FIXTURE",
            help="A fixture file, a part.yaml or a sample's name.",
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the sheets.")] = Path("markers"),
    kind: Annotated[str, typer.Option("--format", help=f"{' or '.join(FORMATS)}.")] = "pdf",
    paper: Annotated[
        str, typer.Option(help=f"{', '.join(PAPERS_MM)}; without it the smallest that fits.")
    ] = "",
    only: Annotated[
        list[int] | None, typer.Option("--id", help="Only this marker; may be repeated.")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON document on stdout.")
    ] = False,
) -> None:
    """Write printable sheets of a fixture's markers at true scale, with a ruler to check."""
    with console.command(as_json):
        fixture = _fixture_of(source)
        if not fixture.markers:
            raise PartInvalidError(
                f"sheets were asked for, but {source} says that its fixture has no markers; a "
                "fixture with markers is accepted"
            )
        known = [marker.id for marker in fixture.markers]
        unknown = sorted(set(only or ()) - set(known))
        if unknown:
            raise PartInvalidError(
                f"markers {unknown} were asked for; accepted are those of {source}: {known}"
            )
        wanted = [marker for marker in fixture.markers if not only or marker.id in only]
        sheets = [marker_sheet(fixture, marker, paper) for marker in wanted]
        paths = write_sheets(sheets, out, kind)
        if as_json:
            console.print_json(
                {
                    "dictionary": fixture.dictionary,
                    "files": [str(path) for path in paths],
                    "sheets": [
                        {"id": s.marker_id, "size_mm": s.side_mm, "paper": s.paper} for s in sheets
                    ],
                }
            )
            return
        rows = [(s.marker_id, f"{s.side_mm:g}", s.paper) for s in sheets]
        console.print_table(f"Markers of {source}", ("id", "side (mm)", "paper"), rows)
        for path in paths:
            typer.echo(str(path))
        typer.echo("print at 100 %, then measure the ruler and the black square")


def _fixture_of(source: str) -> Fixture:
    """Reads a fixture file where it is one, and a part otherwise."""
    path = Path(source)
    if path.suffix in (".yaml", ".yml") and path.is_file():
        values = read_yaml(path)
        if isinstance(values, dict) and "markers" in values:
            return load_fixture(path)
    return resolve_part(source).fixture
