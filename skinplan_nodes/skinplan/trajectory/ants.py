"""The modified ant colony of T S4: a short path from one node through all others to another.

What is the patent's: the nodes' first pheromone by their distance from the line s-d; roulette
choice, with a pheromone exponent that falls as a cosine and a heuristic exponent that rises as a
sine; ants ranked by length, of which only the best deposit, weighted by rank and 1/length, and
their number updated; evaporation changed when the best path has not changed for v iterations, not
below a minimum; an end at n_max. The published text has no constants and no formulas (they are
pictures): all constants here are ours and fields of `AntSettings`.

What is ours: pheromone lies on the moves between nodes and starts with the node's that a move leads
to; lengths count in units of the nearest-neighbour path, distances in units of their mean, so that
the result does not depend on the unit; and a local improvement (2-opt, or-opt) of the best ant of
each iteration, which ``local_moves = 0`` switches off.
"""

from dataclasses import dataclass

import numpy as np

from skinplan.errors import InputError
from skinplan.trajectory.ant_settings import AntSettings
from skinplan.trajectory.tour import improved_path, nearest_path, path_length, require_distances
from skinplan.trajectory.visit import Indices
from skinplan.transforms import Array

# Coincident nodes would attract without bound: nothing counts as nearer than this share of the mean
# distance.
_NEAREST = 1e-3


@dataclass(frozen=True, eq=False)
class AntPath:
    """What the ants found.

    Attributes:
        order: Node numbers from start to end, each once, shape (n,).
        length: Sum of the distances along it, in their unit.
        best_lengths: Length of the best path after each iteration, shape (iterations,).
        evaporations: Evaporation in each iteration, shape (iterations,).
    """

    order: Indices
    length: float
    best_lengths: Array
    evaporations: Array


def ant_path(
    distances: Array,
    start: int,
    end: int,
    first_pheromone: Array | None = None,
    settings: AntSettings | None = None,
    seed: int = 0,
) -> AntPath:
    """Finds a short open path through all nodes (T S4).

    Args:
        distances: Between nodes, symmetric, shape (n, n), any unit.
        start: Number of the first node, s.
        end: Number of the last node, d; another one than ``start`` unless there is one node only.
        first_pheromone: Of each node, shape (n,), above 0; None = all the same.
        settings: Constants; None = the defaults.
        seed: Of the roulette.

    Returns:
        The best path met.

    Raises:
        InputError: Distances, ends or pheromone that can't be used.
    """
    table = require_distances(distances)
    settings = settings or AntSettings()
    count = len(table)
    _require_ends(count, start, end)
    nodes = _require_pheromone(first_pheromone, count, settings)
    if count <= 3:  # there is one path only
        order = nearest_path(table, start, end)
        none = np.zeros(0)
        return AntPath(order, float(path_length(table, order)), none, none)
    pheromone = np.maximum(np.tile(nodes, (count, 1)), settings.pheromone_min)
    return _Colony(table, start, end, pheromone, settings, seed).run()


def line_pheromone(points: Array, start: int, end: int, settings: AntSettings) -> Array:
    """Returns the first pheromone of nodes: more the nearer to the line from start to end (T S4).

    It is map_scale * (W - distance) / W, not below pheromone_min, and map_scale for all when W is
    0. Where start and end coincide the distance is that from them. The distance is taken from the
    line's segment: what lies beyond its ends is off the way, too.

    Args:
        points: Places of the nodes, shape (n, 3) [m].
        start: Number of the first node, s.
        end: Number of the last node, d.
        settings: W, map scale factor and least pheromone.

    Returns:
        shape (n,).

    Raises:
        InputError: Points that are not finite.
    """
    places = np.asarray(points, dtype=float)
    if places.ndim != 2 or places.shape[1] != 3 or not np.isfinite(places).all():
        raise InputError(
            f"finite points of shape (n, 3) are accepted, found shape {places.shape}, "
            f"{np.count_nonzero(~np.isfinite(places))} values NaN or infinite"
        )
    offset, line = places - places[start], places[end] - places[start]
    square = float(line @ line)
    share = np.clip(offset @ line / square, 0.0, 1.0) if square > 0.0 else np.zeros(len(places))
    distance = np.linalg.norm(offset - share[:, None] * line, axis=1)
    width = 2.0 * float(distance.max()) if settings.width_m is None else settings.width_m
    if width == 0.0:
        return np.full(len(places), settings.map_scale)
    near = settings.map_scale * (width - distance) / width
    return np.maximum(near, settings.pheromone_min)


