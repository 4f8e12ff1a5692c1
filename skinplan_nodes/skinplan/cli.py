"""The ``skinplan`` command.

Every command has ``--json`` (one document on stdout, logs on stderr), a progress bar on a terminal,
and exit code 0, 2 (bad input, named) or 1 (failed).
"""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skinplan import console
from skinplan.cell_run import CellRun, RunRequest
from skinplan.commands.bag import bag_app
from skinplan.commands.bag_export import export
from skinplan.commands.calibrate import calibrate_camera
from skinplan.commands.calibration import calibration_app
from skinplan.commands.jobs import jobs_app
from skinplan.commands.markers import markers
from skinplan.commands.replay import replay
from skinplan.contact.command import contact
from skinplan.errors import InputError, MeshError, PartNotFoundError
from skinplan.inspection.gaps import seen_points
from skinplan.inspection.report import write_report
from skinplan.mesh.check import check_mesh
from skinplan.mesh.load import load_mesh, read_mesh
from skinplan.mesh.model import Finding
from skinplan.part.model import Part
from skinplan.part.resolve import resolve_part
from skinplan.part.samples import SAMPLE_TITLES, SAMPLES, write_sample
from skinplan.pipeline import STAGES, Plan, check_strategies, plan_part
from skinplan.plan_record import write_json
from skinplan.robot.cell import CellConfig, load_cell
from skinplan.summary_rows import plan_rows, run_rows

if TYPE_CHECKING:
    from skinplan.view.show import Shown

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Plans and runs the 3-D measurement of large skins with a mobile manipulator.",
)
app.command()(contact)
app.command()(markers)
app.command()(replay)
app.command("calibrate")(calibrate_camera)
parts_app = typer.Typer(invoke_without_command=True, help="List and export the sample parts.")
app.add_typer(parts_app, name="parts")
app.add_typer(bag_app, name="bag")
app.add_typer(jobs_app, name="jobs")
app.add_typer(calibration_app, name="calibration")
bag_app.command("export")(export)

PartArgument = Annotated[
    str,
    typer.Argument(
        help="A sample's name, a part.yaml, or a mesh file with --unit.", show_default=False
    ),
]
UnitOption = Annotated[
    str | None,
    typer.Option("--unit", help="Unit of a mesh file: m, mm, cm or inch; STEP has its own."),
]
CellOption = Annotated[
    Path | None, typer.Option("--cell", help="Cell file; without it the default cell.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout.")]
StrategyOption = Annotated[
    str | None, typer.Option(help="Scan path strategy; without it the part file's.")
]
StationOption = Annotated[
    str | None, typer.Option(help="Station strategy; without it the part file's.")
]
OrderOption = Annotated[
    str | None, typer.Option(help="Order strategy; without it the part file's.")
]
TimingOption = Annotated[
    str | None, typer.Option(help="Timing: toppra or bezier; without it the part file's.")
]
RunsOption = Annotated[Path, typer.Option("--runs", help="Folder that holds the runs.")]


@parts_app.callback()
def parts(context: typer.Context, as_json: JsonOption = False) -> None:
    """List the sample parts."""
    if context.invoked_subcommand is not None:
        return
    with console.command(as_json):
        rows = [(name, _sample_title(name)) for name in SAMPLES]
        if as_json:
            console.print_json(
                {"samples": [{"name": name, "title": title} for name, title in rows]}
            )
        else:
            console.print_table("Sample parts", ("name", "part"), rows)


@parts_app.command("export")
def export_part(
    name: Annotated[str, typer.Argument(help="A sample's name.")],
    folder: Annotated[Path, typer.Argument(help="Where to write the mesh and part.yaml.")],
    as_json: JsonOption = False,
) -> None:
    """Write a sample's mesh and part file to a folder."""
    with console.command(as_json):
        if name not in SAMPLES:
            raise PartNotFoundError(
                f"sample part {name!r} was asked for; accepted are {', '.join(SAMPLES)}"
            )
        part = write_sample(name, folder)
        document = {
            "part": str(part.source),
            "mesh": str(part.mesh_path),
            "sha256": part.mesh_sha256,
        }
        if as_json:
            console.print_json(document)
        else:
            typer.echo(f"{document['part']}\n{document['mesh']}")


