"""The pictures of a plan that a person wants to look at, as PNG files."""

from collections.abc import Callable
from pathlib import Path

from matplotlib.figure import Figure

from skinplan.view import coverage_picture, floor, path_pictures, reach_picture
from skinplan.view.joints_picture import joints_figure
from skinplan.view.order_picture import order_figure
from skinplan.view.regions_picture import regions_figure
from skinplan.view.sheet import png
from skinplan.view.stage import Stage
from skinplan.view.subject import Subject
from skinplan.view.timeline_picture import timeline_figure

Progress = Callable[[float, str], None]


def figures(subject: Subject) -> dict[str, Callable[[], Figure]]:
    """Returns what can be drawn of a subject: the name of each picture and the function that does.

    Args:
        subject: What there is to show.
    """
    stage = Stage(subject)
    makers: dict[str, Callable[[], Figure]] = {"regions": lambda: regions_figure(stage)}
    if subject.path is not None:
        makers["points"] = lambda: path_pictures.points_figure(stage)
        makers["rows"] = lambda: path_pictures.rows_figure(stage)
    if subject.coverage is not None:
        makers["coverage"] = lambda: coverage_picture.coverage_figure(stage)
    if subject.path is not None and subject.station_plan is not None:
        makers["stations"] = lambda: floor.stations_figure(subject)
        makers["reach"] = lambda: reach_picture.reach_figure(stage)
    if subject.path is not None and subject.station_plan is not None and subject.trajectories:
        makers["order"] = lambda: order_figure(stage)
        if any(trajectory.segments for trajectory in subject.trajectories):
            makers["joints"] = lambda: joints_figure(subject)
        if subject.cycle is not None:
            makers["timeline"] = lambda: timeline_figure(subject)
    return makers


def write_pictures(
    subject: Subject, folder: Path, progress: Progress | None = None
) -> tuple[Path, ...]:
    """Writes all pictures of a subject.

    Args:
        subject: What there is to show.
        folder: Where the PNG files go; created when missing.
        progress: Told the share done and the picture being drawn.

    Returns:
        The files written.

    Raises:
        OSError: The folder can't be written.
        MeshRefusedError: The part has no side that faces a viewer.
    """
    folder.mkdir(parents=True, exist_ok=True)
    makers = figures(subject)
    written = []
    for number, (name, draw) in enumerate(makers.items()):
        if progress is not None:
            progress(number / len(makers), f"picture {name}")
        file = folder / f"{name}.png"
        file.write_bytes(png(draw()))
        written.append(file)
    return tuple(written)
