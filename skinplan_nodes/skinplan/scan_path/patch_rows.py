"""Rows over the projection of a patch along its mean normal (R 5)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.scan_path.frame import RowFrame
from skinplan.scan_path.rows import GAP_RATIO, INSET_RATIO, LEAST_PIECE_RATIO
from skinplan.scanner.model import SurfaceSamples
from skinplan.transforms import Array

Indices = NDArray[np.int64]

# A turn takes about as long as so much of a row.
TURN_M = 0.5


@dataclass(frozen=True)
class RowRule:
    """How rows are laid.

    Attributes:
        interval_m: Distance between rows, and between points on them, at most [m].
        gap_m: A row goes on behind a gap up to this long [m].
        most_rise_m: A pose stands at most so far above the stand-off from the lowest place of its
            surroundings [m], so that this is still in range.
    """

    interval_m: float
    gap_m: float
    most_rise_m: float

    @property
    def bridged_m(self) -> float:
        """Gaps up to this long break no row [m]."""
        return max(self.gap_m, GAP_RATIO * self.interval_m)


@dataclass(frozen=True, eq=False)
class PatchRows:
    """Rows over a patch.

    Attributes:
        frame: Directions; ``base`` is the mean normal of the patch.
        offsets: Place of each row across, shape (r,) [m].
        members: Numbers of the samples in the strip of each row, by their place along it.
        length_m: Length of all rows [m].
    """

    frame: RowFrame
    offsets: Array
    members: tuple[Indices, ...]
    length_m: float

    @property
    def cost_m(self) -> float:
        """Length of the rows and of their turns, a turn taken as 0.5 m [m]."""
        return self.length_m + TURN_M * len(self.members)


def lay_rows(samples: SurfaceSamples, frame: RowFrame, rule: RowRule) -> PatchRows:
    """Lays rows over the projection of samples along the frame's base normal.

    Args:
        samples: Samples of the patch, at least one.
        frame: Directions of the rows.
        rule: How far apart.

    Returns:
        Rows that reach as far as the samples in their strips; a strip with a gap has two.
    """
    along, across = samples.points @ frame.along, samples.points @ frame.across
    places = _offsets(across, rule.interval_m)
    strip = np.searchsorted((places[1:] + places[:-1]) / 2, across)
    order = np.lexsort((along, strip))
    sorted_along, sorted_strip = along[order], strip[order]
    breaks = (np.diff(sorted_strip) > 0) | (np.diff(sorted_along) > rule.bridged_m)
    pieces = np.split(order, np.flatnonzero(breaks) + 1)
    least = LEAST_PIECE_RATIO * rule.interval_m
    areas = np.array([samples.weights[piece].sum() for piece in pieces])
    lengths = np.array([along[piece[-1]] - along[piece[0]] for piece in pieces])
    kept = (lengths >= least) | (areas >= least**2)
    # Of a patch that is small all over at least the largest piece is treated.
    kept[np.argmax(areas)] = True
    members = tuple(piece for piece, keep in zip(pieces, kept, strict=True) if keep)
    offsets = places[[strip[piece[0]] for piece in members]]
    return PatchRows(frame, offsets, members, float(lengths[kept].sum()))


def _offsets(across: Array, interval_m: float) -> Array:
    """Spaces the rows: at most one interval apart, the outer ones just inside the edges."""
    low, high = float(across.min()), float(across.max())
    if high - low <= interval_m:
        return np.array([(low + high) / 2])
    inset = INSET_RATIO * interval_m
    steps = int(np.ceil((high - low - 2 * inset) / interval_m - 1e-6))
    return np.linspace(low + inset, high - inset, steps + 1)


def row_targets(
    samples: SurfaceSamples, rows: PatchRows, rule: RowRule
) -> tuple[Array, NDArray[np.int64]]:
    """Puts points on the rows, each as high as the part about it.

    Args:
        samples: Samples of the patch.
        rows: Its rows.
        rule: How far apart, and how high.

    Returns:
        Targets, shape (n, 3) [m], and the row of each from 0, shape (n,).
    """
    frame = rows.frame
    along, height = samples.points @ frame.along, samples.points @ frame.base
    targets, numbers = [], []
    for number, (offset, piece) in enumerate(zip(rows.offsets, rows.members, strict=True)):
        places, heights = _points_of(along[piece], height[piece], rule)
        targets.append(
            places[:, None] * frame.along + offset * frame.across + heights[:, None] * frame.base
        )
        numbers.append(np.full(len(places), number, dtype=np.int64))
    return np.concatenate(targets), np.concatenate(numbers)


def _points_of(along: Array, height: Array, rule: RowRule) -> tuple[Array, Array]:
    """Returns places along a row and heights there, shapes (n,) [m]; none inside long gaps."""
    half = rule.interval_m / 2
    low, high = float(along[0]), float(along[-1])
    if high - low <= rule.interval_m:
        places = np.array([(low + high) / 2])
    else:
        inset = INSET_RATIO * rule.interval_m
        steps = int(np.ceil((high - low - 2 * inset) / rule.interval_m - 0.01))
        places = np.linspace(low + inset, high - inset, max(steps, 1) + 1)
    begin = np.searchsorted(along, places - half, side="left")
    end = np.searchsorted(along, places + half, side="right")
    some = np.flatnonzero(end > begin)
    heights = np.zeros(len(places))
    for point in some:
        near = height[begin[point] : end[point]]
        heights[point] = min(near.max(), near.min() + rule.most_rise_m)
    return places[some], heights[some]
