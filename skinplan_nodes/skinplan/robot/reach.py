"""What the arm reaches: joint positions, free of collision, that bring the scanner to views.

Where the last joint turns about the view axis (the scanner on tool z), roll only turns that joint:
it is kept at its home position, and roll follows. Otherwise a few rolls are tried. Tilt about the
target is the redundancy that adds reach; it is used only where the straight view is not reached.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.robot.arm import ArmModel
from skinplan.robot.branches import wound
from skinplan.robot.collision import CollisionWorld
from skinplan.robot.scanner_pose import mean_direction, tilted, tool_poses
from skinplan.transforms import Array, apply, rotate

_ROLLS = 8
_TILT_SIDES = 16
_TILT_SHARES = (0.5, 1.0)
_AGREEMENT = 1e-9  # [m, 1]
_NO_SOLUTION = "out of the arm's reach: no inverse kinematics"
_LIMITS = "joint limits"


@dataclass(frozen=True, eq=False)
class Views:
    """Scanner views in the arm base.

    Attributes:
        positions: Scanner origins, shape (n, 3) [m].
        directions: Unit view directions, shape (n, 3).
        targets: Surface points looked at, shape (n, 3) [m].
        reference: Unit direction that rolls are counted from, shape (3,).
    """

    positions: Array
    directions: Array
    targets: Array
    reference: Array

    def __len__(self) -> int:
        return len(self.positions)

    @classmethod
    def placed(
        cls, positions: Array, directions: Array, targets: Array, T_arm_base_workpiece: Array
    ) -> "Views":
        """Maps views from the workpiece frame to the arm base."""
        turned = rotate(T_arm_base_workpiece, directions)
        return cls(
            apply(T_arm_base_workpiece, positions),
            turned,
            apply(T_arm_base_workpiece, targets),
            mean_direction(turned),
        )

    def tilted(
        self, which: NDArray[np.int64], angle_rad: float, sides: int = _TILT_SIDES
    ) -> "Views":
        """Returns the chosen views tilted about their targets, to some sides each."""
        directions = tilted(self.directions[which], angle_rad, sides)
        distance = np.linalg.norm(self.targets[which] - self.positions[which], axis=1)
        positions = self.targets[which][:, None] - distance[:, None, None] * directions
        targets = np.repeat(self.targets[which], sides, axis=0)
        return Views(positions.reshape(-1, 3), directions.reshape(-1, 3), targets, self.reference)


@dataclass(frozen=True, eq=False)
class Reached:
    """Joint positions that reach views: any number for each view.

    Attributes:
        view: Number of the view, rising, shape (m,).
        q: Joint positions within limits and free of collision, shape (m, 6) [rad].
        positions: Scanner origins in the arm base, shape (m, 3) [m]: the view's own, or tilted
            about its target.
        directions: Unit view directions, shape (m, 3).
        rolls: Roll from the reference direction, shape (m,) [rad].
        reasons: Why a view has none, by its number.
    """

    view: NDArray[np.int64]
    q: Array
    positions: Array
    directions: Array
    rolls: Array
    reasons: dict[int, str]


def reach(world: CollisionWorld, views: Views, tilt_max_rad: float, home: Array) -> Reached:
    """Finds the joint positions for views.

    Args:
        world: Arm, base and part.
        views: n views.
        tilt_max_rad: Largest tilt about the target [rad]; 0 = straight views only.
        home: Home joint positions, shape (6,) [rad].

    Returns:
        All branches that are within limits and free, of the straight view where it has one, else of
        views tilted by half the largest tilt, else by all of it.
    """
    found, reasons = _reach(world, views, np.arange(len(views)), home)
    parts = [found]
    for share in _TILT_SHARES if tilt_max_rad > 0.0 else ():
        left = np.array(sorted(reasons), dtype=np.int64)
        if not len(left):
            break
        leaned = views.tilted(left, share * tilt_max_rad)
        more, _ = _reach(world, leaned, np.repeat(left, _TILT_SIDES), home)
        parts.append(more)
        for view in np.unique(more.view):
            reasons.pop(int(view))
    order = np.argsort(np.concatenate([p.view for p in parts]), kind="stable")
    return Reached(
        np.concatenate([p.view for p in parts])[order],
        np.concatenate([p.q for p in parts])[order],
        np.concatenate([p.positions for p in parts])[order],
        np.concatenate([p.directions for p in parts])[order],
        np.concatenate([p.rolls for p in parts])[order],
        reasons,
    )


def solve_views(
    arm: ArmModel, positions: Array, directions: Array, rolls: Array, reference: Array, home: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Returns all branches for views, shape (n, 8, 6) [rad], and which are solutions, shape (n, 8).

    With the last joint about the view axis its position is home's, whatever the roll.
    """
    poses = tool_poses(positions, directions, rolls, arm.T_tool0_scanner, reference)
    branches, valid = arm.inverse(poses)
    if arm.tool_axis_is_view:
        branches[:, :, 5] = np.where(valid, home[5], np.nan)
    return branches, valid


