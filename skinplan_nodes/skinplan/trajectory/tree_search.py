"""Free joint-space motion by two random trees that grow toward each other (RRT-Connect)."""

import numpy as np

from skinplan.robot.collision import CollisionWorld
from skinplan.transforms import Array

_REACH_RAD = 1.0  # how far the region that is sampled goes beyond the two ends
_STEP_RAD = 0.5
_SHORTCUTS = 40


class _Tree:
    def __init__(self, root: Array) -> None:
        self.nodes = [root]
        self.parents = [-1]

    def nearest(self, q: Array) -> int:
        return int(np.argmin(np.linalg.norm(np.array(self.nodes) - q, axis=1)))

    def add(self, q: Array, parent: int) -> int:
        self.nodes.append(q)
        self.parents.append(parent)
        return len(self.nodes) - 1

    def branch(self, node: int) -> list[Array]:
        """Nodes from the root to a node."""
        result = []
        while node >= 0:
            result.append(self.nodes[node])
            node = self.parents[node]
        return result[::-1]


def connect(
    world: CollisionWorld, start: Array, end: Array, iterations: int, seed: int = 0
) -> list[Array] | None:
    """Finds corners of a collision-free joint-space polyline.

    Args:
        world: Arm and surroundings.
        start: Joint positions, shape (6,) [rad], free.
        end: Joint positions, shape (6,) [rad], free.
        iterations: Samples to try; the same number and seed give the same answer.
        seed: Of the samples.

    Returns:
        Corners from start to end, each of shape (6,) [rad]; None = not found.
    """
    random = np.random.default_rng(seed)
    low = np.maximum(np.minimum(start, end) - _REACH_RAD, world.arm.lower)
    high = np.minimum(np.maximum(start, end) + _REACH_RAD, world.arm.upper)
    # A joint that neither end moves (the last one, where roll is free) is left alone.
    still = np.abs(end - start) < 1e-9
    still[:-1] = False
    trees = [_Tree(start), _Tree(end)]
    for turn in range(iterations):
        mine, other = trees[turn % 2], trees[1 - turn % 2]
        goal = random.uniform(low, high)
        goal[still] = start[still]
        grown = _extend(world, mine, goal)
        if grown is None:
            continue
        met = _reach(world, other, mine.nodes[grown])
        if met is None:
            continue
        first, second = mine.branch(grown), other.branch(met)
        corners = first + second[-2::-1] if turn % 2 == 0 else second + first[-2::-1]
        return shorten(world, corners)
    return None


def shorten(world: CollisionWorld, corners: list[Array]) -> list[Array]:
    """Leaves out corners where the straight motion past them is free, the farthest first."""
    result = [corners[0]]
    here = 0
    while here < len(corners) - 1:
        following = len(corners) - 1
        while following > here + 1 and not world.free_motion(corners[here], corners[following]):
            following -= 1
        result.append(corners[following])
        here = following
    return result


def shortcut(world: CollisionWorld, corners: list[Array], seed: int = 0) -> list[Array]:
    """Cuts a joint-space polyline short where the straight motion between two places is free.

    Args:
        world: Arm and surroundings.
        corners: Each of shape (6,) [rad].
        seed: Of the places that are tried.

    Returns:
        Corners from the same start to the same end.
    """
    random = np.random.default_rng(seed)
    q = np.array(shorten(world, corners))
    for _ in range(_SHORTCUTS):
        if len(q) < 3:
            break
        way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1)))
        places = np.sort(random.uniform(0.0, way[-1], 2))
        steps = np.clip(np.searchsorted(way, places, side="right") - 1, 0, len(q) - 2)
        if steps[0] == steps[1]:
            continue
        share = (places - way[steps]) / np.maximum(way[steps + 1] - way[steps], 1e-12)
        ends = q[steps] + share[:, None] * (q[steps + 1] - q[steps])
        if world.free_motion(ends[0], ends[1]):
            q = np.vstack([q[: steps[0] + 1], ends, q[steps[1] + 1 :]])
    return list(q)


def _extend(world: CollisionWorld, tree: _Tree, goal: Array) -> int | None:
    nearest = tree.nearest(goal)
    origin = tree.nodes[nearest]
    gap = float(np.linalg.norm(goal - origin))
    q = goal if gap <= _STEP_RAD else origin + _STEP_RAD / gap * (goal - origin)
    return tree.add(q, nearest) if world.free_motion(origin, q) else None


def _reach(world: CollisionWorld, tree: _Tree, goal: Array) -> int | None:
    """Goes on toward a place until it is reached (its node) or the way is blocked (None)."""
    while True:
        node = _extend(world, tree, goal)
        if node is None or np.array_equal(tree.nodes[node], goal):
            return node
