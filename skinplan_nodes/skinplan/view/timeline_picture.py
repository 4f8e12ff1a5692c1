"""Where the cycle time goes: driving, settling, transits, scanning; and the least it takes."""

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from skinplan.errors import InputError
from skinplan.trajectory.cycle import CycleTime
from skinplan.trajectory.model import SCAN
from skinplan.transforms import difference
from skinplan.view import palette
from skinplan.view.motion import StationMotion, station_motions
from skinplan.view.sheet import Page, Panel, draw_page
from skinplan.view.subject import Subject

DRIVE: palette.Colour = (0.55, 0.57, 0.60)
SETTLE: palette.Colour = (0.86, 0.87, 0.88)
TRANSIT: palette.Colour = (0.90, 0.62, 0.00)
SCANNING: palette.Colour = (0.00, 0.45, 0.70)
BOUND: palette.Colour = (0.00, 0.62, 0.45)
NAMES = {
    DRIVE: "the base drives", SETTLE: "settling and localisation", TRANSIT: "transit of the arm",
    SCANNING: "scan",
}  # fmt: skip
_ROW_PX = 46.0
_LEAST_PX = 90.0
_THICK = 0.62
# A number needs so many pixels of a bar.
_NUMBER_PX = 46.0
_WIDTH_PX = 1475.0
_ROOM = 1.08


@dataclass(frozen=True)
class Span:
    """A time in which one thing is done.

    Attributes:
        begin_s: Its begin on the clock of the whole cycle [s].
        end_s: Its end [s].
        colour: What is done, a key of `NAMES`.
    """

    begin_s: float
    end_s: float
    colour: palette.Colour


def timeline_figure(subject: Subject) -> Figure:
    """Draws what is done when, and how long each thing takes at each station and in sum.

    Args:
        subject: Has a station plan, trajectories and their cycle time.

    Raises:
        InputError: One of them is missing.
    """
    cycle = subject.cycle
    motions = station_motions(subject)
    if cycle is None or not motions:
        raise InputError("a picture of the cycle time needs trajectories and their cycle time")
    spans = station_spans(subject, motions)
    names = [f"station {motion.name}" for motion in motions]
    until = _ROOM * max(cycle.cycle_s, _bound(cycle), 1e-3)
    rows = len(names)
    labels = ("time of the whole cycle [s]", "")
    panels = (
        Panel(
            "what is done when",
            (0.0, until, rows - 0.5, -0.5),
            lambda axes: _draw_clock(axes, names, spans),
            labels,
            max(_ROW_PX * rows, _LEAST_PX),
        ),
        Panel(
            "how long it takes",
            (0.0, until, rows + 1.5, -0.5),
            lambda axes: _draw_sums(axes, names, spans, cycle, until),
            ("sum [s]", ""),
            _ROW_PX * (rows + 2),
        ),
    )
    title = f"{subject.part_id}: cycle time {cycle.cycle_s:.1f} s"
    return draw_page(Page(title, panels, _handles(cycle), _sentence(cycle)))


def station_spans(subject: Subject, motions: Sequence[StationMotion]) -> list[list[Span]]:
    """Returns what is done for each station: the drive to it, settling, the arm's segments.

    The way to the first station is not counted (`skinplan.trajectory.cycle`).

    Args:
        subject: Has a station plan.
        motions: Of its stations, in the order of visit.
    """
    assert subject.station_plan is not None
    stations, cell = subject.station_plan.stations, subject.cell
    result, clock = [], 0.0
    for place, motion in enumerate(motions):
        spans = []
        if place:
            ends = [stations[m.number].T_map_base_link for m in motions[place - 1 : place + 1]]
            drive_s = difference(*ends)[0] / cell.base_speed_m_s
            spans.append(Span(clock, clock + drive_s, DRIVE))
            clock += drive_s
        spans.append(Span(clock, clock + cell.settle_s, SETTLE))
        clock += cell.settle_s
        for (begin, end), kind in zip(motion.spans, motion.kinds, strict=True):
            colour = SCANNING if kind == SCAN else TRANSIT
            spans.append(Span(clock + float(begin), clock + float(end), colour))
        clock += motion.duration_s
        result.append(spans)
    return result


