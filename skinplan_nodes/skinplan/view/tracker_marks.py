"""The tracker on the plan of the floor: where it stands, and where it could see a scanner."""

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from skinplan.robot.cell import TrackerSettings
from skinplan.transforms import Array
from skinplan.view import palette
from skinplan.view.sheet import outlined
from skinplan.view.subject import Subject

COLOUR: palette.Colour = (0.33, 0.27, 0.55)
_GRID = 220


def tracker_margin(tracker: TrackerSettings, T_map_tracker: Array, places: Array) -> Array:
    """Returns how far places are inside the tracker's range and cone, shape (n,) [m].

    Args:
        tracker: Range and cone.
        T_map_tracker: Where it stands, shape (4, 4) [m]; +x is its view direction.
        places: Of the scanner, shape (n, 3) [m], map frame.

    Returns:
        Positive inside, negative outside; what stands between is not asked.
    """
    way = places - T_map_tracker[:3, 3]
    distance = np.linalg.norm(way, axis=1)
    share = way @ T_map_tracker[:3, 0] / np.maximum(distance, 1e-9)
    inside_cone = (tracker.cone_rad - np.arccos(np.clip(share, -1.0, 1.0))) * distance
    inside_range = np.minimum(distance - tracker.range_min_m, tracker.range_max_m - distance)
    return np.asarray(np.minimum(inside_cone, inside_range))


def draw_tracker(
    axes: Axes, subject: Subject, window: tuple[float, float, float, float], height_m: float
) -> None:
    """Draws the tracker, and its range and cone at a height.

    Args:
        axes: Where.
        subject: Has a cell.
        window: Left, right, bottom, top of the axes [m].
        height_m: Of the scanner above the floor [m].
    """
    left, right, bottom, top = window
    x, y = np.linspace(left, right, _GRID), np.linspace(bottom, top, _GRID)
    places = np.stack([*np.meshgrid(x, y), np.full((_GRID, _GRID), height_m)], axis=-1)
    T_map_tracker = subject.T_map_tracker
    inside = tracker_margin(subject.cell.tracker, T_map_tracker, places.reshape(-1, 3))
    inside = inside.reshape(_GRID, _GRID)
    if inside.min() < 0.0 < inside.max():
        axes.contour(x, y, inside, levels=[0.0], colors=[COLOUR], linewidths=1.0, zorder=1.2)
        axes.contourf(
            x, y, inside, levels=[0.0, float(inside.max())], colors=[COLOUR], alpha=0.08, zorder=0.5
        )
    place, ahead = T_map_tracker[:2, 3], T_map_tracker[:2, 0]
    if not (left <= place[0] <= right and bottom <= place[1] <= top):
        return
    axes.plot(*place, "^", color=COLOUR, markersize=13, zorder=8)
    axes.annotate(
        "", xy=tuple(place + 0.5 * ahead), xytext=tuple(place), zorder=8,
        arrowprops={"arrowstyle": "-|>", "color": COLOUR, "linewidth": 2, "mutation_scale": 16},
    )  # fmt: skip
    outlined(axes, place[0], place[1], "tracker", -16.0, fontsize=11)


def tracker_handles() -> list[Artist]:
    """Returns the legend of tracker and field."""
    return [
        Line2D([], [], linestyle="none", marker="^", color=COLOUR, markersize=9, label="tracker"),
        Patch(
            facecolor=(*COLOUR, 0.12), edgecolor=COLOUR, label="tracker's range and cone"
        ),
    ]  # fmt: skip
