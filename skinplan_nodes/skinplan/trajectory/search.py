"""The way through points in a given order: ladder graph, edges checked lazily, breaks planned."""

import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.trajectory.graph import HOME, START, Pair, StationGraph
from skinplan.trajectory.ladder import BREAK, STRAIGHT, Ladder, Solution
from skinplan.trajectory.transit import Transit
from skinplan.transforms import Array

_LOG = logging.getLogger(__name__)
_ROUNDS = 400  # a bound on "solve, check, correct"; each round settles at least one edge
_FIRST_BATCH = 8  # edges checked between two layers at once; doubled every time that all fail
_LARGEST_BATCH = 512
NO_MOTION = "no collision-free motion to it was found"

Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Way:
    """A way through points.

    Attributes:
        points: Views visited, in order, shape (n,).
        edges: n + 1 edges: start to first point, between points, last point to home. A straight one
            is the joint positions on it, shape (k, 6) [rad]; a break is a transit.
        nodes: n + 2 nodes of the graph: start, points, home.
        states: Joint positions at the points, shape (n, 6) [rad].
        cost_s: What it costs by the graph's estimates [s].
        dropped: Views left out, with the reason.
    """

    points: Indices
    edges: list[Array | Transit]
    nodes: list[int]
    states: Array
    cost_s: float
    dropped: dict[int, str]

    def pair(self, edge: int) -> Pair:
        """Returns the nodes that an edge joins."""
        return self.nodes[edge], self.nodes[edge + 1]


class Search:
    """Searches the way through points in an order; what it checks, the graph keeps."""

    def __init__(self, graph: StationGraph) -> None:
        """Takes the graph of a station."""
        self._graph = graph

    def run(self, order: Indices, dropped: dict[int, str] | None = None) -> Way:
        """Finds the least-cost way; points that can't be joined are dropped.

        Args:
            order: Views in the order of visit, all of them with states, shape (n,).
            dropped: Views that were dropped before; they are left out.

        Raises:
            CancelledError: The caller asked to stop.
        """
        dropped = dict(dropped or {})
        points = [int(p) for p in order if int(p) not in dropped]
        while points:
            layers = [self._graph.layer(view) for view in (START, *points, HOME)]
            ladder = Ladder(*self._graph.layer_costs(points))
            solved = self._settled(ladder, layers)
            if solved is None:
                continue
            if isinstance(solved, Solution):
                return self._way(points, layers, solved, dropped)
            dropped[points.pop(min(solved - 1, len(points) - 1))] = NO_MOTION
        return Way(np.zeros(0, dtype=np.int64), [], [], np.zeros((0, 6)), 0.0, dropped)

    def _settled(self, ladder: Ladder, layers: list[Indices]) -> Solution | int | None:
        """Solves until every edge of the best way is checked.

        Returns:
            The way; the layer where it fails; None when the ladder has to be made anew.
        """
        batches: dict[int, int] = {}
        solved: Solution | int = 0
        for number in range(_ROUNDS):
            self._graph.problem.require_wanted()
            solved = ladder.solve()
            if isinstance(solved, int):
                return solved
            nodes = [int(layer[s]) for layer, s in zip(layers, solved.states, strict=True)]
            pairs = list(zip(nodes, nodes[1:], strict=False))
            if not self._straight_good(ladder, layers, solved, pairs, batches):
                continue
            good = self._breaks_good(ladder, layers, solved, pairs)
            if good is None:
                return None
            if good:
                _LOG.debug("%d layers: %.1f s after %d rounds", len(layers), solved.cost_s, number)
                return solved
        return self._first_open(solved, pairs)

    def _straight_good(
        self,
        ladder: Ladder,
        layers: list[Indices],
        solved: Solution,
        pairs: list[Pair],
        batches: dict[int, int],
    ) -> bool:
        """Checks the straight edges of the best way, and the most promising ones beside them."""
        graph = self._graph
        new = [
            i for i, kind in enumerate(solved.kinds)
            if kind == STRAIGHT and not graph.knows_straight(pairs[i])
        ]  # fmt: skip
        if not new:
            return True
        asked: list[tuple[int, int, int]] = []
        for layer, states in ladder.best_edges(STRAIGHT, {i: batches.get(i, 1) for i in new}):
            batches[layer] = min(_LARGEST_BATCH, max(_FIRST_BATCH, 2 * batches.get(layer, 1)))
            for a, b in [tuple(solved.states[layer : layer + 2].tolist()), *states.tolist()]:
                pair = int(layers[layer][a]), int(layers[layer + 1][b])
                if not graph.knows_straight(pair):
                    asked.append((layer, a, b))
        asked = list(dict.fromkeys(asked))  # the best way's edges are among the promising ones
        edges = [(int(layers[i][a]), int(layers[i + 1][b])) for i, a, b in asked]
        results = graph.check_straight(edges)
        for (layer, a, b), good in zip(asked, results, strict=True):
            if not good:
                ladder.set_cost(STRAIGHT, layer, a, b, np.inf)
        return all(results[edges.index(pairs[i])] for i in new if pairs[i] in edges)

    def _breaks_good(
        self, ladder: Ladder, layers: list[Indices], solved: Solution, pairs: list[Pair]
    ) -> bool | None:
        """Plans the breaks of the best way; None when what is known of many edges has changed."""
        graph = self._graph
        new = [
            i for i, kind in enumerate(solved.kinds)
            if kind == BREAK and not graph.knows_break(pairs[i])
        ]  # fmt: skip
        for number, layer in enumerate(new):
            graph.problem.progress(number / len(new))
            graph.problem.require_wanted()
            if not graph.plan_break(pairs[layer]) and graph.close_vain_families(pairs[layer]):
                return None
            a, b = layers[layer], layers[layer + 1]
            at = int(solved.states[layer]), int(solved.states[layer + 1])
            cost = graph.break_s(a[at[0]][None], b[at[1]][None])[0, 0]
            ladder.set_cost(BREAK, layer, *at, float(cost))
        return not new or self._unchanged(ladder, solved)

    def _unchanged(self, ladder: Ladder, solved: Solution) -> bool:
        again = ladder.solve()
        return isinstance(again, Solution) and np.array_equal(again.states, solved.states)

    def _way(
        self, points: list[int], layers: list[Indices], solved: Solution, dropped: dict[int, str]
    ) -> Way:
        graph = self._graph
        nodes = [int(layer[s]) for layer, s in zip(layers, solved.states, strict=True)]
        edges: list[Array | Transit] = []
        for pair, kind in zip(zip(nodes, nodes[1:], strict=False), solved.kinds, strict=True):
            edges.append(graph.straight(pair) if kind == STRAIGHT else graph.transit(pair))
        states = np.array([graph.q(node) for node in nodes[1:-1]]).reshape(-1, 6)
        return Way(np.array(points), edges, nodes, states, solved.cost_s, dropped)

    def _first_open(self, solved: Solution | int, pairs: list[Pair]) -> int:
        """Layer to drop when the rounds are used up: the first one behind an unchecked edge."""
        if isinstance(solved, int):
            return solved
        graph = self._graph
        for layer, (pair, kind) in enumerate(zip(pairs, solved.kinds, strict=True)):
            known = graph.knows_straight(pair) if kind == STRAIGHT else graph.knows_break(pair)
            if not known:
                return layer + 1
        return len(pairs) - 1