def sums(spans: Sequence[Span]) -> dict[palette.Colour, float]:
    """Returns how long each thing takes [s], in the order of `NAMES`."""
    return {
        colour: sum(span.end_s - span.begin_s for span in spans if span.colour == colour)
        for colour in NAMES
    }


def _draw_clock(axes: Axes, names: Sequence[str], spans: Sequence[Sequence[Span]]) -> None:
    for row, own in enumerate(spans):
        for span in own:
            axes.barh(
                row, span.end_s - span.begin_s, _THICK, left=span.begin_s, color=span.colour,
                edgecolor="white", linewidth=0.3, zorder=3,
            )  # fmt: skip
    _rows(axes, names)


def _draw_sums(
    axes: Axes,
    names: Sequence[str],
    spans: Sequence[Sequence[Span]],
    cycle: CycleTime,
    until: float,
) -> None:
    total = [span for own in spans for span in own]
    for row, own in enumerate([*spans, total]):
        left = 0.0
        for colour, length in sums(own).items():
            _bar(axes, row, left, length, colour, until)
            left += length
        _beside(axes, row, left, f"{left:.1f} s", until)
    row = len(spans) + 1
    bound = _bound(cycle)
    axes.barh(row, bound, _THICK, color=BOUND, zorder=3)
    _beside(axes, row, bound, f"{bound:.1f} s" if bound > 0.0 else "no bound known", until)
    axes.axhline(len(spans) - 0.5, color=palette.FAINT, linewidth=0.8)
    _rows(axes, [*names, "total", "least scan"])


def _bar(
    axes: Axes, row: int, left: float, length: float, colour: palette.Colour, until: float
) -> None:
    if length <= 0.0:
        return
    axes.barh(row, length, _THICK, left=left, color=colour, zorder=3)
    if length / until * _WIDTH_PX > _NUMBER_PX:
        dark = sum(colour) < 1.5
        axes.text(
            left + 0.5 * length, row, f"{length:.1f}", ha="center", va="center", fontsize=10.5,
            color="white" if dark else palette.INK, zorder=4,
        )  # fmt: skip


def _beside(axes: Axes, row: int, left: float, text: str, until: float) -> None:
    axes.text(
        left + 0.005 * until, row, text, ha="left", va="center", fontsize=11, weight="bold",
        color=palette.INK, zorder=4,
    )  # fmt: skip


def _rows(axes: Axes, names: Sequence[str]) -> None:
    axes.set_yticks(range(len(names)), names)
    axes.grid(axis="x", color=palette.SURFACE, linewidth=0.6, zorder=0)
    axes.set_axisbelow(True)


def _handles(cycle: CycleTime) -> list[Artist]:
    handles: list[Artist] = [Patch(color=colour, label=name) for colour, name in NAMES.items()]
    if _bound(cycle) > 0.0:
        label = "least scan: rows swept at the scanner's speed limit"
        handles.append(Patch(color=BOUND, label=label))
    return handles


def _bound(cycle: CycleTime) -> float:
    """Returns the lower bound of the scan [s]; 0 when none is known."""
    return cycle.lower_bound_s if cycle.lower_bound_s > 0.0 else 0.0


def _sentence(cycle: CycleTime) -> str:
    told = (
        f"Scan {cycle.scan_s:.1f} s, transits {cycle.transit_s:.1f} s with {cycle.breaks} "
        f"break{'' if cycle.breaks == 1 else 's'}, base {cycle.base_s:.1f} s. The drive to the "
        "first station is not counted."
    )
    if _bound(cycle) > 0.0:
        share = cycle.scan_s / cycle.lower_bound_s
        told += f" The scan takes {share:.2f} times its lower bound of {cycle.lower_bound_s:.1f} s."
    return told
