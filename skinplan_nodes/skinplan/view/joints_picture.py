"""How near the arm comes to its limits: joint positions, velocities, accelerations, and the speed.

All joints share one axis as shares of their limits: 1 and -1 are the limits.
"""

from collections.abc import Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from skinplan.errors import InputError
from skinplan.trajectory.model import SCAN
from skinplan.transforms import Array
from skinplan.view import palette
from skinplan.view.motion import StationMotion, station_motions
from skinplan.view.sheet import Page, Panel, draw_page
from skinplan.view.subject import Subject

MOST_STATIONS = 6
LIMIT: palette.Colour = (0.75, 0.05, 0.10)
SCAN_SHADE: palette.Colour = (0.85, 0.93, 0.87)
TRANSIT_SHADE: palette.Colour = (0.95, 0.95, 0.96)
_COLOURS = (*palette.SERIES[:6],)
_CHART_PX = 150.0
_QUANTITIES = ("position", "velocity", "acceleration")
_ROOM = 1.12
_SPEEDS = 2.0  # the axis of the speed ends at so many times the limit


def joints_figure(subject: Subject) -> Figure:
    """Draws joints and scanner speed of each station against their limits, over time.

    Args:
        subject: Has trajectories.

    Raises:
        InputError: There is no trajectory with a motion.
    """
    motions = [motion for motion in station_motions(subject) if motion.duration_s > 0.0]
    if not motions:
        raise InputError("a picture of the joints needs a trajectory with a motion")
    shown = motions[:MOST_STATIONS]
    charts = [_charts(subject, motion, _speed_top(subject, motions)) for motion in shown]
    panels: list[Panel] = []
    for start in range(0, len(charts), 2):
        # Two stations beside each other; one that is left over takes both columns.
        pair = charts[start : start + 2]
        panels += [chart for together in zip(*pair, strict=True) for chart in together]
    caption = (
        "Shares of the limits: a position of 1 is the upper joint limit, -1 the lower one. "
        "Accelerations are means between samples. The speed limit of the scanner holds while it "
        "scans."
    )
    if len(shown) < len(motions):
        caption += f" Stations after the first {len(shown)} are not shown, but counted."
    title = f"{subject.part_id}: joints and speed against their limits"
    handles = _handles(subject, motions)
    return draw_page(Page(title, tuple(panels), handles, caption, columns=2))


def position_shares(motion: StationMotion) -> Array:
    """Returns joint positions at the samples, 1 = upper limit, -1 = lower limit, shape (t, 6)."""
    arm = motion.arm
    middle, half = 0.5 * (arm.upper + arm.lower), 0.5 * (arm.upper - arm.lower)
    return np.asarray((motion.positions - middle) / half)


def velocity_shares(motion: StationMotion) -> Array:
    """Returns joint velocities at the samples as shares of their limits, shape (t, 6)."""
    return np.asarray(motion.velocities / motion.arm.velocity)


def acceleration_shares(motion: StationMotion, limit_rad_s2: float) -> Array:
    """Returns joint accelerations between samples as shares of a limit [rad/s^2], shape (m, 6)."""
    return motion.accelerations[1] / limit_rad_s2


def scan_speed(motion: StationMotion) -> float:
    """Returns the largest speed of the scanner while it scans [m/s]; 0 when it never does."""
    scanning = motion.kinds[motion.owners] == SCAN
    return float(motion.speeds[scanning].max(initial=0.0))


def _speed_top(subject: Subject, motions: Sequence[StationMotion]) -> float:
    """Returns where the axis of the speed ends [m/s]: fast transits would flatten the scans."""
    fastest = max(float(motion.speeds.max()) for motion in motions)
    if subject.tcp_speed_m_s:
        return min(_ROOM * max(fastest, subject.tcp_speed_m_s), _SPEEDS * subject.tcp_speed_m_s)
    return max(_ROOM * fastest, 1e-3)


