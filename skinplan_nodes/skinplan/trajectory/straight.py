"""Straight Cartesian moves: position on a line, view on a great arc, joints by bisection.

A move between two joint positions is cut in halves until, in the middle of each piece, the straight
joint motion deviates from the straight scanner motion by no more than a bound (a mid-point test, no
threshold on joint jumps). Ends of two IK branches, or of two windings, never pass it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.robot.collision import CollisionWorld
from skinplan.robot.dexterity import Dexterity
from skinplan.robot.reach import nearest_solutions
from skinplan.robot.scanner_pose import interpolate_directions
from skinplan.transforms import Array

STEP_M = 0.04
STEP_RAD = float(np.radians(6.0))
DEVIATION_M = 0.0005  # of straight joint motion from the scanner's line, in the middle of a piece
DEVIATION_RAD = float(np.radians(0.1))
JUMP_RAD = 0.6  # per step: more is not worth a test
_LEAST_SHARE = 1.0 / 4096.0  # a piece that fails even when it is so short is no continuous motion
_SAME = 1e-6

NO_IK = "no continuous inverse kinematics"
LIMITS = "joint limits"
SINGULAR = "a singular position of elbow or wrist"


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
        q: Joint positions on the way, ends included, shape (k, 6) [rad]; only the start where it
            fails.
        problem: Why it can't be driven; empty = it can.
    """

    q: Array
    problem: str


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Pieces of moves that have not passed the test yet: move, shares and joints at both ends."""

    move: NDArray[np.int64]
    share: Array
    q: Array


def steps_needed(start: Poses, end: Poses) -> NDArray[np.int64]:
    """Returns how many steps of at most `STEP_M` and `STEP_RAD` moves need, shape (n,)."""
    distance = np.linalg.norm(end.positions - start.positions, axis=1)
    steps = np.ceil(np.maximum(distance / STEP_M, _turns(start, end) / STEP_RAD) - 1e-9)
    return np.maximum(steps, 1).astype(np.int64)


def follow(
    world: CollisionWorld,
    dexterity: Dexterity,
    start: Poses,
    end: Poses,
    reference: Array,
    home: Array,
) -> list[Move]:
    """Follows straight moves from the start's joint positions to the end's.

    Args:
        world: Arm and surroundings.
        dexterity: What is singular.
        start: n starts.
        end: n ends.
        reference: Unit direction that rolls are counted from, shape (3,).
        home: Home joint positions, shape (6,) [rad].

    Returns:
        n moves. One without a problem stays on its line and in its IK branch, within limits and
        away from singular positions; at `DEVIATION_M` and `DEVIATION_RAD` between its positions;
        and free of collision along straight joint motion between them, checked so densely that no
        body moves more than `CollisionWorld.step_m` from one check to the next.
    """
    count = len(start.q)
    move, share, q, continuous = _bisected(world, start, end, reference, home)
    order = np.lexsort((share, move))
    move, q = move[order], q[order]
    problems = np.where(continuous, "", NO_IK).astype(object)
    for bad, text in ((~world.arm.within_limits(q), LIMITS), (~dexterity.clear(q), SINGULAR)):
        hit = np.unique(move[bad])
        problems[hit[problems[hit] == ""]] = text
    knots = np.split(q, np.searchsorted(move, np.arange(1, count)))[:count]
    _check_collisions(world, knots, problems)
    return [
        Move(knots[i] if not problems[i] else start.q[i : i + 1], str(problems[i]))
        for i in range(count)
    ]


def nearest_ends(
    world: CollisionWorld, start: Poses, end: Poses, reference: Array, home: Array
) -> Poses:
    """Gives ends the joint positions that are nearest to the start's; the start's where none is."""
    q = nearest_solutions(
        world.arm, end.positions, end.directions, end.rolls, reference, home, start.q
    )
    lost = np.isnan(q[:, 0])
    q[lost] = start.q[lost]
    return Poses(q, end.positions, end.directions, end.rolls)


def same_joints(first: Array, second: Array) -> bool:
    """Tells whether two joint positions, shape (6,) [rad], are the same, windings included."""
    return bool(np.abs(first - second).max() < _SAME)


def _bisected(
    world: CollisionWorld, start: Poses, end: Poses, reference: Array, home: Array
) -> tuple[NDArray[np.int64], Array, Array, NDArray[np.bool_]]:
    """Cuts moves until all pieces pass.

    Returns:
        Knots: number of the move, share of the way, joint positions; and which moves passed.
    """
    count = len(start.q)
    everyone = np.arange(count)
    good = np.ones(count, dtype=bool)
    knots = [
        (everyone, np.zeros(count), start.q),
        (everyone, np.ones(count), end.q),
    ]
    pieces = _Pieces(everyone, np.tile([0.0, 1.0], (count, 1)), np.stack([start.q, end.q], axis=1))
    size = np.stack([np.linalg.norm(end.positions - start.positions, axis=1), _turns(start, end)])
    while len(pieces.move):
        move, share = pieces.move, pieces.share.mean(axis=1)
        middle = pieces.q.mean(axis=1)
        positions, directions, rolls = _between(start, end, move, share)
        q = nearest_solutions(world.arm, positions, directions, rolls, reference, home, middle)
        found = np.isfinite(q[:, 0])
        good[move[~found]] = False
        knots.append((move[found], share[found], q[found]))
        passed = _passes(world, middle, positions, directions)
        width = np.diff(pieces.share, axis=1)[:, 0]
        passed &= np.all(width * size[:, move] <= 2.0 * np.array([[STEP_M], [STEP_RAD]]), axis=0)
        # So much joint motion on so short a piece: its ends are of two branches or windings.
        jump = np.abs(np.diff(pieces.q, axis=1)[:, 0]).max(axis=1) > JUMP_RAD
        passed &= ~jump
        short = np.all(width * size[:, move] <= np.array([[STEP_M], [STEP_RAD]]), axis=0)
        good[move[~passed & ((width <= _LEAST_SHARE) | (jump & short))]] = False
        left = np.flatnonzero(~passed & good[move])
        pieces = _halved(pieces, left, share, q)
    return (
        np.concatenate([k[0] for k in knots]),
        np.concatenate([k[1] for k in knots]),
        np.concatenate([k[2] for k in knots]),
        good,
    )


def _halved(pieces: _Pieces, which: NDArray[np.int64], share: Array, q: Array) -> _Pieces:
    ends, joints = pieces.share[which], pieces.q[which]
    first = np.stack([ends[:, 0], share[which]], axis=1)
    second = np.stack([share[which], ends[:, 1]], axis=1)
    return _Pieces(
        np.tile(pieces.move[which], 2),
        np.concatenate([first, second]),
        np.concatenate(
            [
                np.stack([joints[:, 0], q[which]], axis=1),
                np.stack([q[which], joints[:, 1]], axis=1),
            ]
        ),
    )


def _between(
    start: Poses, end: Poses, move: NDArray[np.int64], share: Array
) -> tuple[Array, Array, Array]:
    """Positions, directions and rolls at shares of moves."""
    step = share[:, None] * (end.positions - start.positions)[move]
    directions = interpolate_directions(start.directions[move], end.directions[move], share)
    rolls = start.rolls[move] + share * (end.rolls - start.rolls)[move]
    return start.positions[move] + step, directions, rolls


def _passes(
    world: CollisionWorld, q: Array, positions: Array, directions: Array
) -> NDArray[np.bool_]:
    """The mid-point test: joint positions, (n, 6) [rad], bring the scanner to its line."""
    frames = world.arm.forward_scanner(q)
    off = np.linalg.norm(frames[:, :3, 3] - positions, axis=1)
    # The chord between unit vectors: exact enough for small angles, and stable there.
    turned = np.linalg.norm(frames[:, :3, 0] - directions, axis=1)
    return np.asarray((off <= DEVIATION_M) & (turned <= DEVIATION_RAD))


def _check_collisions(world: CollisionWorld, knots: list[Array], problems: Array) -> None:
    """Notes collisions along the moves that have no problem so far."""
    dense = [world.dense(q)[0] if not problems[i] else q[:0] for i, q in enumerate(knots)]
    owner = np.repeat(np.arange(len(dense)), [len(q) for q in dense])
    if not len(owner):
        return
    codes = world.codes(np.concatenate(dense))
    for row in np.flatnonzero(codes)[::-1]:  # the first one of a move has the last word
        problems[owner[row]] = f"collision of {world.names[codes[row]]}"


def _turns(start: Poses, end: Poses) -> Array:
    """The larger of view and roll change of moves, shape (n,) [rad]."""
    angle = np.arccos(np.clip(np.einsum("ni,ni->n", start.directions, end.directions), -1.0, 1.0))
    return np.asarray(np.maximum(angle, np.abs(end.rolls - start.rolls)))
