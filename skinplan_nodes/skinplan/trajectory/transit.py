"""Motion between scans: joint-space moves checked for collision, with retreats where needed."""

from dataclasses import dataclass

import numpy as np

from skinplan.robot.collision import CollisionWorld
from skinplan.trajectory.straight import Poses, follow
from skinplan.trajectory.tree_search import connect, shorten
from skinplan.transforms import Array

_RETREATS_M = (0.06, 0.15)
_TREE_ITERATIONS = 120  # for one way home
_TREE_BUDGET = 360  # for all of a station


@dataclass(frozen=True, eq=False)
class Stop:
    """A place where the arm can stand still.

    Attributes:
        q: Joint positions, shape (6,) [rad].
        ways_out: Joint paths away from the part, each of shape (k, 6) [rad] from ``q`` on: none,
            then longer retreats.
    """

    q: Array
    ways_out: tuple[Array, ...]


class TransitPlanner:
    """Plans collision-free joint paths between stops at one station.

    Tried in this order, the first that is free wins: straight in joint space; the same after
    retreats along the view axes at both ends; via home; via home with retreats. When asked to be
    thorough: via home on ways that a tree search found.
    """

    def __init__(self, world: CollisionWorld, reference: Array, home: Array) -> None:
        self._world = world
        self._reference = reference
        self._home = home
        self._home_ways: dict[bytes, list[Array] | None] = {}
        self._budget = _TREE_BUDGET
        self._known: dict[bytes, bool] = {}

    def stop(self, pose: Poses) -> Stop:
        """Makes a stop at a scan pose (one, n = 1): retreats are followed along the view axis."""
        ways = [pose.q]
        for retreat in _RETREATS_M:
            back = Poses(
                pose.q, pose.positions - retreat * pose.directions, pose.directions, pose.rolls
            )
            move = follow(self._world, pose, back, self._reference, self._home)[0]
            if not move.problem:
                ways.append(move.q)
        return Stop(pose.q[0], tuple(ways))

    def resting(self, q: Array) -> Stop:
        """Makes a stop without retreats, such as home."""
        return Stop(q, (q[None],))

    def plan(self, start: Stop, end: Stop, thorough: bool = False) -> list[Array] | None:
        """Plans the motion between two stops.

        Args:
            start: Where the arm stands.
            end: Where it goes.
            thorough: Search with random trees too when nothing simple is free.

        Returns:
            Joint paths driven one after the other, at rest in between, each of shape (k, 6) [rad];
            None = none found.
        """
        if np.array_equal(start.q, end.q):
            return []
        for via_home in (False, True):
            for level in range(max(len(start.ways_out), len(end.ways_out))):
                out = start.ways_out[min(level, len(start.ways_out) - 1)]
                back = end.ways_out[min(level, len(end.ways_out) - 1)][::-1]
                corners = [out[-1], self._home, back[0]] if via_home else [out[-1], back[0]]
                if all(self._free(a, b) for a, b in zip(corners, corners[1:], strict=False)):
                    legs = [
                        out,
                        *(np.stack(pair) for pair in zip(corners, corners[1:], strict=False)),
                        back,
                    ]
                    return _moving(legs)
        return self._plan_thoroughly(start, end) if thorough else None

    def _free(self, a: Array, b: Array) -> bool:
        """Free motion, both ways; asked once for each pair (the ways home come again and again)."""
        key = b"".join(sorted((a.tobytes(), b.tobytes())))
        if key not in self._known:
            self._known[key] = self._world.free_motion(a, b)
        return self._known[key]

    def _plan_thoroughly(self, start: Stop, end: Stop) -> list[Array] | None:
        out, back = self._way_home(start), self._way_home(end)
        if out is None or back is None:
            return None
        corners = shorten(self._world, [*out, *back[-2::-1]])
        return _moving([np.stack(pair) for pair in zip(corners, corners[1:], strict=False)])

    def _way_home(self, stop: Stop) -> list[Array] | None:
        """Corners of a free way home; searched once for each stop."""
        key = stop.q.tobytes()
        if key not in self._home_ways:
            way: list[Array] | None = [stop.q, self._home]
            if not self._free(stop.q, self._home):
                iterations = min(_TREE_ITERATIONS, self._budget)
                way = connect(self._world, stop.q, self._home, iterations)
                self._budget -= iterations if way is None else 0
            self._home_ways[key] = way
        return self._home_ways[key]


def _moving(legs: list[Array]) -> list[Array]:
    """Leaves out legs without motion."""
    return [leg for leg in legs if len(leg) > 1 and np.abs(np.diff(leg, axis=0)).max() > 1e-9]
