"""Order of visit, strategy ``published`` (M2.4): Z-shaped rows with clusters inserted, eq (8).

Reading notes. The paper gives no number of clusters: here it is the greater of the complex regions
present and one per `CLUSTER_POINTS` points. A cluster's sub-list starts and ends at its row point:
the tour leaves the rows there and goes on with the row's next point; that row point is not scanned
a second time. k of eq (8) is per millimetre.
"""

import numpy as np
from scipy.spatial.distance import cdist

from skinplan.scan_path.model import FEATURE, ROW, ScanPath
from skinplan.trajectory.visit import Indices, VisitOrder, VisitTask
from skinplan.transforms import Array

CLUSTER_POINTS = 25
WEIGHT = 0.9
STEEPNESS_PER_MM = 0.02
_ITERATIONS = 100


def published_order(task: VisitTask) -> VisitOrder:
    """Orders the points of one station; d0 of eq (8) is three times d_interval."""
    return VisitOrder(_published(task.path, task.points, task.interval_m, task.begin))


def _published(path: ScanPath, points: Indices, interval_m: float, begin: Array | None) -> Indices:
    points = np.sort(np.asarray(points, dtype=np.int64))
    rows = z_shaped(path, points[path.kinds[points] == ROW], begin)
    features = points[path.kinds[points] == FEATURE]
    if not len(features):
        return rows
    clusters = _clusters(path, features)
    anchors, directions = _anchors(path, rows, clusters, begin)
    result: list[int] = []
    for place in range(-1, len(rows)):
        if place >= 0:
            result.append(int(rows[place]))
        for cluster, anchor, direction in zip(clusters, anchors, directions, strict=True):
            if anchor == place:
                result += next_best(
                    path,
                    cluster,
                    result[-1] if result else None,
                    direction,
                    3.0 * interval_m,
                    begin,
                )
    return np.array(result, dtype=np.int64)


def z_shaped(path: ScanPath, rows: Indices, begin: Array | None = None) -> Indices:
    """Joins row points to a boustrophedon list that begins at the end nearest to ``begin``.

    Pieces of one row (a row that stops at a hole has two numbers) are driven one after the other.
    """
    if not len(rows):
        return rows
    along, across = _row_axes(path, rows)
    middle = {
        g: float((path.targets[rows[path.groups[rows] == g]] @ across).mean())
        for g in np.unique(path.groups[rows])
    }
    lines = _lines(middle)
    options = []
    for reverse_lines in (False, True):
        for reverse_first in (False, True):
            pieces = []
            for number, line in enumerate(lines[::-1] if reverse_lines else lines):
                members = rows[np.isin(path.groups[rows], line)]
                order = np.argsort(path.targets[members] @ along, kind="stable")
                pieces.append(members[order[::-1] if (number % 2 == 1) != reverse_first else order])
            options.append(np.concatenate(pieces))
    if begin is None:
        return options[0]
    gaps = [float(np.linalg.norm(path.positions[option[0]] - begin)) for option in options]
    return options[int(np.argmin(np.round(gaps, 6)))]


def k_means(points: Array, count: int, seed: int = 0) -> Indices:
    """Clusters points by Lloyd's iteration from farthest-first seeds; centroids as eq (7).

    Args:
        points: shape (n, 3) [m].
        count: Number of clusters asked for; fewer come out when points coincide.
        seed: Picks the first seed point.

    Returns:
        Cluster of each point, numbered from 0 without gaps, shape (n,).
    """
    count = min(count, len(points))
    seeds = [int(np.random.default_rng(seed).integers(len(points)))]
    gaps = np.linalg.norm(points - points[seeds[0]], axis=1)
    while len(seeds) < count and gaps.max() > 1e-9:
        seeds.append(int(np.argmax(gaps)))
        gaps = np.minimum(gaps, np.linalg.norm(points - points[seeds[-1]], axis=1))
    centres = points[seeds]
    labels = np.full(len(points), -1)
    for _ in range(_ITERATIONS):
        nearest = np.argmin(cdist(points, centres), axis=1)
        if np.array_equal(nearest, labels):
            break
        labels = nearest
        kept = [c for c in range(len(centres)) if np.any(labels == c)]
        centres = np.array([points[labels == c].mean(axis=0) for c in kept])
        labels = np.searchsorted(kept, labels)
    return np.unique(labels, return_inverse=True)[1].astype(np.int64)


