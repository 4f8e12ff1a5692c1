"""The way through a station's points: ladder graph, edges checked lazily, breaks planned."""

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import CancelledError
from skinplan.robot.collision import CollisionWorld
from skinplan.robot.reach import Reached
from skinplan.trajectory.ladder import BREAK, STRAIGHT, Ladder
from skinplan.trajectory.straight import JUMP_RAD, Poses, follow, same_joints, steps_needed
from skinplan.trajectory.transit import Stop, TransitPlanner
from skinplan.transforms import Array

_LOG = logging.getLogger(__name__)
_ROUNDS = (
    400  # a bound on the repetitions of "solve, check, forbid"; each one forbids at least one edge
)
_THOROUGH_STATES = 3  # joint positions of a point, nearest to home, that get a thorough search
NO_MOTION = "no collision-free motion to it was found"


@dataclass(frozen=True, eq=False)
class Problem:
    """What stays the same during the search at one station.

    Attributes:
        world: Arm and surroundings.
        reference: Unit direction that rolls are counted from, shape (3,).
        home: Home joint positions, shape (6,) [rad]: the end.
        start: Start joint positions, shape (6,) [rad].
        tcp_speed: Speed limit of the scanner [m/s].
        velocity: Joint velocity limits, shape (6,) [rad/s].
        acceleration: Joint acceleration limit [rad/s^2].
        progress: Told the share done, in [0, 1].
        is_cancelled: Asked now and then.
    """

    world: CollisionWorld
    reference: Array
    home: Array
    start: Array
    tcp_speed: float
    velocity: Array
    acceleration: float
    progress: Callable[[float], None]
    is_cancelled: Callable[[], bool]


@dataclass(frozen=True, eq=False)
class Way:
    """The way found.

    Attributes:
        points: Points visited, in order, shape (n,).
        edges: n + 1 edges: start to first point, between points, last point to home. A straight one
            is the joint positions on it, shape (k, 6) [rad]; a break is a list of joint paths
            driven one after the other.
        states: Joint positions at the points, shape (n, 6) [rad].
        dropped: Points left out, with the reason.
    """

    points: NDArray[np.int64]
    edges: list[Array | list[Array]]
    states: Array
    dropped: dict[int, str]


