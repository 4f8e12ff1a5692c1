"""The command ``skinplan contact``: stations, tracker and motions for a touch probe."""

from pathlib import Path
from typing import Annotated, Any

import typer

from skinplan import console
from skinplan.contact.document import contact_document, figure_rows, station_rows
from skinplan.contact.model import ContactPlan
from skinplan.contact.plan import plan_contact
from skinplan.errors import InspectionPointsError
from skinplan.mesh.load import load_mesh
from skinplan.part.model import Part
from skinplan.part.resolve import resolve_part
from skinplan.plan_record import write_json

_LONG = ("points", "motions")


def contact(
    part: Annotated[
        str,
        typer.Argument(
            help="A sample's name or a part.yaml with measuring points.", show_default=False
        ),
    ],
    out: Annotated[Path | None, typer.Option(help="Folder for contact.json.")] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON document on stdout.")
    ] = False,
) -> None:
    """Plan contact measurement of a part's points: arm with touch probe, T-Mac and tracker."""
    with console.command(as_json):
        asked = resolve_part(part)
        with console.progress_bar(f"contact {asked.id}") as progress:
            progress(0.0, "stations, tracker, motions")
            document = contact_document(plan_part_contact(asked), asked)
            progress(1.0, "done")
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            write_json(out / "contact.json", document)
        if as_json:
            console.print_json({key: document[key] for key in document if key not in _LONG})
        else:
            _show(document, out)


def plan_part_contact(part: Part) -> ContactPlan:
    """Plans contact measurement of a part with measuring points.

    The whole mesh counts as obstacle, as it is in the file: the mesh doctor would keep one side of
    a closed solid only.

    Raises:
        InspectionPointsError: The part has no measuring points, or its y axis is not level.
        NothingReachedError: No point is reached from anywhere.
        NoTrackerStationError: No candidate sees all points that are reached.
        MeshError: The mesh can't be read.
    """
    if part.points is None:
        raise InspectionPointsError(
            f"a contact plan of {part.id} was asked for, which gives no measuring points; a part "
            "file with the key 'points' is accepted, for example the sample engine"
        )
    mesh = load_mesh(part.mesh_path, part.unit)
    return plan_contact(part.points.targets, part.points.normals, mesh, part.T_map_workpiece)


def _show(document: dict[str, Any], out: Path | None) -> None:
    console.print_table(
        f"Stations of {document['part']}",
        ("station", "x (m)", "y (m)", "k", "reached", "measured"),
        station_rows(document),
    )
    console.print_table("Contact plan", ("what", "value"), figure_rows(document))
    typer.echo(f"hash {document['hash'][:16]}")
    if out is not None:
        typer.echo(f"written to {out / 'contact.json'}")