def next_best_score(
    previous: Array, here: Array, view_here: Array, following: Array, views: Array, d0_m: float
) -> Array:
    """Eq (8): how good each point would be as the next one, shape (n,).

    Args:
        previous: Direction of the last move, shape (3,); no unit length needed.
        here: Present position, shape (3,) [m].
        view_here: Present unit view direction, shape (3,).
        following: Positions to choose from, shape (n, 3) [m].
        views: Their unit view directions, shape (n, 3).
        d0_m: d0 [m].
    """
    moves = following - here
    distance = np.linalg.norm(moves, axis=1)
    lengths = distance * np.linalg.norm(previous)
    # A move without length has no direction: it counts as straight on.
    cos_alpha = np.where(
        lengths > 1e-12, moves @ previous / np.where(lengths > 1e-12, lengths, 1.0), 1.0
    )
    cos_beta = np.clip(views @ view_here, -1.0, 1.0)
    far = np.exp(np.clip(STEEPNESS_PER_MM * 1000.0 * (distance - d0_m), -700.0, 700.0))
    return np.asarray(
        (WEIGHT * (1.0 + cos_alpha) + (1.0 - WEIGHT) * (1.0 + cos_beta)) / (1.0 + far)
    )


def next_best(
    path: ScanPath,
    cluster: Indices,
    anchor: int | None,
    direction: Array,
    d0_m: float,
    begin: Array | None,
) -> list[int]:
    """Orders one cluster by repeated choice of the next best point, from its row point on."""
    left = [int(i) for i in cluster]
    result: list[int] = []
    if anchor is None:
        first = (
            0
            if begin is None
            else int(np.argmin(np.linalg.norm(path.positions[left] - begin, axis=1)))
        )
        anchor = left.pop(first)
        result.append(anchor)
    here = anchor
    while left:
        scores = next_best_score(
            direction,
            path.positions[here],
            path.directions[here],
            path.positions[left],
            path.directions[left],
            d0_m,
        )
        chosen = left.pop(int(np.argmax(np.round(scores, 12))))
        move = path.positions[chosen] - path.positions[here]
        direction = move if np.linalg.norm(move) > 1e-9 else direction
        result.append(chosen)
        here = chosen
    return result


def _clusters(path: ScanPath, features: Indices) -> list[Indices]:
    regions = len(np.unique(path.groups[features]))
    count = max(regions, -(-len(features) // CLUSTER_POINTS))
    labels = k_means(path.positions[features], count)
    return [features[labels == label] for label in range(int(labels.max()) + 1)]


def _anchors(
    path: ScanPath, rows: Indices, clusters: list[Indices], begin: Array | None
) -> tuple[list[int], list[Array]]:
    """Place in the row list after which each cluster comes (-1 = before), row direction there."""
    if not len(rows):
        along = path.positions[clusters[0]].mean(axis=0) - (
            path.positions.mean(axis=0) if begin is None else begin
        )
        return [-1] * len(clusters), [along] * len(clusters)
    anchors, directions = [], []
    for cluster in clusters:
        centre = path.positions[cluster].mean(axis=0)
        place = int(np.argmin(np.linalg.norm(path.positions[rows] - centre, axis=1)))
        before, after = rows[max(place - 1, 0)], rows[min(place + 1, len(rows) - 1)]
        step = path.positions[rows[place]] - path.positions[before]
        anchors.append(place)
        directions.append(
            step
            if np.linalg.norm(step) > 1e-9
            else path.positions[after] - path.positions[rows[place]]
        )
    return anchors, directions


def _row_axes(path: ScanPath, rows: Indices) -> tuple[Array, Array]:
    """Unit directions along and across the rows: principal axes of their steps and targets."""
    same = path.groups[rows][1:] == path.groups[rows][:-1]
    steps = (path.targets[rows][1:] - path.targets[rows][:-1])[same]
    spread = path.targets[rows] - path.targets[rows].mean(axis=0)
    along = _principal(steps if len(steps) else spread)
    across = _principal(spread - np.outer(spread @ along, along))
    return along, across


def _principal(vectors: Array) -> Array:
    """Principal direction with a sign that does not depend on the solver, shape (3,)."""
    direction = (
        np.linalg.svd(vectors, full_matrices=False)[2][0]
        if len(vectors)
        else np.array([1.0, 0.0, 0.0])
    )
    return np.asarray(direction * np.sign(direction[np.argmax(np.abs(direction))]))


def _lines(middle: dict[int, float]) -> list[list[int]]:
    """Groups nearer together than half the usual distance of rows are pieces of one line."""
    ordered = sorted(middle, key=lambda g: (round(middle[g], 9), g))
    values = np.array([middle[g] for g in ordered])
    steps = np.diff(values)
    usual = (
        float(np.median(steps[steps > 0.25 * steps.max()]))
        if len(steps) and steps.max() > 0
        else 0.0
    )
    lines: list[list[int]] = []
    for number, group in enumerate(ordered):
        if lines and steps[number - 1] < 0.5 * usual:
            lines[-1].append(int(group))
        else:
            lines.append([int(group)])
    return lines
