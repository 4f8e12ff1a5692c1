"""All branches of flange poses, within limits and ordered by their distance from singularities."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.robot.arm import ArmModel
from skinplan.robot.dexterity import Dexterity
from skinplan.robot.wrist_filter import WristFilter
from skinplan.transforms import Array

_AGREEMENT = 1e-9  # [m, 1]


@dataclass(frozen=True, eq=False)
class Branches:
    """Branches of n poses, best first.

    Attributes:
        q: Joint positions, shape (n, 8, 6) [rad]; NaN where there is no branch.
        usable: Within limits and not singular; these come first, shape (n, 8).
        any_solution: The pose has a branch, shape (n,).
        any_within: It has one within limits, shape (n,).
    """

    q: Array
    usable: NDArray[np.bool_]
    any_solution: NDArray[np.bool_]
    any_within: NDArray[np.bool_]


class BranchSolver:
    """Solves flange poses of one arm.

    Attributes:
        filter: Tells quickly which poses have branches.
        dexterity: Distance from singular positions.
    """

    def __init__(
        self, arm: ArmModel, home: Array, last_joint_is_free: bool, first_margin_rad: float = 0.0
    ) -> None:
        """Takes an arm.

        Args:
            arm: The arm.
            home: Home joint positions, shape (6,) [rad]: full turns are chosen near to it.
            last_joint_is_free: The last joint only turns the scanner about its view axis: it rests
                at its home position.
            first_margin_rad: The first joint keeps so far from its limits [rad].
        """
        self.filter = WristFilter(arm)
        self.dexterity = Dexterity(arm)
        self._arm, self._home, self._last_is_free = arm, home, last_joint_is_free
        self._margin = np.array([first_margin_rad, 0.0, 0.0, 0.0, 0.0, 0.0])

    def solve(self, T_arm_base_tool0: Array) -> Branches:
        """Returns the branches of poses, shape (n, 4, 4) [m].

        They are as the solver gives them: confirm what is used.
        """
        q = self._arm.unchecked_inverse(T_arm_base_tool0)
        found = np.isfinite(q[:, :, 0])
        if self._last_is_free:
            q[:, :, 5] = np.where(found, self._home[5], np.nan)
        q = wound(q, self._home, self._arm.lower + self._margin, self._arm.upper - self._margin)
        within = found & np.all(
            (q >= self._arm.lower + self._margin - 1e-9)
            & (q <= self._arm.upper - self._margin + 1e-9),
            axis=2,
        )
        usable = np.zeros_like(within)
        worth = np.full(within.shape, -1.0)
        some = q[within]
        usable[within] = self.dexterity.clear(some)
        # Rounded: of equally good branches the first one is taken on every machine.
        worth[within] = np.round(self.dexterity.measure(some), 9)
        worth[~usable] = -1.0
        order = np.argsort(-worth, axis=1, kind="stable")
        return Branches(
            np.take_along_axis(q, order[:, :, None], axis=1),
            np.take_along_axis(usable, order, axis=1),
            np.asarray(found.any(axis=1)),
            np.asarray(within.any(axis=1)),
        )

    def confirmed(self, q: Array, T_arm_base_tool0: Array) -> NDArray[np.bool_]:
        """Tells which joint positions bring the flange to poses, but for a free last joint."""
        reached = self._arm.forward(q)
        if not self._last_is_free:
            return np.asarray(np.abs(reached - T_arm_base_tool0).max(axis=(1, 2)) < _AGREEMENT)
        scanner = reached @ self._arm.T_tool0_scanner
        asked = T_arm_base_tool0 @ self._arm.T_tool0_scanner
        columns = np.abs(scanner[:, :3, [0, 3]] - asked[:, :3, [0, 3]])
        return np.asarray(columns.max(axis=(1, 2), initial=0.0) < _AGREEMENT)

    def limit_margin(self, q: Array) -> Array:
        """Returns the smallest distance to a joint limit, shape (n,) [rad], of positions (n, 6)."""
        return np.minimum(q - self._arm.lower, self._arm.upper - q).min(axis=1, initial=np.inf)


def wound(q: Array, centre: Array, lower: Array, upper: Array) -> Array:
    """Adds full turns: within half a turn of a centre, or the next ones that respect the limits.

    Args:
        q: Joint positions, shape (..., 6) [rad].
        centre: Centre, shape (6,) [rad].
        lower: Joint limits, shape (6,) [rad].
        upper: Joint limits, shape (6,) [rad].
    """
    turn = 2.0 * np.pi
    result = q + turn * np.round((centre - q) / turn)
    result = result - turn * np.ceil(np.maximum(result - upper - 1e-9, 0.0) / turn)
    return np.asarray(result + turn * np.ceil(np.maximum(lower - 1e-9 - result, 0.0) / turn))
