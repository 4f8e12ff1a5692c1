"""Motion between scans: joint-space moves checked for collision, with retreats where needed."""

from dataclasses import dataclass
from itertools import product

import numpy as np

from skinplan.robot.collision import CollisionWorld
from skinplan.robot.dexterity import Dexterity
from skinplan.trajectory.blend import blended
from skinplan.trajectory.durations import polyline_s, rest_to_rest
from skinplan.trajectory.straight import Poses, follow, nearest_ends
from skinplan.trajectory.tree_search import connect, shortcut
from skinplan.transforms import Array

_RETREATS_M = (0.06, 0.15)
_SEARCHES = 16  # tree searches for all of a station ...
_ITERATIONS = 200  # ... and samples of each
_MOVING_RAD = 1e-9


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


@dataclass(frozen=True, eq=False)
class Transit:
    """A motion between two stops, free of collision.

    Attributes:
        legs: Joint paths driven one after the other, at rest in between, each of shape (k >= 2, 6)
            [rad]; none where both stops are the same.
        seconds: About how long it takes [s].
        detour_s: How much longer that is than the straight joint motion [s].
    """

    legs: tuple[Array, ...]
    seconds: float
    detour_s: float

    def reversed(self) -> "Transit":
        """Returns the motion back."""
        return Transit(tuple(leg[::-1] for leg in self.legs[::-1]), self.seconds, self.detour_s)


class TransitPlanner:
    """Plans collision-free joint paths between stops at one station.

    The quickest of these that is free: straight in joint space, with retreats along the view axes
    at either end, via home. Where none is, both ends are joined to home by two random trees that
    grow toward each other (RRT-Connect); a way home that was found is a gate for later stops near
    it. What comes of that is cut short. Corners are rounded where that is free, too.
    """

    def __init__(
        self,
        world: CollisionWorld,
        dexterity: Dexterity,
        reference: Array,
        home: Array,
        velocity: Array,
        acceleration: float,
        seed: int = 0,
    ) -> None:
        """Takes a station.

        Args:
            world: Arm and surroundings.
            dexterity: What is singular.
            reference: Unit direction that rolls are counted from, shape (3,).
            home: Home joint positions, shape (6,) [rad].
            velocity: Joint velocity limits, shape (6,) [rad/s].
            acceleration: Joint acceleration limit [rad/s^2].
            seed: Of the random trees.
        """
        self._world, self._dexterity = world, dexterity
        self._reference, self._home = reference, home
        self._limits = (velocity, acceleration)
        self._seed = seed
        self._searches = _SEARCHES
        self._gates: list[list[Array]] = []  # corners of ways home
        self._ways_home: dict[bytes, list[Array] | None] = {}
        self._known: dict[bytes, bool] = {}

    def stop(self, pose: Poses) -> Stop:
        """Makes a stop at a scan pose (one, n = 1): retreats are followed along the view axis."""
        ways = [pose.q]
        for retreat in _RETREATS_M:
            back = Poses(
                pose.q, pose.positions - retreat * pose.directions, pose.directions, pose.rolls
            )
            back = nearest_ends(self._world, pose, back, self._reference, self._home)
            move = follow(self._world, self._dexterity, pose, back, self._reference, self._home)[0]
            if move.problem:
                break
            ways.append(move.q)
        return Stop(pose.q[0], tuple(ways))

    def resting(self, q: Array) -> Stop:
        """Makes a stop without retreats, such as home."""
        return Stop(q, (q[None],))

    def plan(self, start: Stop, end: Stop) -> Transit | None:
        """Plans the motion between two stops.

        Args:
            start: Where the arm stands.
            end: Where it goes.

        Returns:
            The motion; None = none found.
        """
        if np.abs(start.q - end.q).max() < _MOVING_RAD:
            return Transit((), 0.0, 0.0)
        options: list[tuple[float, int, list[Array], list[Array]]] = []
        for out, back, home in product(start.ways_out, end.ways_out, (False, True)):
            middle = [out[-1], self._home, back[-1]] if home else [out[-1], back[-1]]
            lines = [np.stack(pair) for pair in zip(middle, middle[1:], strict=False)]
            legs = _moving([out, *lines, back[::-1]])
            options.append((self._seconds(legs), len(options), lines, legs))
        for _, _, lines, legs in sorted(options, key=lambda o: (round(o[0], 9), o[1])):
            if all(self._free(line[0], line[1]) for line in lines):
                return self._made(start, end, legs)
        return self._by_gates(start, end)

    def _seconds(self, legs: list[Array]) -> float:
        return sum(polyline_s(leg, *self._limits) for leg in legs)

    def _made(self, start: Stop, end: Stop, legs: list[Array]) -> Transit:
        smooth = blended(self._world, legs)
        seconds = self._seconds(smooth)
        direct = float(rest_to_rest(np.abs(end.q - start.q), *self._limits))
        return Transit(tuple(smooth), seconds, max(0.0, seconds - direct))

    def _free(self, a: Array, b: Array) -> bool:
        """Free motion, both ways; asked once for each pair (the ways home come again and again)."""
        key = b"".join(sorted((a.tobytes(), b.tobytes())))
        if key not in self._known:
            self._known[key] = self._world.free_motion(a, b)
        return self._known[key]

    def _by_gates(self, start: Stop, end: Stop) -> Transit | None:
        out = self._way_home(start)
        back = self._way_home(end) if out is not None else None
        if out is None or back is None:
            return None
        corners = shortcut(self._world, [*out, *back[-2::-1]], self._seed)
        lines = [np.stack(pair) for pair in zip(corners, corners[1:], strict=False)]
        return self._made(start, end, _moving(lines))

    def leads_home(self, stop: Stop) -> bool:
        """Tells whether a way home from a stop is known or found; two such stops can be joined."""
        return self._way_home(stop) is not None

    def _way_home(self, stop: Stop) -> list[Array] | None:
        """Corners of a free way home, the stop's retreat first; found once."""
        key = stop.q.tobytes()
        if key not in self._ways_home:
            self._ways_home[key] = self._found_way_home(stop)
        return self._ways_home[key]

    def _found_way_home(self, stop: Stop) -> list[Array] | None:
        for way in stop.ways_out[::-1]:
            if self._free(way[-1], self._home):
                return [*way, self._home]
        for gate in self._gates:
            for way in stop.ways_out[::-1]:
                if self._free(way[-1], gate[0]):
                    return [*way, *gate]
        if self._searches <= 0:
            return None
        self._searches -= 1
        way = stop.ways_out[-1]
        corners = connect(self._world, way[-1], self._home, _ITERATIONS, self._seed)
        if corners is None:
            return None
        self._gates.append(corners)
        return [*way, *corners[1:]]


def _moving(legs: list[Array]) -> list[Array]:
    """Leaves out legs without motion."""
    return [
        leg for leg in legs if len(leg) > 1 and np.abs(np.diff(leg, axis=0)).max() > _MOVING_RAD
    ]
