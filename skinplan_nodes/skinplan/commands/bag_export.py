"""``skinplan bag export``: tables, clouds and videos of a bag."""

from pathlib import Path
from typing import Annotated

import typer

from skinplan import console
from skinplan.recording.export import CLOUD_FORMATS, TABLE_FORMATS, WHAT, export_bag


def export(
    bag: Annotated[Path, typer.Argument(help="Folder of a bag, or a storage file.")],
    folder: Annotated[Path, typer.Argument(help="Where to write the files.")],
    what: Annotated[
        list[str] | None,
        typer.Option("--what", help=f"One of {', '.join(WHAT)}; repeatable, all without it."),
    ] = None,
    tables: Annotated[
        str, typer.Option("--tables", help=f"Format of tables: {' or '.join(TABLE_FORMATS)}.")
    ] = "csv",
    clouds: Annotated[
        str, typer.Option("--clouds", help=f"Format of clouds: {' or '.join(CLOUD_FORMATS)}.")
    ] = "ply",
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON document on stdout.")
    ] = False,
) -> None:
    """Write a bag's trajectories, poses, quality, coverage, cloud and camera to files."""
    with console.command(as_json):
        with console.progress_bar("export") as progress:
            found = export_bag(bag, folder, what or WHAT, tables, clouds, progress)
        if as_json:
            files = [{"path": str(item.path), "items": item.items} for item in found]
            console.print_json({"bag": str(bag), "files": files})
        elif found:
            rows = [(str(item.path), item.items) for item in found]
            console.print_table(f"Export of {bag}", ("file", "rows, points or images"), rows)
        else:
            typer.echo("nothing of that is in the bag")