class _Colony:
    """The state of one search; node numbers as given, moves [from, to]."""

    def __init__(
        self,
        distances: Array,
        start: int,
        end: int,
        pheromone: Array,
        settings: AntSettings,
        seed: int,
    ) -> None:
        self._distances, self._start, self._end = distances, start, end
        self._settings, self._rng = settings, np.random.default_rng(seed)
        self._pheromone = pheromone
        mean = float(distances.sum()) / (len(distances) * (len(distances) - 1)) or 1.0
        self._heuristic = 1.0 / np.maximum(distances / mean, _NEAREST)
        self._best = nearest_path(distances, start, end)
        self._unit = self._length = float(path_length(distances, self._best))
        self._evaporation = settings.evaporation
        self._stagnant = 0

    def run(self) -> AntPath:
        lengths, evaporations = [], []
        for iteration in range(self._settings.iterations):
            evaporations.append(self._evaporation)
            orders = self._walk(iteration)
            found = path_length(self._distances, orders)
            ranked = np.argsort(found, kind="stable")
            orders, found = orders[ranked], found[ranked]
            orders[0] = improved_path(self._distances, orders[0], self._settings.local_moves)
            found[0] = path_length(self._distances, orders[0])
            self._pheromone = deposited(
                self._pheromone,
                orders[: self._settings.depositing(iteration)],
                found / self._unit if self._unit > 0.0 else np.ones(len(found)),
                self._evaporation,
                self._settings,
            )
            self._remember(orders[0], float(found[0]))
            lengths.append(self._length)
        return AntPath(self._best, self._length, np.array(lengths), np.array(evaporations))

    def _walk(self, iteration: int) -> Indices:
        pheromone, heuristic = self._settings.exponents(iteration)
        weights = self._pheromone**pheromone * self._heuristic**heuristic
        return walks(weights, self._start, self._end, self._settings.ants, self._rng)

    def _remember(self, order: Indices, length: float) -> None:
        """Keeps the best path; without a better one for v iterations evaporation is changed."""
        if length < self._length * (1.0 - 1e-12):
            self._best, self._length, self._stagnant = order.copy(), length, 0
            return
        self._stagnant += 1
        if self._stagnant >= self._settings.stagnation:
            self._stagnant = 0
            self._evaporation = max(
                self._evaporation * self._settings.evaporation_factor,
                self._settings.evaporation_min,
            )


def walks(weights: Array, start: int, end: int, ants: int, rng: np.random.Generator) -> Indices:
    """Lets ants walk: the next node by roulette among those not visited, the goal last (T S4).

    Args:
        weights: How much each move attracts, [from, to], shape (n, n), above 0.
        start: Number of the first node.
        end: Number of the last node.
        ants: m, number of walks.
        rng: The roulette's ball.

    Returns:
        Node numbers, shape (m, n).
    """
    count, rows = len(weights), np.arange(ants)
    free = np.ones((ants, count))
    free[:, [start, end]] = 0.0
    orders = np.empty((ants, count), dtype=np.int64)
    orders[:, 0], orders[:, -1] = start, end
    for place in range(1, count - 1):
        wheel = np.cumsum(weights[orders[:, place - 1]] * free, axis=1)
        # 1 - random is above 0, so that the first field hit is never one without width.
        ball = (1.0 - rng.random(ants)) * wheel[:, -1]
        orders[:, place] = np.argmax(wheel >= ball[:, None], axis=1)
        free[rows, orders[:, place]] = 0.0
    return orders


def deposited(
    pheromone: Array, orders: Indices, lengths: Array, evaporation: float, settings: AntSettings
) -> Array:
    """Returns the pheromone after an iteration (T S4).

    Of w depositing ants the one of rank r (from 0) adds deposit * (w - r) / w / length to each of
    its moves, both ways.

    Args:
        pheromone: Of the moves, shape (n, n).
        orders: Paths of the depositing ants, shortest first, shape (w, n).
        lengths: Their lengths in units of the nearest-neighbour path, shape (w,) or longer.
        evaporation: Share that evaporates first.
        settings: Amount and least pheromone.

    Returns:
        shape (n, n).
    """
    result = (1.0 - evaporation) * pheromone
    count = len(orders)
    weights = settings.deposit * (count - np.arange(count)) / count / lengths[:count]
    begins, ends = orders[:, :-1], orders[:, 1:]
    amounts = np.broadcast_to(weights[:, None], begins.shape)
    np.add.at(result, (begins, ends), amounts)
    np.add.at(result, (ends, begins), amounts)
    return np.maximum(result, settings.pheromone_min)


def _require_ends(count: int, start: int, end: int) -> None:
    if not (0 <= start < count and 0 <= end < count):
        raise InputError(f"ends from 0 to {count - 1} are accepted, found {start} and {end}")
    if start == end and count > 1:
        raise InputError(
            f"a path through {count} nodes has two different ends, found {start} for both"
        )


def _require_pheromone(pheromone: Array | None, count: int, settings: AntSettings) -> Array:
    if pheromone is None:
        return np.full(count, settings.map_scale)
    result = np.asarray(pheromone, dtype=float)
    if result.shape != (count,) or not np.isfinite(result).all() or result.min() <= 0.0:
        raise InputError(
            f"a finite first pheromone above 0 for each of {count} nodes is accepted, found shape "
            f"{result.shape}"
        )
    return result
