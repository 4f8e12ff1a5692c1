"""What points say about a rigid motion: how well each direction of it is known, or that it is not.

Directions are motions of six numbers, turn times the size of the part and shift, all in metres:
a unit direction moves the points of the part by about one unit.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.inspection.model import Motion
from skinplan.transforms import Array

# One piece of surface of this side counts as one observation: form deviation and the tracker's
# noise are alike within it, so that thousands of its points say no more than one [m].
PATCH_M = 0.05
# What such a piece may be off by without anybody knowing: of the surface, and of the border [m].
FORM_M = 5e-5
BORDER_M = 3e-4


@dataclass(frozen=True, eq=False)
class Rows:
    """Linearised residuals.

    Attributes:
        jacobian: Change of the residual by a motion, and by a seventh number that is not asked for
            (how far the outermost points stay inside the border), shape (n, 7) [1].
        residual: shape (n,) [m].
        weight: Robust weight, shape (n,), 0 to 1.
        patch: Number of the piece that each belongs to, shape (n,).
    """

    jacobian: Array
    residual: Array
    weight: Array
    patch: NDArray[np.int64]

    @property
    def share(self) -> float:
        """Number of pieces over sum of weights: what makes each piece count once."""
        used = np.unique(self.patch[self.weight > 0.0])
        return len(used) / max(float(self.weight.sum()), 1e-12)

    def information(self, sigma_m: float) -> Array:
        """Returns the information about the seven numbers, shape (7, 7) [1/m^2]."""
        scale = self.share / sigma_m**2
        return scale * (self.jacobian.T @ (self.weight[:, None] * self.jacobian))

    def gradients(self, sigma_m: float) -> Array:
        """Returns the gradient that each piece gives, shape (pieces, 7) [1/m]."""
        scale = self.share / sigma_m**2
        rows = scale * (self.weight * self.residual)[:, None] * self.jacobian
        number = np.unique(self.patch, return_inverse=True)[1].reshape(-1)
        count = int(number.max()) + 1 if len(number) else 0
        return np.stack([np.bincount(number, rows[:, k], count) for k in range(7)], axis=1)


def jacobian(
    points: Array, directions: Array, pivot: Array, size_m: float, inset: float = 0.0
) -> Array:
    """Returns the change of the points' places along directions, shape (n, 7) [1].

    Args:
        points: shape (n, 3) [m].
        directions: Unit vectors, shape (n, 3).
        pivot: What is turned about, shape (3,) [m].
        size_m: Turns are counted in this length [m].
        inset: Change of the residual by the seventh number [1].
    """
    turned = np.cross(points - pivot, directions) / size_m
    return np.column_stack([turned, directions, np.full(len(points), inset)])


def patches(points: Array) -> NDArray[np.int64]:
    """Returns the number of the piece of surface that each point lies in, shape (n,)."""
    cells = np.floor(points / PATCH_M).astype(np.int64)
    cells -= cells.min(axis=0) if len(cells) else 0
    most = cells.max(axis=0) + 1 if len(cells) else np.ones(3, np.int64)
    return np.asarray((cells[:, 0] * most[1] + cells[:, 1]) * most[2] + cells[:, 2])


def weak_directions(information: Array, sigma_m: float) -> Array:
    """Returns the projection on what is known no better than `sigma_m`, shape (6, 6)."""
    values, vectors = np.linalg.eigh(information)
    weak = vectors[:, values < sigma_m**-2]
    return np.asarray(weak @ weak.T)


@dataclass(frozen=True, eq=False)
class Solution:
    """The best small motion.

    Attributes:
        step: shape (6,) [m].
        inset: Step of the seventh number [m].
        to_motion: What takes a gradient to a motion, shape (6, 7) [m^2]; undetermined directions
            are left out.
        undetermined: Directions that nothing holds, as columns, shape (6, k).
        condition: Largest over smallest information of the directions that are held [1].
    """

    step: Array
    inset: float
    to_motion: Array
    undetermined: Array
    condition: float


def solve(
    information: Array, gradient: Array, sigma_max_m: float, frozen: Array | None = None
) -> Solution:
    """Solves for the motion; directions known no better than `sigma_max_m` are left alone.

    Args:
        information: Of the seven numbers, shape (7, 7) [1/m^2].
        gradient: shape (7,) [1/m].
        sigma_max_m: What counts as known [m].
        frozen: Directions that are left alone in any case, as columns, shape (6, k).
    """
    coupling = information[:6, 6] / information[6, 6]
    alone = information[:6, :6] - np.outer(coupling, information[6, :6])
    if frozen is not None and frozen.shape[1]:
        free = np.eye(6) - frozen @ frozen.T
        alone = free @ alone @ free
    values, vectors = np.linalg.eigh(alone)
    held = values > sigma_max_m**-2
    basis = vectors[:, held]
    inverse = basis @ (basis / values[held]).T
    to_motion = inverse @ np.column_stack([np.eye(6), -coupling])
    step = -to_motion @ gradient
    inset = -(gradient[6] + information[6, :6] @ step) / information[6, 6]
    known = values[held]
    condition = float(known[-1] / known[0]) if len(known) else float("inf")
    return Solution(step, float(inset), to_motion, vectors[:, ~held], condition)


def motions(directions: Array, size_m: float) -> tuple[Motion, ...]:
    """Returns directions, shape (6, k), as shift and turn; simple ones where they span such.

    A plane leaves two shifts and a turn open, in any mixture: shifts are taken apart first.
    """
    if directions.shape[1] == 0:
        return ()
    turns, shifts = directions[:3], directions[3:]
    # What of the span turns nothing are pure shifts.
    _, singular, right = np.linalg.svd(turns)
    rank = int(np.count_nonzero(singular > 0.05))
    found = []
    for k, row in enumerate(np.vstack([right[rank:], right[:rank]])):
        turn, shift = turns @ row / size_m, shifts @ row
        pure = k < len(right) - rank
        found.append(Motion(np.zeros(3) if pure else turn, shift))
    return tuple(found)


def covariance(rows: list[tuple[Rows, float]], solution: Solution) -> Array:
    """Returns the covariance of the motion, shape (6, 6) [m^2], from the scatter of the pieces.

    Args:
        rows: Residuals and what a piece of them may be off by [m].
        solution: What was solved with them.
    """
    gradients = np.vstack([each.gradients(sigma) for each, sigma in rows])
    count, held = len(gradients), 6 - solution.undetermined.shape[1]
    correction = count / max(count - held, 1)
    moved = gradients @ solution.to_motion.T
    return np.asarray(correction * moved.T @ moved)
