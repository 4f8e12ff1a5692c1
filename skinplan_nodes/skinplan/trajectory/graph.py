"""What is known of the ways between the states of a station: estimates, then what was checked."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from skinplan.errors import CancelledError
from skinplan.robot.collision import CollisionWorld
from skinplan.robot.dexterity import Dexterity
from skinplan.trajectory.durations import pair_changes, rest_to_rest
from skinplan.trajectory.states import States
from skinplan.trajectory.straight import JUMP_RAD, STEP_M, STEP_RAD, Poses, follow
from skinplan.trajectory.transit import Stop, Transit, TransitPlanner
from skinplan.transforms import Array

Indices = NDArray[np.int64]
Pair = tuple[int, int]

BREAK_S = 0.3  # what a stop costs besides the motion: standing still at both ends
BREAK_PRICE_S = 4.0  # what an interruption of the scan has to save at least
START, HOME = -1, -2  # stand for views
_VAIN = 3  # so many stops in vain close a family of states
_KEPT = 1500  # pairs of views whose estimates are kept: bounds memory
_MOTION_S = 0.03  # [s/rad], prefers less joint motion among equally fast ways


@dataclass(frozen=True, eq=False)
class Problem:
    """What stays the same at one station.

    Attributes:
        world: Arm and surroundings.
        dexterity: What is singular.
        reference: Unit direction that rolls are counted from, shape (3,).
        home: Home joint positions, shape (6,) [rad]: the end.
        start: Start joint positions, shape (6,) [rad].
        tcp_speed: Speed limit of the scanner [m/s].
        velocity: Joint velocity limits, shape (6,) [rad/s].
        acceleration: Joint acceleration limit [rad/s^2].
        seed: Of every random draw.
        progress: Told the share done, in [0, 1].
        is_cancelled: Asked now and then.
    """

    world: CollisionWorld
    dexterity: Dexterity
    reference: Array
    home: Array
    start: Array
    tcp_speed: float
    velocity: Array
    acceleration: float
    seed: int
    progress: Callable[[float], None]
    is_cancelled: Callable[[], bool]

    def require_wanted(self) -> None:
        """Ends the planning when the caller asked to stop.

        Raises:
            CancelledError: He did.
        """
        if self.is_cancelled():
            raise CancelledError("the search for a trajectory was cancelled")


class StationGraph:
    """States of a station as nodes, with the start and home as two more.

    Attributes:
        problem: The station.
        states: The states.
        start: Node of the start.
        home: Node of home.
    """

    def __init__(self, problem: Problem, states: States) -> None:
        self.problem = problem
        self.states = states
        self.start, self.home = len(states.q), len(states.q) + 1
        ends = np.stack([problem.start, problem.home])
        frames = problem.world.arm.forward_scanner(ends)
        kept = states.poses
        self._poses = Poses(
            np.vstack([kept.q, ends]),
            np.vstack([kept.positions, frames[:, :3, 3]]),
            np.vstack([kept.directions, frames[:, :3, 0]]),
            np.append(kept.rolls, [0.0, 0.0]),
        )
        self._branch = np.append(problem.dexterity.branches(kept.q), [-1, -2])
        self._may_stop = np.append(states.least_tilted, [True, True])
        # States of one branch and winding hang together: ways home from them are alike.
        turns = np.floor((kept.q + np.pi) / (2.0 * np.pi)).astype(np.int64)
        kinds = np.unique(np.column_stack([self._branch[:-2], turns]), axis=0, return_inverse=True)
        self._family = np.append(kinds[1].reshape(-1), [-1, -2])
        self._vain: dict[int, set[int]] = {}  # the stops of a family that have no way home
        self._transits = TransitPlanner(
            problem.world,
            problem.dexterity,
            problem.reference,
            problem.home,
            problem.velocity,
            problem.acceleration,
            problem.seed,
        )
        self._stops: dict[int, Stop] = {}
        self._estimates: dict[tuple[int, int], tuple[Array, Array]] = {}
        # Checked edges by their first node: what is known of each second one; None = impossible.
        self._straight: dict[int, dict[int, Array | None]] = {}
        self._breaks: dict[int, dict[int, Transit | None]] = {}

    def node_costs(self, nodes: Indices) -> Array:
        """Returns what nodes cost besides the motion, shape (n,) [s]."""
        return np.append(self.states.cost_s, [0.0, 0.0])[nodes]

    def positions(self, nodes: Indices) -> Array:
        """Returns the scanner's origins at nodes in the arm base, shape (n, 3) [m]."""
        return np.asarray(self._poses.positions[nodes])

    def q(self, node: int) -> Array:
        """Returns the joint positions of a node, shape (6,) [rad]."""
        return np.asarray(self._poses.q[node])

    def layer(self, view: int) -> Indices:
        """Returns the nodes of a view, of the start (`START`) or of home (`HOME`)."""
        if view < 0:
            return np.array([self.start if view == START else self.home])
        return self.states.of(view)

    def layer_costs(self, views: Sequence[int]) -> tuple[list[Array], list[Array], list[Array]]:
        """Returns costs for a ladder through views, the start before and home behind them [s].

        Args:
            views: Numbers of the views in the order of visit.

        Returns:
            Costs of the nodes of each layer; of the straight edges from each layer to the next; of
            the breaks.
        """
        way = [START, *views, HOME]
        edges = [self._between(a, b) for a, b in zip(way, way[1:], strict=False)]
        nodes = [self.node_costs(self.layer(view)) for view in way]
        return nodes, [straight for straight, _ in edges], [stop for _, stop in edges]

    def _between(self, first: int, second: int) -> tuple[Array, Array]:
        """Costs of straight edges and breaks between two views; estimates are kept."""
        a, b = self.layer(first), self.layer(second)
        if (first, second) not in self._estimates:
            if len(self._estimates) >= _KEPT:
                self._estimates.clear()
            self._estimates[first, second] = (
                self._straight_estimate(a, b),
                self._break_estimate(a, b),
            )
        straight, stop = (cost.copy() for cost in self._estimates[first, second])
        return self._known_straight(straight, a, b), self._known_breaks(stop, a, b)

    def straight_s(self, first: Indices, second: Indices) -> Array:
        """Returns the cost of straight edges between all pairs, shape (a, b) [s]; inf = none."""
        return self._known_straight(self._straight_estimate(first, second), first, second)

    def break_s(self, first: Indices, second: Indices) -> Array:
        """Returns the cost of breaks between all pairs, shape (a, b) [s]; inf = none.

        The scan stops at views that are tilted no more than they have to be.
        """
        return self._known_breaks(self._break_estimate(first, second), first, second)

    def _known_straight(self, cost: Array, first: Indices, second: Indices) -> Array:
        _patch(cost, self._straight, first, second, lambda known, now: now)
        return cost

    def _known_breaks(self, cost: Array, first: Indices, second: Indices) -> Array:
        _patch(cost, self._breaks, first, second, lambda known, now: now + known.detour_s)
        return cost

    def _straight_estimate(self, first: Indices, second: Indices) -> Array:
        velocity = self.problem.velocity
        slowest, total = pair_changes(self._poses.q[first], self._poses.q[second], velocity)
        way = self._ways(first, second)
        cost = np.maximum(way / self.problem.tcp_speed, slowest) + _MOTION_S * total
        # A cheap look first: ends in different branches, or much joint motion for a short way.
        other = self._branch[first][:, None] != self._branch[second][None]
        looks = self._poses.directions
        turn = 2.0 * np.arcsin(np.minimum(0.5 * cdist(looks[first], looks[second]), 1.0))
        steps = np.ceil(np.maximum(way / STEP_M, turn / STEP_RAD)) + 1.0
        change = slowest * velocity.min()
        cost[other | (change > np.minimum(JUMP_RAD * steps, np.pi))] = np.inf
        return cost

    def _break_estimate(self, first: Indices, second: Indices) -> Array:
        cost = np.full((len(first), len(second)), np.inf)
        rows, columns = (
            np.flatnonzero(self._may_stop[first]),
            np.flatnonzero(self._may_stop[second]),
        )
        a, b = first[rows], second[columns]
        change = np.abs(self._poses.q[b][None] - self._poses.q[a][:, None])
        motion = rest_to_rest(change, self.problem.velocity, self.problem.acceleration)
        ends = (a >= self.start)[:, None] | (b >= self.start)[None]
        price = np.where(ends, 0.0, BREAK_PRICE_S)
        cost[np.ix_(rows, columns)] = BREAK_S + price + motion + _MOTION_S * change.sum(axis=2)
        return cost

    def _ways(self, first: Indices, second: Indices) -> Array:
        """Straight ways of the scanner between all pairs, shape (a, b) [m]."""
        return cdist(self._poses.positions[first], self._poses.positions[second])

    def straight(self, pair: Pair) -> Array:
        """Returns the joint positions of a straight edge that was found good, (k, 6) [rad]."""
        move = self._straight[pair[0]][pair[1]]
        assert move is not None
        return move

    def transit(self, pair: Pair) -> Transit:
        """Returns the motion of a break that was found good."""
        transit = self._breaks[pair[0]][pair[1]]
        assert transit is not None
        return transit

    def knows_straight(self, pair: Pair) -> bool:
        """Tells whether a straight edge has been checked."""
        return pair[1] in self._straight.get(pair[0], {})

    def knows_break(self, pair: Pair) -> bool:
        """Tells whether a break has been planned, or tried in vain."""
        return pair[1] in self._breaks.get(pair[0], {})

    def forbid(self, pair: Pair, straight: bool) -> None:
        """Takes an edge out that turned out to be impossible later on."""
        book: dict[int, dict[int, Any]] = self._straight if straight else self._breaks
        book.setdefault(pair[0], {})[pair[1]] = None
        book.setdefault(pair[1], {})[pair[0]] = None

    def check_straight(self, pairs: list[Pair]) -> list[bool]:
        """Checks straight edges; returns which are good."""
        if not pairs:
            return []
        first, second = (self._poses.pick(np.array(side)) for side in zip(*pairs, strict=True))
        problem = self.problem
        moves = follow(
            problem.world, problem.dexterity, first, second, problem.reference, problem.home
        )
        for (a, b), move in zip(pairs, moves, strict=True):
            self._straight.setdefault(a, {})[b] = None if move.problem else move.q
            self._straight.setdefault(b, {})[a] = None if move.problem else move.q[::-1]
        return [not move.problem for move in moves]

    def plan_break(self, pair: Pair) -> bool:
        """Plans the motion of a break; tells whether there is one."""
        transit = self._transits.plan(self._stop(pair[0]), self._stop(pair[1]))
        back = None if transit is None else transit.reversed()
        self._breaks.setdefault(pair[0], {})[pair[1]] = transit
        self._breaks.setdefault(pair[1], {})[pair[0]] = back
        return transit is not None

    def close_vain_families(self, pair: Pair) -> bool:
        """Counts nodes without a way home; tells whether that closes a family of states.

        After a few in vain the scan does not stop in that branch and winding any more.
        """
        closed = False
        for node in pair:
            family = int(self._family[node])
            if family < 0 or self._transits.leads_home(self._stop(node)):
                continue
            vain = self._vain.setdefault(family, set())
            known = len(vain)
            vain.add(node)
            if known < len(vain) == _VAIN:
                self._may_stop[self._family == family] = False
                closed = True
        if closed:
            self._estimates.clear()
        return closed

    def _stop(self, node: int) -> Stop:
        if node not in self._stops:
            self._stops[node] = (
                self._transits.resting(self.q(node))
                if node >= self.start
                else self._transits.stop(self._poses.pick(np.array([node])))
            )
        return self._stops[node]


def _patch(
    cost: Array,
    book: dict[int, dict[int, Any]],
    first: Indices,
    second: Indices,
    price: Callable[[Any, float], float],
) -> None:
    """Writes what is known into estimates."""
    columns = {node: column for column, node in enumerate(second.tolist())}
    for row, node in enumerate(first.tolist()):
        for other, known in book.get(node, {}).items():
            column = columns.get(other)
            if column is not None:
                cost[row, column] = np.inf if known is None else price(known, cost[row, column])
