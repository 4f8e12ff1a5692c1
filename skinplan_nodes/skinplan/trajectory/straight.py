"""Straight Cartesian moves: position on a line, view on a great arc, joints by continuation."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.robot.collision import CollisionWorld
from skinplan.robot.reach import nearest_winding, solve_views
from skinplan.robot.scanner_pose import interpolate_directions
from skinplan.transforms import Array

STEP_M = 0.03
STEP_RAD = float(np.radians(6.0))
JUMP_RAD = 0.35  # more joint motion in one step is no continuation
_SAME = 1e-6


@dataclass(frozen=True, eq=False)
class Poses:
    """Scanner poses with their joint positions; any number n.

    Attributes:
        q: Joint positions, shape (n, 6) [rad].
        positions: Scanner origins in the arm base, shape (n, 3) [m].
        directions: Unit view directions, shape (n, 3).
        rolls: Roll from the reference direction, shape (n,) [rad].
    """

    q: Array
    positions: Array
    directions: Array
    rolls: Array

    def pick(self, which: NDArray[np.int64]) -> "Poses":
        """Returns some of them."""
        return Poses(
            self.q[which], self.positions[which], self.directions[which], self.rolls[which]
        )


@dataclass(frozen=True, eq=False)
class Move:
    """A straight move.

    Attributes:
        q: Joint positions on the way, ends included, shape (k, 6) [rad]; ends early where it fails.
        problem: Why it can't be driven; empty = it can.
    """

    q: Array
    problem: str


def steps_needed(start: Poses, end: Poses) -> NDArray[np.int64]:
    """Returns how many steps of at most `STEP_M` and `STEP_RAD` moves need, shape (n,)."""
    distance = np.linalg.norm(end.positions - start.positions, axis=1)
    angle = np.arccos(np.clip(np.einsum("ni,ni->n", start.directions, end.directions), -1.0, 1.0))
    turn = np.abs(end.rolls - start.rolls)
    steps = np.ceil(np.maximum(distance / STEP_M, np.maximum(angle, turn) / STEP_RAD) - 1e-9)
    return np.maximum(steps, 1).astype(np.int64)


def follow(
    world: CollisionWorld, start: Poses, end: Poses, reference: Array, home: Array
) -> list[Move]:
    """Follows straight moves from the start's joint positions; the end's are not looked at.

    Args:
        world: Arm and surroundings.
        start: n starts.
        end: n ends; only their views count.
        reference: Unit direction that rolls are counted from, shape (3,).
        home: Home joint positions, shape (6,) [rad].

    Returns:
        n moves; one without a problem is continuous, within limits and free of collision at every
        step.
    """
    counts = steps_needed(start, end)
    owner = np.repeat(np.arange(len(counts)), counts)
    first = np.cumsum(counts) - counts
    share = (np.arange(len(owner)) - first[owner] + 1) / counts[owner]
    positions = start.positions[owner] + share[:, None] * (end.positions - start.positions)[owner]
    directions = interpolate_directions(start.directions[owner], end.directions[owner], share)
    rolls = start.rolls[owner] + share * (end.rolls - start.rolls)[owner]
    branches, _ = solve_views(world.arm, positions, directions, rolls, reference, home)
    q, reached = _continue(start.q, counts, first, branches)
    done = np.arange(len(owner)) - first[owner] < reached[owner]
    good = np.zeros(len(owner), dtype=bool)
    good[done] = world.arm.within_limits(q[done])
    pairs: dict[int, str] = {}
    for number, pair in zip(np.flatnonzero(good), world.pairs(q[good]), strict=True):
        if pair is not None:
            pairs[int(number)] = pair
    moves = []
    for move in range(len(counts)):
        part = slice(first[move], first[move] + reached[move])
        problem = "" if reached[move] == counts[move] else "no continuous inverse kinematics"
        hit = next((pairs[i] for i in range(part.start, part.stop) if i in pairs), None)
        if hit:
            problem = f"collision of {hit}"
        elif not np.all(good[part]):
            problem = "joint limits"
        moves.append(Move(np.vstack([start.q[move], q[part]]), problem))
    return moves


def same_joints(first: Array, second: Array) -> bool:
    """Tells whether two joint positions, shape (6,) [rad], are the same, windings included."""
    return bool(np.abs(first - second).max() < _SAME)


def _continue(
    q_start: Array, counts: NDArray[np.int64], first: NDArray[np.int64], branches: Array
) -> tuple[Array, NDArray[np.int64]]:
    """Goes along all moves step by step, always on in the nearest branch.

    Returns:
        Joint positions of all steps, and how many steps of each move could be gone.
    """
    q = np.full((len(branches), 6), np.nan)
    here = q_start.copy()
    reached = np.zeros(len(counts), dtype=np.int64)
    alive = np.ones(len(counts), dtype=bool)
    for step in range(int(counts.max(initial=0))):
        moving = np.flatnonzero(alive & (counts > step))
        if not len(moving):
            break
        rows = first[moving] + step
        options = nearest_winding(branches[rows], here[moving][:, None])
        jumps = np.abs(options - here[moving][:, None]).max(axis=2)
        jumps[np.isnan(jumps)] = np.inf
        best = np.argmin(jumps, axis=1)
        fine = jumps[np.arange(len(moving)), best] <= JUMP_RAD
        going = moving[fine]
        here[going] = options[np.arange(len(moving)), best][fine]
        q[rows[fine]] = here[going]
        reached[going] = step + 1
        alive[moving[~fine]] = False
    return q, reached