def nearest_solutions(
    arm: ArmModel,
    positions: Array,
    directions: Array,
    rolls: Array,
    reference: Array,
    home: Array,
    near: Array,
) -> Array:
    """Returns for views the solutions nearest to joint positions, shape (n, 6) [rad].

    Windings are chosen near to them, too; only the chosen branch is checked against the forward
    kinematics. NaN where there is none.

    Args:
        arm: The arm.
        positions: Scanner origins, shape (n, 3) [m].
        directions: Unit view directions, shape (n, 3).
        rolls: Roll from the reference direction, shape (n,) [rad].
        reference: Unit direction that rolls are counted from, shape (3,).
        home: Home joint positions, shape (6,) [rad].
        near: Joint positions, shape (n, 6) [rad].
    """
    poses = tool_poses(positions, directions, rolls, arm.T_tool0_scanner, reference)
    branches = arm.unchecked_inverse(poses)
    if arm.tool_axis_is_view:
        branches[:, :, 5] = np.where(np.isfinite(branches[:, :, 0]), home[5], np.nan)
    options = nearest_winding(branches, near[:, None])
    gaps = np.abs(options - near[:, None]).max(axis=2)
    gaps[np.isnan(gaps)] = np.inf
    chosen = np.array(options[np.arange(len(near)), np.argmin(gaps, axis=1)])
    found = np.flatnonzero(np.isfinite(chosen[:, 0]))
    frames = arm.forward_scanner(chosen[found])
    off = np.abs(frames[:, :3, 3] - positions[found]).max(axis=1, initial=0.0)
    turned = np.abs(frames[:, :3, 0] - directions[found]).max(axis=1, initial=0.0)
    chosen[found[np.maximum(off, turned) > _AGREEMENT]] = np.nan
    return chosen


def nearest_winding(q: Array, centre: Array) -> Array:
    """Adds full turns: joint positions, (..., 6) [rad], within half a turn of a centre."""
    return np.asarray(q + 2.0 * np.pi * np.round((centre - q) / (2.0 * np.pi)))


def roll_choices(arm: ArmModel) -> Array:
    """Returns the rolls worth trying, shape (r,) [rad]: one when roll only turns the last joint."""
    return np.zeros(1) if arm.tool_axis_is_view else 2.0 * np.pi * np.arange(_ROLLS) / _ROLLS


def _reach(
    world: CollisionWorld, views: Views, numbers: NDArray[np.int64], home: Array
) -> tuple[Reached, dict[int, str]]:
    arm = world.arm
    rolls = roll_choices(arm)
    # No view farther from the first axis than the stretched arm can have a solution.
    near = np.flatnonzero(
        np.linalg.norm(views.positions - arm.first_axis, axis=1) <= arm.lever_arms()[0]
    )
    picked = np.repeat(near, len(rolls))
    turns = np.tile(rolls, len(near))
    branches, valid = solve_views(
        arm, views.positions[picked], views.directions[picked], turns, views.reference, home
    )
    row, column = np.nonzero(valid)
    view = picked[row]
    q = wound(branches[row, column], home, arm.lower, arm.upper)
    inside = arm.within_limits(q)
    pairs = world.pairs(q[inside])
    free = np.zeros(len(q), dtype=bool)
    free[inside] = [pair is None for pair in pairs]
    reasons = dict.fromkeys(numbers.tolist(), _NO_SOLUTION)
    reasons.update(dict.fromkeys(numbers[view].tolist(), _LIMITS))
    for number, pair in zip(numbers[view[inside]].tolist(), pairs, strict=True):
        if pair is not None:
            reasons[number] = f"collision of {pair}"
    for number in np.unique(numbers[view[free]]):
        reasons.pop(int(number))
    keep = view[free]
    return Reached(
        numbers[keep], q[free], views.positions[keep], views.directions[keep], turns[row][free], {}
    ), reasons
