"""Order of visit, strategy ``ants``: the features of a station ordered by an ant colony (T S4).

Each piece of a row and each cluster of feature points is a feature: a node at its centroid. The
ants order the nodes. Then the direction of each row and the ends of each cluster are chosen for the
least travel by dynamic programming over the nodes in their order. Centroids say little of long
rows, so the order is at last improved by that travel (``travel_moves``; ours).

Reading notes. The patent orders features and does not say how each is entered. The ends s and d are
the nodes where a feature's point is nearest to where the scanner comes from and goes to; when both
are one node, the pair of different nodes with the least sum is taken. The published rows are units
here: an order of single points ignores turns and loses to rows on smooth panels.
"""

import numpy as np
from scipy.spatial.distance import cdist

from skinplan.errors import ScanPathInvalidError
from skinplan.scan_path.model import FEATURE, ROW, ScanPath
from skinplan.trajectory.ant_settings import AntSettings
from skinplan.trajectory.ants import ant_path, line_pheromone
from skinplan.trajectory.feature_travel import FeatureTravel
from skinplan.trajectory.order import CLUSTER_POINTS, k_means
from skinplan.trajectory.tour import improved_path, nearest_path
from skinplan.trajectory.visit import Indices, VisitOrder, VisitTask
from skinplan.transforms import Array

# A cluster is entered and left at some of its outermost points: so many are tried.
_ENDS = 6
# Weight of the distance between the ends: it only tells apart features that are equally near.
_FREE_END = 1e-3


def ants_order(task: VisitTask, settings: AntSettings | None = None) -> VisitOrder:
    """Orders the points of one station.

    Args:
        task: The points; without ``begin`` or ``end`` the path may begin or end anywhere.
        settings: Constants of the ant colony; None = the defaults.

    Returns:
        The order. Its cost is the length of the straight moves from ``begin`` through all points to
        ``end`` [m]; no bound is known.

    Raises:
        ScanPathInvalidError: A position that is not finite.
    """
    path, points = task.path, np.sort(np.asarray(task.points, dtype=np.int64))
    if not np.isfinite(path.positions[points]).all():
        raise ScanPathInvalidError("finite positions are accepted to order, found NaN or infinite")
    if not len(points):
        return VisitOrder(points, 0.0)
    found = features(path, points, task.seed)
    settings = settings or AntSettings()
    nodes = _ordered_nodes(path, found, task, settings)
    ways = [_ways(path, feature) for feature in found]
    travel = FeatureTravel(path.positions, ways, task.begin, task.end)
    return VisitOrder(*travel.points(travel.improved(nodes, settings.travel_moves)))


def features(path: ScanPath, points: Indices, seed: int = 0) -> list[Indices]:
    """Splits the points of a station into its features.

    Args:
        path: The scan path.
        points: Indices of its points, rising, shape (p,).
        seed: Of the clusters.

    Returns:
        Indices of each row piece (neighbours in the path and in the row) in their order along the
        row, then those of each cluster.
    """
    rows = points[path.kinds[points] == ROW]
    groups = path.groups[rows]
    breaks = np.flatnonzero((np.diff(groups) != 0) | (np.diff(rows) != 1)) + 1
    pieces = [piece for piece in np.split(rows, breaks) if len(piece)]
    single = points[path.kinds[points] == FEATURE]
    if len(single):
        regions = len(np.unique(path.groups[single]))
        count = max(regions, -(-len(single) // CLUSTER_POINTS))
        labels = k_means(path.positions[single], count, seed)
        pieces += [single[labels == label] for label in range(int(labels.max()) + 1)]
    return pieces


def _ordered_nodes(
    path: ScanPath, found: list[Indices], task: VisitTask, settings: AntSettings
) -> Indices:
    centres = np.array([path.positions[feature].mean(axis=0) for feature in found])
    start, end = _ends(path, found, centres, task)
    first = line_pheromone(centres, start, end, settings)
    return ant_path(cdist(centres, centres), start, end, first, settings, task.seed).order


def _ends(path: ScanPath, found: list[Indices], centres: Array, task: VisitTask) -> tuple[int, int]:
    """The features to begin and to end with: different ones, when there are two."""
    if len(found) == 1:
        return 0, 0
    apart = np.round(cdist(centres, centres), 9)
    # Where an end is free, it is the feature farthest from the other one.
    sums = _gaps(path, found, task.begin)[:, None] + _gaps(path, found, task.end)[None, :]
    sums = np.round(sums, 9) - _FREE_END * apart
    np.fill_diagonal(sums, np.inf)
    start, end = np.unravel_index(int(np.argmin(sums)), sums.shape)
    return int(start), int(end)


def _gaps(path: ScanPath, found: list[Indices], place: Array | None) -> Array:
    """How near each feature comes to a place, shape (f,) [m]; 0 without a place."""
    if place is None:
        return np.zeros(len(found))
    return np.array(
        [np.linalg.norm(path.positions[feature] - place, axis=1).min() for feature in found]
    )


def _ways(path: ScanPath, feature: Indices) -> list[Indices]:
    """The ways through a feature: a row both ways, a cluster between any two of its outer points.

    Inside a cluster a nearest-neighbour path is shortened by 2-opt and or-opt: eq (8) of M2.4, made
    for steady motion, is longer there.
    """
    if path.kinds[feature[0]] == ROW or len(feature) <= 2:
        return [feature] if len(feature) == 1 else [feature, feature[::-1]]
    places = path.positions[feature]
    distances = cdist(places, places)
    ends = _outer(places)
    ways = []
    for number, head in enumerate(ends):
        for tail in ends[number + 1 :]:
            way = feature[improved_path(distances, nearest_path(distances, head, tail))]
            ways += [way, way[::-1]]
    return ways


def _outer(places: Array) -> list[int]:
    """Points far from the middle and from each other, at least two, by their numbers."""
    gaps = np.linalg.norm(places - places.mean(axis=0), axis=1)
    chosen = [int(np.argmax(np.round(gaps, 9)))]
    gaps = np.linalg.norm(places - places[chosen[0]], axis=1)
    while len(chosen) < min(_ENDS, len(places)):
        gaps[chosen] = -np.inf
        chosen.append(int(np.argmax(np.round(gaps, 9))))
        gaps = np.minimum(gaps, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return chosen
