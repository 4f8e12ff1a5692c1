"""The candidate places for the base on the plan of the floor (Fig. 13, 20c of M)."""

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from skinplan.robot.cell import CellConfig
from skinplan.stations.candidate_map import NOT_TRIED, CandidateMap
from skinplan.stations.rectangle import Rectangle
from skinplan.transforms import Array
from skinplan.view import palette
from skinplan.view.floor_marks import arm_place, rectangle_corners

_BLOCKED = (0.72, 0.72, 0.74)
_LEVELS = 4


def candidate_places(seen: CandidateMap, cell: CellConfig) -> Array:
    """Returns where the arm's axis would stand, shape (c, 2) [m], map frame."""
    return np.array([arm_place(pose, cell)[:2] for pose in seen.poses]).reshape(-1, 2)


def count_colours(counts: NDArray[np.int64], most: int) -> Array:
    """Returns the colours of counts from 0 (pale) to ``most`` (dark), shape (c, 4)."""
    share = np.asarray(counts, dtype=float) / max(1, most)
    # The palest end of the map could not be told from the paper.
    return np.asarray(matplotlib.colormaps["BuPu"](0.15 + 0.85 * np.clip(share, 0.0, 1.0)))


def draw_candidates(axes: Axes, seen: CandidateMap, cell: CellConfig, size: float = 3.2) -> None:
    """Draws all candidates as dots, coloured by what they count.

    Args:
        axes: Where.
        seen: The candidates.
        cell: The cell.
        size: Of a dot [pt].
    """
    places = candidate_places(seen, cell)
    # Few candidates need larger dots to be seen at all.
    size = size if len(places) > 200 else 2.0 * size
    axes.plot(*places[seen.blocked].T, "x", color=_BLOCKED, markersize=0.8 * size, zorder=2.2)
    axes.plot(*places[seen.blind].T, "+", color=_BLOCKED, markersize=size, zorder=2.2)
    left = seen.counts == NOT_TRIED
    axes.plot(
        *places[left].T, "o", markerfacecolor="none", markeredgecolor=_BLOCKED, markersize=size,
        markeredgewidth=0.6, zorder=2.2,
    )  # fmt: skip
    tried = np.flatnonzero(seen.tried)
    tried = tried[np.argsort(seen.counts[tried], kind="stable")]  # the best on top
    colours = count_colours(seen.counts[tried], _most(seen))
    axes.scatter(
        places[tried, 0], places[tried, 1], s=size**2, c=colours,
        edgecolors=[(0.35, 0.4, 0.45)], linewidths=0.25, zorder=2.5,
    )  # fmt: skip


def draw_candidate_rectangles(
    axes: Axes, seen: CandidateMap, cell: CellConfig, rectangle: Rectangle
) -> None:
    """Draws the rectangles of all candidates, coloured by the points that they cover."""
    order = np.argsort(seen.counts, kind="stable")
    order = order[seen.tried[order]]
    corners = [rectangle_corners(seen.poses[row], cell, rectangle) for row in order]
    axes.add_collection(
        PolyCollection(
            corners, facecolors="none", edgecolors=count_colours(seen.counts[order], _most(seen)),
            linewidths=1.1, zorder=3,
        )
    )  # fmt: skip


def candidate_handles(seen: CandidateMap) -> list[Artist]:
    """Returns the legend of the candidates."""
    handles: list[Artist] = []
    counts = seen.counts[seen.tried]
    if len(counts):
        levels = np.unique(np.linspace(counts.min(), counts.max(), _LEVELS).round().astype(int))
        for level, colour in zip(levels, count_colours(levels, _most(seen)), strict=True):
            handles.append(
                _dot(
                    f"candidate that {seen.counted} {level} points",
                    color=colour,
                    markeredgewidth=0.3,
                )
            )
    for code_shown, label, style in (
        (seen.counts == NOT_TRIED, "candidate that promised little", {"markerfacecolor": "none"}),
        (seen.blind, "from where the part can't be located", {"marker": "+"}),
        (seen.blocked, "not free for base or arm", {"marker": "x"}),
    ):
        if np.any(code_shown):
            handles.append(
                _dot(f"{np.count_nonzero(code_shown)} × {label}", markeredgecolor=_BLOCKED, **style)
            )
    return handles


def _most(seen: CandidateMap) -> int:
    return int(seen.counts.max(initial=1))


def _dot(label: str, **style: object) -> Line2D:
    shown: dict[str, object] = {"marker": "o", "markersize": 6, "markeredgecolor": palette.FAINT}
    return Line2D([], [], linestyle="none", label=label, **(shown | style))  # type: ignore[arg-type]
