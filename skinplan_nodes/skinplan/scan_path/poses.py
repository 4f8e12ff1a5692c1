"""Candidate poses, from which strategy ``coverage`` chooses."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.transforms import Array

SINGLE = -1


@dataclass(frozen=True, eq=False)
class Poses:
    """Candidate scan poses in the workpiece frame.

    Attributes:
        positions: Scanner origins, shape (n, 3) [m].
        directions: Unit view directions, shape (n, 3).
        targets: Points looked at, shape (n, 3) [m].
        passes: Number of the pass that a pose stands on, poses of one in order along it;
            ``SINGLE`` for a single viewpoint, shape (n,).
    """

    positions: Array
    directions: Array
    targets: Array
    passes: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.positions)

    def take(self, which: NDArray[np.generic]) -> "Poses":
        """Returns some of them, by mask or index."""
        return Poses(
            self.positions[which], self.directions[which], self.targets[which], self.passes[which]
        )

    @classmethod
    def looking(
        cls, targets: Array, normals: Array, standoff_m: float, passes: NDArray[np.int64]
    ) -> "Poses":
        """Makes poses that look at targets against unit normals, shape (n, 3), from a stand-off."""
        return cls(targets + standoff_m * normals, -normals, targets, passes)

    @classmethod
    def joined(cls, parts: Sequence["Poses"]) -> "Poses":
        """Puts several sets one after another."""
        return cls(
            np.concatenate([part.positions for part in parts]),
            np.concatenate([part.directions for part in parts]),
            np.concatenate([part.targets for part in parts]),
            np.concatenate([part.passes for part in parts]),
        )

    @classmethod
    def none(cls) -> "Poses":
        """Returns no poses."""
        empty = np.zeros((0, 3))
        return cls(empty, empty, empty, np.zeros(0, dtype=np.int64))