def _charts(subject: Subject, motion: StationMotion, top: float) -> tuple[Panel, ...]:
    name, until = f"station {motion.name}", motion.duration_s
    steps, _ = motion.accelerations
    rates = acceleration_shares(motion, subject.cell.acceleration_max_rad_s2)

    def positions(axes: Axes) -> None:
        _draw_shares(axes, motion, motion.times, position_shares(motion))

    def velocities(axes: Axes) -> None:
        _draw_shares(axes, motion, motion.times, velocity_shares(motion))

    def accelerations(axes: Axes) -> None:
        _draw_shares(axes, motion, steps.reshape(-1), np.repeat(rates, 2, axis=0))

    def speed(axes: Axes) -> None:
        _shade(axes, motion)
        axes.plot(motion.times, motion.speeds, color=palette.INK, linewidth=1.1, zorder=3)
        if subject.tcp_speed_m_s is not None:
            axes.axhline(
                subject.tcp_speed_m_s, color=LIMIT, linewidth=1.2, linestyle="--", zorder=2
            )

    speed_title = f"{name}: speed of the scanner"
    if motion.speeds.max() > top:
        speed_title += f", transits up to {motion.speeds.max():.1f} m/s"
    window = (0.0, until, -_ROOM, _ROOM)
    labels = ("time at the station [s]", "share of the limit [1]")
    speed_labels = ("time at the station [s]", "speed [m/s]")
    return (
        Panel(f"{name}: joint positions", window, positions, labels, _CHART_PX),
        Panel(f"{name}: joint velocities", window, velocities, labels, _CHART_PX),
        Panel(f"{name}: joint accelerations", window, accelerations, labels, _CHART_PX),
        Panel(speed_title, (0.0, until, 0.0, top), speed, speed_labels, _CHART_PX),
    )


def _draw_shares(axes: Axes, motion: StationMotion, times: Array, shares: Array) -> None:
    _shade(axes, motion)
    for limit in (-1.0, 1.0):
        axes.axhline(limit, color=LIMIT, linewidth=1.2, linestyle="--", zorder=2)
    axes.axhline(0.0, color=palette.FAINT, linewidth=0.5, zorder=2)
    for joint, colour in enumerate(_COLOURS):
        axes.plot(times, shares[:, joint], color=colour, linewidth=1.1, zorder=3)
    axes.set_yticks([-1.0, -0.5, 0.0, 0.5, 1.0])


def _shade(axes: Axes, motion: StationMotion) -> None:
    for (begin, end), kind in zip(motion.spans, motion.kinds, strict=True):
        colour = SCAN_SHADE if kind == SCAN else TRANSIT_SHADE
        axes.axvspan(begin, end, facecolor=colour, edgecolor="none", zorder=0)


def _handles(subject: Subject, motions: Sequence[StationMotion]) -> list[Artist]:
    limit = subject.cell.acceleration_max_rad_s2
    shares = [
        (position_shares(m), velocity_shares(m), acceleration_shares(m, limit)) for m in motions
    ]
    most = [
        np.max([np.abs(part).max(axis=0, initial=0.0) for part in parts], axis=0)
        for parts in zip(*shares, strict=True)
    ]
    handles: list[Artist] = [
        Line2D(
            [], [], color=colour, linewidth=2.0,
            label=f"{_joint_name(motions[0], joint)}: "
            + ", ".join(f"{n} {_percent(m[joint])}" for n, m in zip(_QUANTITIES, most, strict=True))
            + " at most",
        )
        for joint, colour in enumerate(_COLOURS)
    ]  # fmt: skip
    fastest = max(scan_speed(motion) for motion in motions)
    told = f"scanner: at most {fastest:.3f} m/s while scanning"
    if subject.tcp_speed_m_s:
        told += f", {_percent(fastest / subject.tcp_speed_m_s)} of its limit"
    return [
        *handles,
        Line2D([], [], color=palette.INK, linewidth=1.4, label=told),
        Line2D([], [], color=LIMIT, linewidth=1.4, linestyle="--", label="limit"),
        Patch(facecolor=SCAN_SHADE, edgecolor=palette.FAINT, linewidth=0.5, label="scan"),
        Patch(facecolor=TRANSIT_SHADE, edgecolor=palette.FAINT, linewidth=0.5, label="transit"),
    ]


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"


def _joint_name(motion: StationMotion, joint: int) -> str:
    return motion.arm.joint_names[joint].removesuffix("_joint").replace("_", " ")