class Search:
    """Searches the way through ordered points; keeps what it has checked, to be asked again."""

    def __init__(self, problem: Problem, order: NDArray[np.int64], reached: Reached) -> None:
        """Prepares the search.

        Args:
            problem: The station.
            order: Views in the order of visit, all of them reached, shape (n,).
            reached: Joint positions for the views.
        """
        self._problem = problem
        self._reached = reached
        self._points = [int(p) for p in order]
        self._states = {p: np.flatnonzero(reached.view == p) for p in self._points}
        self._transits = TransitPlanner(problem.world, problem.reference, problem.home)
        self._straight: dict[
            tuple[int, int], Array
        ] = {}  # checked and good: (state, state) -> joint positions
        self._no_straight: set[tuple[int, int]] = set()
        self._breaks: dict[tuple[int, int], list[Array]] = {}
        self._no_break: set[tuple[int, int]] = set()
        self._stops: dict[int, Stop] = {}
        self._hard: set[int] = set()  # states of points that nothing simple leads to
        self._dropped: dict[int, str] = {}

    def run(self) -> Way:
        """Finds the way; points that can't be joined are dropped.

        Raises:
            CancelledError: The caller asked to stop.
        """
        while self._points:
            ladder = self._ladder()
            for number in range(_ROUNDS):
                if self._problem.is_cancelled():
                    raise CancelledError("the search for a trajectory was cancelled")
                solved = ladder.solve()
                if isinstance(solved, int):
                    break
                states, kinds, seconds = solved
                if self._check(ladder, states, kinds):
                    _LOG.debug(
                        "%d points: %.1f s after %d rounds", len(self._points), seconds, number + 1
                    )
                    return self._way(states, kinds)
            else:
                solved = self._first_open(ladder)
            self._drop(solved)
        return Way(np.zeros(0, dtype=np.int64), [], np.zeros((0, 6)), self._dropped)

    def forbid(self, way: Way, edge: int) -> None:
        """Takes an edge of a way out that turned out to be impossible later on."""
        pair = self._pairs_of(way)[edge]
        (self._no_break if isinstance(way.edges[edge], list) else self._no_straight).add(pair)

    def drop_after(self, way: Way, edge: int) -> None:
        """Drops the point that an edge leads to (of the edge to home: that it comes from)."""
        point = int(way.points[min(edge, len(way.points) - 1)])
        if point in self._points:
            self._points.remove(point)
            self._dropped[point] = NO_MOTION

    def _pairs_of(self, way: Way) -> list[tuple[int, int]]:
        ids = [-1]
        for point, q in zip(way.points, way.states, strict=True):
            options = self._states[int(point)]
            ids.append(int(options[np.argmin(np.abs(self._reached.q[options] - q).max(axis=1))]))
        return list(zip(ids, [*ids[1:], -2], strict=True))

    def _ladder(self) -> Ladder:
        problem, reached = self._problem, self._reached
        groups = [self._states[p] for p in self._points]
        least: list[Array | None] = [None]
        for a, b in zip(groups, groups[1:], strict=False):
            least.append(self._straight_seconds(a, b))
        least.append(None)
        layers = [problem.start[None], *(reached.q[g] for g in groups), problem.home[None]]
        ladder = Ladder(layers, least, problem.velocity, problem.acceleration)
        self._ids = [np.array([-1]), *groups, np.array([-2])]
        for layer, (a, b) in enumerate(zip(self._ids, self._ids[1:], strict=False)):
            self._apply_forbidden(ladder, layer, a, b)
        return ladder

    def _apply_forbidden(
        self, ladder: Ladder, layer: int, a: NDArray[np.int64], b: NDArray[np.int64]
    ) -> None:
        if not self._no_straight and not self._no_break:
            return
        for i, first in enumerate(a.tolist()):
            for j, second in enumerate(b.tolist()):
                if (first, second) in self._no_straight:
                    ladder.forbid_straight(layer, i, j)
                if (first, second) in self._no_break:
                    ladder.forbid_break(layer, i, j)

    def _straight_seconds(self, a: NDArray[np.int64], b: NDArray[np.int64]) -> Array:
        """Least time of straight moves between two layers; inf where joints would have to jump."""
        first, second = self._poses(np.repeat(a, len(b))), self._poses(np.tile(b, len(a)))
        seconds = (
            np.linalg.norm(second.positions - first.positions, axis=1) / self._problem.tcp_speed
        )
        change = np.abs(second.q - first.q).max(axis=1)
        seconds[change > JUMP_RAD * steps_needed(first, second)] = np.inf
        return np.asarray(seconds.reshape(len(a), len(b)))

    def _poses(self, states: NDArray[np.int64]) -> Poses:
        r = self._reached
        return Poses(r.q[states], r.positions[states], r.directions[states], r.rolls[states])

    def _check(self, ladder: Ladder, states: NDArray[np.int64], kinds: NDArray[np.int64]) -> bool:
        """Checks new edges of the best way; forbids the bad ones. True = all are good."""
        ids = [int(self._ids[layer][state]) for layer, state in enumerate(states)]
        pairs = list(zip(ids, ids[1:], strict=False))
        straight = [
            i for i, k in enumerate(kinds) if k == STRAIGHT and pairs[i] not in self._straight
        ]
        good = self._check_straight(ladder, states, straight, pairs)
        if not good:
            return False
        stops = [i for i, k in enumerate(kinds) if k == BREAK and pairs[i] not in self._breaks]
        for number, layer in enumerate(stops):
            self._problem.progress(number / len(stops))
            if self._problem.is_cancelled():
                raise CancelledError("the search for a trajectory was cancelled")
            first, second = pairs[layer]
            thorough = first in self._hard or second in self._hard
            plan = self._transits.plan(self._stop(first), self._stop(second), thorough)
            if plan is None:
                self._no_break.add(pairs[layer])
                ladder.forbid_break(layer, int(states[layer]), int(states[layer + 1]))
                good = False
            else:
                self._breaks[pairs[layer]] = plan
        return good

    def _check_straight(
        self,
        ladder: Ladder,
        states: NDArray[np.int64],
        layers: list[int],
        pairs: list[tuple[int, int]],
    ) -> bool:
        if not layers:
            return True
        first = self._poses(np.array([pairs[i][0] for i in layers]))
        second = self._poses(np.array([pairs[i][1] for i in layers]))
        problem = self._problem
        good = True
        for i, move in zip(
            layers,
            follow(problem.world, first, second, problem.reference, problem.home),
            strict=True,
        ):
            state, end = pairs[i]
            if not move.problem and same_joints(move.q[-1], self._reached.q[end]):
                self._straight[(state, end)] = move.q
                continue
            good = False
            for column in self._same_view(i, end, bool(move.problem), move.q[-1]):
                self._no_straight.add((state, int(self._ids[i + 1][column])))
                ladder.forbid_straight(i, int(states[i]), int(column))
        return good

    def _same_view(self, layer: int, end: int, failed: bool, q: Array) -> list[int]:
        """States of the next layer that a move fails to reach: all of the view but its end."""
        reached = self._reached
        result = []
        for column, other in enumerate(self._ids[layer + 1].tolist()):
            gap = np.abs(reached.positions[other] - reached.positions[end]).max()
            gap = max(gap, np.abs(reached.directions[other] - reached.directions[end]).max())
            same = max(gap, abs(reached.rolls[other] - reached.rolls[end])) < 1e-9
            if same and (failed or not same_joints(q, reached.q[other])):
                result.append(column)
        return result

    def _stop(self, state: int) -> Stop:
        if state < 0:
            return self._transits.resting(
                self._problem.start if state == -1 else self._problem.home
            )
        if state not in self._stops:
            self._stops[state] = self._transits.stop(self._poses(np.array([state])))
        return self._stops[state]

    def _way(self, states: NDArray[np.int64], kinds: NDArray[np.int64]) -> Way:
        ids = [int(self._ids[layer][state]) for layer, state in enumerate(states)]
        edges: list[Array | list[Array]] = []
        for pair, kind in zip(zip(ids, ids[1:], strict=False), kinds, strict=True):
            edges.append(self._straight[pair] if kind == STRAIGHT else self._breaks[pair])
        return Way(np.array(self._points), edges, self._reached.q[ids[1:-1]], dict(self._dropped))

    def _first_open(self, ladder: Ladder) -> int:
        """Layer to drop when the rounds are used up: the first with an unchecked edge."""
        solved = ladder.solve()
        if isinstance(solved, int):
            return solved
        states, kinds, _ = solved
        ids = [int(self._ids[layer][state]) for layer, state in enumerate(states)]
        for layer, pair in enumerate(zip(ids, ids[1:], strict=False)):
            if pair not in (self._straight if kinds[layer] == STRAIGHT else self._breaks):
                return layer + 1
        return len(ids) - 2

    def _drop(self, layer: int) -> None:
        """Gives a point up, or first marks it for a thorough search. Last layer: the last point."""
        place = min(layer - 1, len(self._points) - 1)
        options = self._states[self._points[place]]
        gaps = np.abs(self._reached.q[options] - self._problem.home).max(axis=1)
        states = set(
            options[np.argsort(np.round(gaps, 9), kind="stable")[:_THOROUGH_STATES]].tolist()
        )
        if not states <= self._hard:
            self._hard |= states
            self._no_break = {pair for pair in self._no_break if not states & set(pair)}
            return
        self._dropped[self._points.pop(place)] = NO_MOTION
