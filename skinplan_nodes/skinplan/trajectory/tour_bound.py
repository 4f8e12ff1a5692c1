"""A lower bound for tours through groups of states: 1-trees with node prices (Held and Karp 1970).

An edge between two points costs at least the shortest way of the scanner between any of their
states at its speed limit, or what a break costs at least, whichever is less, and half of what both
states cost. A tour is a spanning tree of the points with an edge to each end; node
prices, which no tour's cost depends on, are raised where the tree branches off.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from skinplan.trajectory.graph import BREAK_PRICE_S, BREAK_S, StationGraph
from skinplan.transforms import Array

_STEPS = 150
_FIRST_STEP = 2.0


def tour_bound(graph: StationGraph, views: NDArray[np.int64]) -> float:
    """Returns what no tour of the views costs less than, by the graph's estimates [s].

    Args:
        graph: The station's graph.
        views: Numbers of the views, shape (n,).
    """
    start = np.array([_from_end(graph, graph.start, v) for v in views])
    home = np.array([_from_end(graph, graph.home, v) for v in views])
    if len(views) == 1:
        return float(start[0] + home[0])
    return _one_tree_bound(_least_costs(graph, views), start, home)


def _from_end(graph: StationGraph, end: int, view: int) -> float:
    """Least cost of the edge to an end, half of the state's own cost included."""
    nodes = graph.layer(view)
    return float((graph.break_s(np.array([end]), nodes)[0] + 0.5 * graph.node_costs(nodes)).min())


def _least_costs(graph: StationGraph, views: NDArray[np.int64]) -> Array:
    """Least cost between the states of any two views, half of both states' own, (n, n) [s].

    In a tour each point has two edges, so that the halves add up to the cost of its state.
    """
    places = [_places(graph, v) for v in views]
    result = np.zeros((len(views), len(views)))
    problem = graph.problem
    lever = float(problem.world.arm.lever_arms().sum())
    for i, (first, first_s) in enumerate(places):
        for j in range(i + 1, len(places)):
            second, second_s = places[j]
            way = cdist(first, second)
            # No joint can move less than that when the scanner moves so far.
            stop = BREAK_S + BREAK_PRICE_S + way / lever / float(problem.velocity.max())
            edge = np.minimum(way / problem.tcp_speed, stop)
            cost = edge + 0.5 * (first_s[:, None] + second_s[None])
            result[i, j] = result[j, i] = cost.min()
    return result


def _places(graph: StationGraph, view: int) -> tuple[Array, Array]:
    """Scanner origins of a view's states, shape (p, 3) [m], and the least state cost at each."""
    nodes = graph.layer(view)
    places, owner = np.unique(np.round(graph.positions(nodes), 9), axis=0, return_inverse=True)
    costs = np.full(len(places), np.inf)
    np.minimum.at(costs, owner.reshape(-1), graph.node_costs(nodes))
    return places, costs


def _one_tree_bound(cost: Array, start: Array, home: Array) -> float:
    prices = np.zeros(len(cost))
    best = -np.inf
    step = _FIRST_STEP * float(cost.mean()) / len(cost) ** 0.5
    for number in range(_STEPS):
        degrees, length = _tree(cost + prices[:, None] + prices[None])
        first, last = np.argmin(start + prices), np.argmin(home + prices)
        degrees[first] += 1
        degrees[last] += 1
        total = length + start[first] + prices[first] + home[last] + prices[last]
        best = max(best, float(total - 2.0 * prices.sum()))
        if np.all(degrees == 2):
            break
        prices = prices + step * (1.0 - number / _STEPS) * (degrees - 2)
    return best


def _tree(cost: Array) -> tuple[NDArray[np.int64], float]:
    """A minimum spanning tree (Prim): degrees of the nodes and length."""
    count = len(cost)
    degrees = np.zeros(count, dtype=np.int64)
    left = np.ones(count, dtype=bool)
    left[0] = False
    near, origin = cost[0].copy(), np.zeros(count, dtype=np.int64)
    length = 0.0
    for _ in range(count - 1):
        node = int(np.argmin(np.where(left, near, np.inf)))
        length += float(near[node])
        degrees[[node, origin[node]]] += 1
        left[node] = False
        closer = cost[node] < near
        near[closer], origin[closer] = cost[node][closer], node
    return degrees, length
