"""Order of visit, strategy ``tour``: a generalised tour with a cost in joint-space time.

Every point is a group of states (IK branch, tilt, winding); the tour takes one of each. Two steps
take turns until neither helps: the ladder graph chooses the states for an order (exactly, on
estimates), local search chooses the order for the states: 2-opt and or-opt moves with a price for
turns, then seeded kicks (double bridges). Costs are what the station's graph knows: the scanner's
and the joints' speed limits for straight edges, planned transits for breaks, infinity for edges
that were checked in vain. The caller asks again when more is known.

The effort is counted in moves looked at, not in time: the same on every machine.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import InputError
from skinplan.trajectory.graph import HOME, START, StationGraph
from skinplan.trajectory.ladder import Ladder, Solution
from skinplan.trajectory.moves import improved, kicked
from skinplan.trajectory.order import published_order
from skinplan.trajectory.tour_bound import tour_bound
from skinplan.trajectory.visit import Indices, VisitOrder, VisitTask
from skinplan.transforms import Array

MOVES_PER_S = 6.0e6  # moves that one core of a common PC looks at in a second
_TURNS = 6  # at most so many times states and order take turns
_NEVER_S = 1.0e4  # stands for infinity in sums


def tour_order(task: VisitTask) -> VisitOrder:
    """Orders the points of one station; cost and bound in seconds of the graph's estimates.

    Raises:
        InputError: The task comes without a graph.
        CancelledError: The caller asked to stop.
    """
    if task.graph is None:
        raise InputError("order strategy 'tour' needs the states of the points; found none")
    views = np.searchsorted(task.among, task.points)
    search = _TourSearch(task.graph, task.tcp_turn_s, task.seed)
    first = task.known if task.known is not None else published_order(task).points
    starts = [np.searchsorted(task.among, first)]
    if task.known is None:
        starts.append(search.nearest_first(views))
    share = task.effort_s / len(starts)
    found = [search.run(start, share * MOVES_PER_S) for start in starts]
    best = min(found, key=lambda tour: round(tour.cost, 9))
    bound = tour_bound(task.graph, views)
    return VisitOrder(task.among[best.views], best.cost, bound)


@dataclass(frozen=True, eq=False)
class _Tour:
    views: Indices
    cost: float


class _TourSearch:
    def __init__(self, graph: StationGraph, turn_s: float, seed: int) -> None:
        self._graph = graph
        self._turn_s = turn_s
        self._seed = seed

    def nearest_first(self, views: Indices) -> Indices:
        """The views, always on to the nearest one, by the scanner's way."""
        graph = self._graph
        middle = np.array([graph.positions(graph.layer(v)).mean(axis=0) for v in views])
        left = list(range(len(views)))
        here = graph.positions(np.array([graph.start]))[0]
        order = []
        while left:
            gaps = np.linalg.norm(middle[left] - here, axis=1)
            chosen = left.pop(int(np.argmin(np.round(gaps, 9))))
            order.append(chosen)
            here = middle[chosen]
        return views[order]

    def run(self, order: Indices, effort: float) -> _Tour:
        """Improves an order."""
        best = _Tour(order, np.inf)
        for _ in range(_TURNS):
            nodes, cost = self._states(best.views)
            if cost < best.cost - 1e-9:
                best = _Tour(best.views, cost)
            views, spent = self._reordered(best.views, nodes, effort / _TURNS)
            effort -= spent
            _, again = self._states(views)
            if not again < best.cost - 1e-6:
                break
            best = _Tour(views, again)
        return best

    def _states(self, views: Indices) -> tuple[Indices, float]:
        """The best states for an order, and what it costs with them.

        Where nothing leads through the order, any states, and infinity: another order may do.
        """
        graph = self._graph
        graph.problem.require_wanted()
        layers = [graph.layer(view) for view in (START, *views.tolist(), HOME)]
        solved = Ladder(*graph.layer_costs(views.tolist())).solve()
        if not isinstance(solved, Solution):
            return np.array([int(layer[0]) for layer in layers[1:-1]]), np.inf
        nodes = [int(layer[s]) for layer, s in zip(layers, solved.states, strict=True)]
        return np.array(nodes[1:-1]), solved.cost_s

    def _reordered(self, views: Indices, nodes: Indices, effort: float) -> tuple[Indices, float]:
        """The best order found for fixed states, and how many moves were looked at."""
        graph = self._graph
        ends = np.array([graph.start, graph.home])
        every = np.concatenate([ends[:1], nodes, ends[1:]])
        straight, stop = graph.straight_s(every, every), graph.break_s(every, every)
        cost = np.minimum(np.minimum(straight, stop), _NEVER_S)
        turns = self._turn_costs(graph.positions(every), straight <= stop)
        random = np.random.default_rng(self._seed)
        here, spent = improved(np.arange(len(every)), cost, turns)
        best = here
        while spent < effort and len(nodes) > 7:
            graph.problem.require_wanted()
            tried, more = improved(kicked(best.order, random), cost, turns)
            spent += more
            if tried.cost < best.cost - 1e-9:
                best = tried
        return views[best.order[1:-1] - 1], spent

    def _turn_costs(self, positions: Array, straight: NDArray[np.bool_]) -> Array:
        """Time lost where the scanner changes its direction, shape (n, n, n) [s]."""
        step = positions[None] - positions[:, None]
        length = np.linalg.norm(step, axis=2)
        unit = step / np.where(length > 1e-9, length, 1.0)[:, :, None]
        cosine = np.einsum("abi,bci->abc", unit, unit)
        lost = 0.5 * self._turn_s * (1.0 - cosine)
        both = straight[:, :, None] & straight[None]
        return np.asarray(np.where(both, lost, 0.0))