@app.command()
def check(
    mesh: Annotated[Path, typer.Argument(help="Mesh file: STL, PLY, OBJ or STEP.")],
    unit: Annotated[str, typer.Option(help="Unit of the file: m, mm, cm or inch.")] = "m",
    as_json: JsonOption = False,
) -> None:
    """Say what is wrong with a mesh, and what would be done about it."""
    with console.command(as_json):
        try:
            loaded, noticed = read_mesh(mesh, unit)
            repaired, found = check_mesh(loaded)
        except MeshError as error:
            if not as_json:
                _show_findings(error.findings)
            raise
        findings = noticed + found
        size = repaired.bounds[1] - repaired.bounds[0]
        if as_json:
            console.print_json(
                {
                    "triangles": len(repaired.faces),
                    "area_m2": repaired.area,
                    "size_m": size,
                    "sha256": loaded.sha256,
                    "findings": [vars(finding) for finding in findings],
                }
            )
            return
        typer.echo(
            f"{mesh}: {len(repaired.faces)} triangles, {repaired.area:.3f} m², "
            f"{size[0]:.3f} × {size[1]:.3f} × {size[2]:.3f} m"
        )
        if findings:
            _show_findings(findings)
        else:
            typer.echo("no findings")


def _show_findings(findings: tuple[Finding, ...]) -> None:
    rows = [
        (
            found.name,
            found.count,
            found.action,
            ", ".join(f"{value:.3f}" for value in found.where[0]) if found.where else "",
            found.detail,
        )
        for found in findings
    ]
    if rows:
        header = ("finding", "count", "action", "at (m)", "detail")
        console.print_table("Findings", header, rows)


@app.command()
def plan(
    part: PartArgument,
    unit: UnitOption = None,
    cell: CellOption = None,
    strategy: StrategyOption = None,
    stations: StationOption = None,
    order: OrderOption = None,
    timing: TimingOption = None,
    optimise_passes: Annotated[
        bool,
        typer.Option("--optimise-passes", help="Optimise depth and angles of the scan passes."),
    ] = False,
    until: Annotated[
        str, typer.Option(help="Last stage: scan_path, coverage, stations or trajectory.")
    ] = "trajectory",
    rescan: Annotated[
        Path | None,
        typer.Option(help="Plan only what this run (its folder, or a PLY cloud) left out."),
    ] = None,
    without_markers: Annotated[
        bool,
        typer.Option(
            "--without-markers", help="The part's place is known: no station has to see markers."
        ),
    ] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for the plan's JSON files.")] = None,
    view: Annotated[
        bool, typer.Option("--view", help="Write pictures to --out, or else to plan-PART/.")
    ] = False,
    animate: Annotated[
        bool, typer.Option("--animate", help="As --view, and the arm in motion as motion.gif.")
    ] = False,
    browser: Annotated[
        bool, typer.Option("--browser", help="Serve a 3-D view to this machine until Ctrl+C.")
    ] = False,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port of the 3-D view; 0 = any free one.")
    ] = 8080,
    as_json: JsonOption = False,
) -> None:
    """Plan a part at its nominal place, without ROS."""
    with console.command(as_json):
        asked = _with_strategies(resolve_part(part, unit), strategy, stations, order, timing)
        if optimise_passes:
            asked = replace(asked, scan=replace(asked.scan, optimise_passes=True))
        config = load_cell(cell)
        seen = None if rescan is None else seen_points(rescan)
        view_port = _viewer_port(port) if browser else None
        if animate:
            _require_motion(until)
        with console.progress_bar(f"plan {asked.id}") as progress:
            made = plan_part(
                asked, config, progress, until=until, seen=seen, markers=not without_markers
            )
        summary = made.summary()
        if out is not None:
            made.write(out)
            write_json(out / "summary.json", summary)
        if not (view or animate or browser):
            _print_plan(asked, summary, out, as_json)
            return
        pictures = (out or Path(f"plan-{asked.id}")) if view or animate else None
        with _shown(made, config, pictures, view_port, animate) as views:
            _print_plan(asked, {**summary, "view": views.document()}, out, as_json)
            views.wait()


