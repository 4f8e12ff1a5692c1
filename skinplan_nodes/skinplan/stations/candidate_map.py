"""The places that a choice of stations was made from, kept for pictures (Fig. 13, 20c of M)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import InputError
from skinplan.transforms import Array

if TYPE_CHECKING:  # a plan is read where no arm is needed
    from skinplan.stations.floor_grid import FloorGrid
    from skinplan.stations.rectangle import Rectangle

BLIND = -3
BLOCKED = -2
NOT_TRIED = -1


@dataclass(frozen=True, eq=False)
class CandidateMap:
    """Candidate places for the base.

    Attributes:
        poses: ``T_map_base_link``, shape (c, 4, 4) [m].
        counts: Points that count for the choice at each place; `BLOCKED` = base or arm can't be
            there, `BLIND` = they can, but the camera sees the markers too badly, `NOT_TRIED` = it
            promised too little to be looked at closely, shape (c,).
        counted: What the counts mean, to follow "candidate that ...".
        rectangle: The workspace rectangle; None = the strategy has none.
    """

    poses: Array
    counts: NDArray[np.int64]
    counted: str = "reaches"
    rectangle: Rectangle | None = None

    def __post_init__(self) -> None:
        count = len(self.counts)
        if self.poses.shape != (count, 4, 4) or not np.all(np.isfinite(self.poses)):
            raise InputError(
                f"a map of {count} candidates takes finite poses of shape ({count}, 4, 4), "
                f"found {self.poses.shape}"
            )

    def __len__(self) -> int:
        return len(self.counts)

    @property
    def tried(self) -> NDArray[np.bool_]:
        """Which candidates have a count, shape (c,)."""
        return np.asarray(self.counts >= 0)

    @property
    def blind(self) -> NDArray[np.bool_]:
        """Which places are left out for what the camera sees there, shape (c,)."""
        return np.asarray(self.counts == BLIND)

    @property
    def blocked(self) -> NDArray[np.bool_]:
        """Which places are not free, shape (c,)."""
        return np.asarray(self.counts == BLOCKED)


def of_grid(
    grid: FloorGrid,
    free: FloorGrid,
    tried: FloorGrid,
    counts: NDArray[np.int64],
    counted: str = "reaches",
    blind: FloorGrid | None = None,
) -> CandidateMap:
    """Makes the map of a floor grid.

    Args:
        grid: All places.
        free: Those of them where base and arm can be.
        tried: Those of the free ones that were looked at closely.
        counts: Points that count for the choice at each tried place, shape (t,).
        counted: What the counts mean.
        blind: Places left out only for what the camera sees there; None = none.
    """
    number = {tuple(cell): row for row, cell in enumerate(grid.cells.tolist())}
    result = np.full(len(grid), BLOCKED, dtype=np.int64)
    result[[number[tuple(cell)] for cell in free.cells.tolist()]] = NOT_TRIED
    if blind is not None:
        result[[number[tuple(cell)] for cell in blind.cells.tolist()]] = BLIND
    result[[number[tuple(cell)] for cell in tried.cells.tolist()]] = counts
    return CandidateMap(grid.poses, result, counted)
