"""The pictures of a plan that a person wants to look at, as PNG files."""

from collections.abc import Callable
from pathlib import Path

from matplotlib.figure import Figure

from skinplan.view import coverage_picture, floor, path_pictures, reach_picture
from skinplan.view.animation import motion_gif
from skinplan.view.joints_picture import joints_figure
from skinplan.view.order_picture import order_figure
from skinplan.view.regions_picture import regions_figure
from skinplan.view.sheet import png
from skinplan.view.stage import Stage
from skinplan.view.subject import Subject
from skinplan.view.timeline_picture import timeline_figure

ANIMATION = "motion.gif"
_ANIMATION_PICTURES = 9  # it takes about as long as so many pictures

Progress = Callable[[float, str], None]


def figures(subject: Subject, stage: Stage | None = None) -> dict[str, Callable[[], Figure]]:
    """Returns what can be drawn of a subject: the name of each picture and the function that does.

    Args:
        subject: What there is to show.
        stage: Its views, when they are at hand.
    """
    stage = stage or Stage(subject)
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
        segments = (s for trajectory in subject.trajectories for s in trajectory.segments)
        if any(segment.duration_s > 0.0 for segment in segments):
            makers["joints"] = lambda: joints_figure(subject)
        if subject.cycle is not None:
            makers["timeline"] = lambda: timeline_figure(subject)
    return makers


def write_pictures(
    subject: Subject, folder: Path, progress: Progress | None = None, animate: bool = False
) -> tuple[Path, ...]:
    """Writes all pictures of a subject.

    Args:
        subject: What there is to show.
        folder: Where the PNG files go; created when missing.
        progress: Told the share done and the picture being drawn.
        animate: Also write the animation ``motion.gif``, which takes longer than all the others.

    Returns:
        The files written.

    Raises:
        InputError: An animation of a plan in which nothing moves.
        OSError: The folder can't be written.
        MeshRefusedError: The part has no side that faces a viewer.
    """
    folder.mkdir(parents=True, exist_ok=True)
    stage = Stage(subject)
    makers: dict[str, Callable[[], bytes]] = {
        f"{name}.png": lambda draw=draw: png(draw())  # type: ignore[misc]
        for name, draw in figures(subject, stage).items()
    }
    tell = progress or (lambda share, text: None)
    if animate:
        begin = len(makers) / (len(makers) + _ANIMATION_PICTURES)
        makers[ANIMATION] = lambda: motion_gif(
            stage, lambda share, text: tell(begin + share * (1.0 - begin), text)
        )
    whole = len(makers) + (_ANIMATION_PICTURES - 1 if animate else 0)
    written = []
    for number, (name, draw) in enumerate(makers.items()):
        tell(number / whole, f"picture {Path(name).stem}")
        file = folder / name
        file.write_bytes(draw())
        written.append(file)
    return tuple(written)