@app.command()
def run(
    part: PartArgument,
    unit: UnitOption = None,
    cell: CellOption = None,
    runs: RunsOption = Path("runs"),
    strategy: StrategyOption = None,
    stations: StationOption = None,
    order: OrderOption = None,
    timing: TimingOption = None,
    time_factor: Annotated[
        float, typer.Option(min=0.1, max=50.0, help="Times faster than real time.")
    ] = 5.0,
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of every random draw of the mock cell.")
    ] = 1,
    as_json: JsonOption = False,
) -> None:
    """Start the graph on the mock cell, measure a part, record the run."""
    with console.command(as_json):
        asked = resolve_part(part, unit)
        _refuse_bad_mesh(asked)
        asked = _with_strategies(asked, strategy, stations, order, timing)
        load_cell(cell)
        request = RunRequest(asked, runs.absolute(), cell, time_factor, seed)
        with console.progress_bar(f"run {asked.id}") as progress:
            outcome = CellRun(request).measure(progress)
        if as_json:
            console.print_json(outcome.document())
        else:
            console.print_table("Run", ("what", "value"), run_rows(outcome.document()))
        if not outcome.ended:
            console.stderr.print(f"[bold red]skinplan:[/] {outcome.error}", soft_wrap=True)
            raise typer.Exit(console.EXIT_FAILED)


@app.command()
def report(
    run_folder: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run.")],
    as_json: JsonOption = False,
) -> None:
    """Write report.html of a run."""
    with console.command(as_json):
        if not run_folder.is_dir():
            raise InputError(f"a report of {run_folder} was asked for; there is no such folder")
        path = write_report(run_folder)
        if as_json:
            console.print_json({"report": str(path)})
        else:
            typer.echo(str(path))


def main() -> None:
    """Entry point of the command."""
    app()


def _sample_title(name: str) -> str:
    return SAMPLE_TITLES[name]


def _with_strategies(
    part: Part,
    strategy: str | None,
    stations: str | None,
    order: str | None,
    timing: str | None,
) -> Part:
    scan = replace(
        part.scan,
        strategy=strategy or part.scan.strategy,
        station_strategy=stations or part.scan.station_strategy,
        order_strategy=order or part.scan.order_strategy,
        timing=timing or part.scan.timing,
    )
    check_strategies(scan)
    return replace(part, scan=scan)


def _refuse_bad_mesh(part: Part) -> None:
    check_mesh(load_mesh(part.mesh_path, part.unit))


def _viewer_port(port: int) -> int:
    """Refuses what the 3-D view can't be served with before the long work begins."""
    from skinplan.view.browser import require_viewer

    require_viewer(port)
    return port


def _require_motion(until: str) -> None:
    """Refuses an animation of a plan without trajectories before the long work begins."""
    if until != STAGES[-1]:
        raise InputError(
            f"--animate was asked for with --until {until}; it needs --until {STAGES[-1]}"
        )


def _shown(
    made: Plan, config: CellConfig, pictures: Path | None, port: int | None, animate: bool
) -> "Shown":
    # Drawing takes long to load and most commands do not draw.
    from skinplan.view.show import show_plan

    with console.progress_bar(f"view {made.part.id}") as progress:
        views = show_plan(made, config, pictures, port, progress, animate)
    if views.note:
        console.stderr.print(views.note, soft_wrap=True)
    return views


def _print_plan(part: Part, summary: dict[str, Any], out: Path | None, as_json: bool) -> None:
    if as_json:
        console.print_json(summary)
        return
    _show_plan(part, summary, out)
    views = summary.get("view", {})
    for picture in views.get("pictures", ()):
        typer.echo(f"picture {picture}")
    if views.get("url"):
        typer.echo(f"3-D view at {views['url']} (Ctrl+C ends it)")


def _show_plan(part: Part, summary: dict[str, Any], out: Path | None) -> None:
    console.print_table(f"Plan of {part.id}", ("what", "value"), plan_rows(summary))
    if out is not None:
        typer.echo(f"written to {out}")


if __name__ == "__main__":
    main()
