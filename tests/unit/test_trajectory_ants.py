"""The ant colony and order strategy ``ants`` (T S4)."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from reach_scene import flat_path, path_of
from skinplan.errors import InputError, ScanPathInvalidError
from skinplan.scan_path.model import FEATURE, ROW
from skinplan.trajectory.ant_settings import AntSettings
from skinplan.trajectory.ants import ant_path, deposited, line_pheromone, walks
from skinplan.trajectory.ants_order import ants_order, features
from skinplan.trajectory.feature_travel import FeatureTravel
from skinplan.trajectory.order import published_order
from skinplan.trajectory.plan import STRATEGIES
from skinplan.trajectory.tour import improved_path, nearest_path, path_length
from skinplan.trajectory.visit import VisitTask
from skinplan.transforms import apply, rotate, transform

DOWN = np.array([0.0, 0.0, -1.0])
ALONE = AntSettings(local_moves=0)


def spread(count, seed):
    """Points over a part, and the numbers of the leftmost and the rightmost one."""
    points = np.random.default_rng(seed).random((count, 3)) * (3.0, 1.0, 0.3)
    return points, int(np.argmin(points[:, 0])), int(np.argmax(points[:, 0]))


def held_karp(distances, start, end):
    """Length of the shortest path with fixed ends through all nodes, by dynamic programming."""
    inner = [node for node in range(len(distances)) if node not in (start, end)]
    best = {(frozenset([node]), node): distances[start, node] for node in inner}
    for size in range(2, len(inner) + 1):
        for group in map(frozenset, itertools.combinations(inner, size)):
            for last in group:
                rest = group - {last}
                best[group, last] = min(best[rest, node] + distances[node, last] for node in rest)
    whole = frozenset(inner)
    return min(best[whole, node] + distances[node, end] for node in inner)


def or_tools(distances, start, end, seconds=2.0):
    """Length of the path that routing with guided local search finds."""
    from ortools.constraint_solver import pywrapcp, routing_enums_pb2

    whole = np.rint(distances * 1e6).astype(int).tolist()
    manager = pywrapcp.RoutingIndexManager(len(whole), 1, [start], [end])
    model = pywrapcp.RoutingModel(manager)
    travel = model.RegisterTransitCallback(
        lambda a, b: whole[manager.IndexToNode(a)][manager.IndexToNode(b)]
    )
    model.SetArcCostEvaluatorOfAllVehicles(travel)
    search = pywrapcp.DefaultRoutingSearchParameters()
    search.local_search_metaheuristic = (
        routing_enums_pb2.LocalSearchMetaheuristic.GUIDED_LOCAL_SEARCH
    )
    search.time_limit.FromMilliseconds(int(seconds * 1000))
    return model.SolveWithParameters(search).ObjectiveValue() * 1e-6


def mixed(seed=0, count=60):
    """Rows over a plate and features in two places above it."""
    rows = flat_path(1.6, 0.8, 0.2)
    middle = np.where(np.arange(count)[:, None] % 2 == 0, (-0.5, 0.1, 0.05), (0.5, -0.1, 0.05))
    spots = middle + np.random.default_rng(seed).uniform(-0.1, 0.1, (count, 3))
    return path_of(
        np.vstack([rows.targets, spots]),
        np.vstack([rows.directions, np.tile(DOWN, (count, 1))]),
        np.append(rows.kinds, np.full(count, FEATURE)),
        np.append(rows.groups, 1 + np.arange(count) % 2),
    )


def task_of(path, points=None, begin=None, end=None, seed=0):
    points = np.arange(len(path)) if points is None else np.asarray(points)
    return VisitTask(path, points, 0.08, begin, end, seed)


def travel(path, order, begin=None, end=None):
    places = [path.positions[order]]
    places = ([begin[None]] if begin is not None else []) + places
    places += [end[None]] if end is not None else []
    return float(np.linalg.norm(np.diff(np.concatenate(places), axis=0), axis=1).sum())


@pytest.mark.parametrize("seed", range(20))
def test_the_proven_optimum_is_found_on_small_instances(seed):
    points, start, end = spread(8 + seed % 4, seed)
    distances = cdist(points, points)
    first = line_pheromone(points, start, end, AntSettings())
    found = ant_path(distances, start, end, first, seed=seed)
    assert found.length == pytest.approx(held_karp(distances, start, end), rel=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_the_patent_alone_comes_near_the_optimum_on_small_instances(seed):
    points, start, end = spread(8 + seed % 4, seed)
    distances = cdist(points, points)
    first = line_pheromone(points, start, end, ALONE)
    found = ant_path(distances, start, end, first, ALONE, seed)
    assert found.length <= 1.03 * held_karp(distances, start, end)


@pytest.mark.parametrize("seed", range(3))
def test_sixty_features_come_within_5_percent_of_or_tools(seed):
    points, start, end = spread(60, seed)
    distances = cdist(points, points)
    found = ant_path(distances, start, end, line_pheromone(points, start, end, AntSettings()))
    assert found.length <= 1.05 * or_tools(distances, start, end)
    assert sorted(found.order) == list(range(60))
    assert (found.order[0], found.order[-1]) == (start, end)
    assert found.length == pytest.approx(path_length(distances, found.order))


def test_the_same_seed_gives_the_same_path_and_another_seed_another_search():
    points, start, end = spread(30, 0)
    distances = cdist(points, points)
    a, b, c = (ant_path(distances, start, end, None, ALONE, seed) for seed in (1, 1, 2))
    assert np.array_equal(a.order, b.order) and np.array_equal(a.best_lengths, b.best_lengths)
    assert not np.array_equal(a.best_lengths, c.best_lengths)


def test_the_unit_of_the_distances_does_not_matter():
    points, start, end = spread(20, 3)
    distances = cdist(points, points)
    a = ant_path(distances, start, end, None, ALONE, 5)
    b = ant_path(1024.0 * distances, start, end, None, ALONE, 5)
    assert np.array_equal(a.order, b.order)


def test_the_best_path_never_gets_longer_and_ants_beat_the_nearest_neighbour():
    points, start, end = spread(40, 1)
    distances = cdist(points, points)
    found = ant_path(distances, start, end, line_pheromone(points, start, end, ALONE), ALONE)
    assert np.all(np.diff(found.best_lengths) <= 0.0)
    assert found.length == found.best_lengths[-1]
    assert found.length < path_length(distances, nearest_path(distances, start, end))


def test_exponents_fall_as_a_cosine_and_rise_as_a_sine():
    settings = AntSettings(
        iterations=3, pheromone_first=3.0, pheromone_last=1.0, heuristic_first=0.5,
        heuristic_last=4.5,
    )  # fmt: skip
    # Angles 0, 30 and 60 degrees.
    assert settings.exponents(0) == pytest.approx((3.0, 0.5))
    assert settings.exponents(1) == pytest.approx((1.0 + math.sqrt(3.0), 2.5))
    assert settings.exponents(2) == pytest.approx((2.0, 0.5 + 2.0 * math.sqrt(3.0)))
    assert settings.exponents(3) == pytest.approx((1.0, 4.5))


def test_first_pheromone_by_hand():
    points = np.array([(0, 0, 0), (4, 0, 0), (1, 1, 0), (2, 0, -2), (3, 0, 0), (-1, 0, 0)], float)
    # W is twice the largest distance, 4: nodes 1 and 2 m off the line have 3/4 and 1/2 of it.
    found = line_pheromone(points, 0, 1, AntSettings(map_scale=2.0))
    assert found == pytest.approx([2.0, 2.0, 1.5, 1.0, 2.0, 1.5])
    # W = 1.25 m: (1.25 - 1) / 1.25, and the least pheromone beyond W.
    narrow = line_pheromone(points, 0, 1, AntSettings(width_m=1.25, pheromone_min=0.05))
    assert narrow == pytest.approx([1.0, 1.0, 0.2, 0.05, 1.0, 0.2])


def test_first_pheromone_without_line_or_width():
    points = np.array([(0, 0, 0), (0, 0, 0), (3, 4, 0)], float)
    assert line_pheromone(points, 0, 1, AntSettings()) == pytest.approx([1.0, 1.0, 0.5])
    on_line = np.array([(0, 0, 0), (1, 0, 0), (2, 0, 0)], float)
    assert line_pheromone(on_line, 0, 2, AntSettings(map_scale=3.0)).tolist() == [3.0] * 3
    assert line_pheromone(points, 0, 2, AntSettings(width_m=0.0)).tolist() == [1.0] * 3


def test_deposit_by_hand():
    settings = AntSettings(deposit=0.6, pheromone_min=0.01)
    orders = np.array([[0, 1, 2], [0, 2, 1]])
    # Ranks 0 and 1 of two: 0.6 * 2/2 / 1.0 and 0.6 * 1/2 / 1.5, after a fifth has evaporated.
    after = deposited(np.ones((3, 3)), orders, np.array([1.0, 1.5, 9.0]), 0.2, settings)
    by_hand = [[0.8, 1.4, 1.0], [1.4, 0.8, 1.6], [1.0, 1.6, 0.8]]
    assert np.allclose(after, by_hand, rtol=1e-12)


def test_pheromone_is_never_below_its_minimum():
    settings = AntSettings(pheromone_min=0.3, evaporation=0.9, deposit=0.0)
    pheromone = np.full((4, 4), 0.5)
    for _ in range(5):
        pheromone = deposited(
            pheromone, np.array([[0, 1, 2, 3]]), np.ones(1), settings.evaporation, settings
        )
        assert pheromone.min() >= 0.3
    assert pheromone.max() == pytest.approx(0.3)
    points = np.random.default_rng(0).random((9, 3))
    assert line_pheromone(points, 0, 1, AntSettings(width_m=0.01, pheromone_min=0.3)).min() == 0.3


def test_the_number_of_depositing_ants_falls_evenly():
    settings = AntSettings(iterations=9, depositing_first=10, depositing_last=2)
    assert [settings.depositing(n) for n in range(9)] == [10, 9, 8, 7, 6, 5, 4, 3, 2]
    assert AntSettings(iterations=1, depositing_first=7).depositing(0) == 7


def test_evaporation_changes_when_the_path_is_stagnant_and_stops_at_its_minimum():
    # Equal distances: no path is better than the first, so every third iteration changes it.
    settings = AntSettings(
        iterations=12, stagnation=3, evaporation=0.4, evaporation_factor=0.5, evaporation_min=0.15
    )
    found = ant_path(1.0 - np.eye(6), 0, 5, None, settings)
    assert found.evaporations == pytest.approx([0.4] * 3 + [0.2] * 3 + [0.15] * 6)


def test_the_roulette_gives_each_node_its_share():
    weights = np.tile([9.0, 9.0, 1.0, 2.0, 5.0], (5, 1))
    orders = walks(weights, 0, 1, 20_000, np.random.default_rng(0))
    assert np.all(np.sort(orders, axis=1) == np.arange(5))
    assert np.all(orders[:, 0] == 0) and np.all(orders[:, -1] == 1)
    # Neither start nor goal is among the choices: shares 1/8, 2/8, 5/8; then of those left.
    first = np.bincount(orders[:, 1], minlength=5) / 20_000
    assert first == pytest.approx([0.0, 0.0, 0.125, 0.25, 0.625], abs=0.015)
    second = orders[orders[:, 1] == 4][:, 2]
    assert np.mean(second == 3) == pytest.approx(2 / 3, abs=0.02)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("ants", 0), ("iterations", 0), ("stagnation", 0), ("evaporation", 0.0),
        ("evaporation", 1.0), ("evaporation_factor", 0.0), ("evaporation_factor", 1.1),
        ("evaporation_min", 0.5), ("evaporation_min", 0.0), ("depositing_last", 0),
        ("depositing_first", 1), ("depositing_first", 41), ("deposit", -1.0), ("map_scale", 0.0),
        ("pheromone_min", 0.0), ("pheromone_min", math.nan), ("width_m", -1.0),
        ("width_m", math.inf), ("local_moves", -1), ("travel_moves", -1), ("pheromone_first", 0.1),
        ("heuristic_last", 0.5), ("heuristic_first", -1.0), ("pheromone_last", -0.1),
    ],
)  # fmt: skip
def test_constants_out_of_range_are_named(name, value):
    with pytest.raises(InputError, match=rf"{name}.*found"):
        AntSettings(**{name: value})


@pytest.mark.parametrize("field", dataclasses.fields(AntSettings), ids=lambda field: field.name)
def test_every_constant_has_a_reason(field):
    assert f"        {field.name}: " in AntSettings.__doc__


def test_few_nodes():
    assert ant_path(np.zeros((1, 1)), 0, 0).order.tolist() == [0]
    two = ant_path(np.array([[0.0, 2.0], [2.0, 0.0]]), 1, 0)
    assert (two.order.tolist(), two.length) == ([1, 0], 2.0)
    points = np.array([(0, 0, 0), (5, 0, 0), (1, 0, 0)], float)
    three = ant_path(cdist(points, points), 0, 1)
    assert (three.order.tolist(), three.length) == ([0, 2, 1], 5.0)


def test_coincident_nodes_are_no_trouble():
    points = np.repeat(spread(5, 0)[0], 3, axis=0)
    found = ant_path(cdist(points, points), 0, 14, line_pheromone(points, 0, 14, AntSettings()))
    assert sorted(found.order) == list(range(15))
    assert found.length == pytest.approx(held_karp(cdist(points[::3], points[::3]), 0, 4))
    assert ant_path(np.zeros((6, 6)), 0, 5).length == 0.0


@pytest.mark.parametrize(
    ("distances", "ends", "message"),
    [
        (np.zeros((0, 0)), (0, 0), "at least one node"),
        (np.zeros((2, 3)), (0, 1), "shape"),
        (np.array([[0.0, math.nan], [math.nan, 0.0]]), (0, 1), "finite"),
        (np.array([[0.0, -1.0], [-1.0, 0.0]]), (0, 1), "from 0 on"),
        (np.array([[0.0, 1.0], [2.0, 0.0]]), (0, 1), "both ways"),
        (np.zeros((2, 2)), (0, 2), "ends from 0 to 1"),
        (np.zeros((2, 2)), (-1, 1), "ends from 0 to 1"),
        (np.zeros((2, 2)), (1, 1), "two different ends"),
    ],
)
def test_what_is_no_problem_for_ants_is_refused(distances, ends, message):
    with pytest.raises(InputError, match=message):
        ant_path(distances, *ends)


def test_bad_pheromone_and_points_are_refused():
    for pheromone in (np.ones(4), np.zeros(5), np.full(5, math.nan)):
        with pytest.raises(InputError, match="first pheromone above 0"):
            ant_path(1.0 - np.eye(5), 0, 4, pheromone)
    with pytest.raises(InputError, match="finite points"):
        line_pheromone(np.full((3, 3), math.nan), 0, 1, AntSettings())


@pytest.mark.parametrize("seed", range(6))
def test_local_improvement_ends_where_no_reversal_or_shift_helps(seed):
    points, start, end = spread(9, seed)
    distances = cdist(points, points)
    given = np.array([start, *(n for n in range(9) if n not in (start, end)), end])
    order = improved_path(distances, given)
    length = path_length(distances, order)
    assert sorted(order) == list(range(9)) and order[0] == start and order[-1] == end
    assert length <= path_length(distances, given)
    for i, j in itertools.combinations(range(1, 9), 2):
        turned = np.concatenate([order[:i], order[i:j][::-1], order[j:]])
        assert path_length(distances, turned) >= length - 1e-9
        if j - i <= 3:
            rest = np.delete(order, slice(i, j))
            ways = (order[i:j], order[i:j][::-1])
            for place, way in itertools.product(range(1, len(rest)), ways):
                moved = np.insert(rest, place, way)
                assert path_length(distances, moved) >= length - 1e-9


def test_features_are_the_row_pieces_and_the_clusters():
    path = mixed()
    points = np.delete(np.arange(len(path)), [3, 20])
    found = features(path, points)
    assert sorted(np.concatenate(found)) == points.tolist()
    rows = [feature for feature in found if path.kinds[feature[0]] == ROW]
    # Five rows of nine; point 3 of the first and point 2 of the third are not reached.
    assert [len(row) for row in rows] == [3, 5, 9, 2, 6, 9, 9]
    for row in rows:
        assert len(set(path.groups[row])) == 1 and np.all(np.diff(row) == 1)
    # 60 points make three clusters.
    assert len(found) - len(rows) == 3


@pytest.mark.parametrize("seed", range(5))
def test_the_travel_through_given_features_is_the_shortest(seed):
    rng = np.random.default_rng(seed)
    positions = rng.random((10, 3))
    ways = []
    for pair in range(5):
        way = np.array([2 * pair, 2 * pair + 1])
        ways.append([way, way[::-1]])
    begin, end = rng.random((2, 3))
    order, length = FeatureTravel(positions, ways, begin, end).points(np.arange(5))
    places = [
        np.concatenate([begin[None], positions[np.concatenate(choice)], end[None]])
        for choice in itertools.product(*ways)
    ]
    lengths = [np.linalg.norm(np.diff(each, axis=0), axis=1).sum() for each in places]
    assert length == pytest.approx(min(lengths))
    assert sorted(order) == list(range(10))


@pytest.mark.parametrize("seed", range(4))
def test_the_order_is_improved_until_no_reversal_or_displacement_helps(seed):
    rng = np.random.default_rng(seed)
    positions = rng.random((13, 3))
    # Features with one, two and four ways.
    ways = [[np.array([n])] for n in range(3)]
    ways += [[np.array([n, n + 1]), np.array([n + 1, n])] for n in range(3, 9, 2)]
    ways.append([np.array(way) for way in ((9, 10, 11, 12), (12, 11, 10, 9), (10, 9, 12, 11))])
    travel_of = FeatureTravel(positions, ways, rng.random(3))
    given = rng.permutation(7)
    order = travel_of.improved(given, 50)
    length = travel_of.lengths(order[None])[0]
    assert sorted(order) == list(range(7)) and order[0] == given[0] and order[-1] == given[-1]
    assert length <= travel_of.lengths(given[None])[0]
    assert length == pytest.approx(travel_of.points(order)[1])
    for i, j in itertools.combinations(range(1, 7), 2):
        turned = np.concatenate([order[:i], order[i:j][::-1], order[j:]])
        displaced = np.insert(np.delete(order, i), j - 1, order[i])
        for other in (turned, displaced) if i < 6 else (turned,):
            if other[-1] == order[-1]:
                assert travel_of.lengths(other[None])[0] >= length - 1e-8
    assert np.array_equal(travel_of.improved(given, 0), given)


def test_every_point_comes_once_and_the_cost_is_the_travel():
    path = mixed()
    begin, end = np.array([-1.0, -0.5, 0.3]), np.array([1.0, 0.5, 0.3])
    for points in (np.arange(len(path)), np.arange(4, 70, 3), np.arange(80, 90)):
        order = ants_order(task_of(path, points, begin, end))
        assert sorted(order.points) == points.tolist()
        assert order.cost == pytest.approx(travel(path, order.points, begin, end))
        assert math.isnan(order.gap)


def test_rows_stay_whole():
    path = mixed()
    order = ants_order(task_of(path)).points
    groups = np.where(path.kinds == ROW, path.groups, -1)[order]
    changes = np.flatnonzero(np.diff(groups) != 0)
    starts = groups[np.append(0, changes + 1)]
    for row in range(5):
        assert np.count_nonzero(starts == row) == 1


def test_plain_rows_are_driven_as_a_z_from_the_corner_where_the_scanner_is():
    path = flat_path(0.8, 0.4, 0.2)
    begin, end = np.array([0.6, -0.4, 0.3]), np.array([-0.6, 0.4, 0.3])
    order = ants_order(task_of(path, None, begin, end)).points
    steps = np.linalg.norm(np.diff(path.positions[order], axis=0), axis=1)
    assert np.allclose(steps, 0.2)
    assert np.allclose(path.positions[order[0]][:2], (0.4, -0.2))


def test_travel_is_shorter_than_that_of_the_published_order():
    path = mixed()
    begin = np.array([-0.9, -0.5, 0.3])
    ours = ants_order(task_of(path, None, begin))
    published = published_order(task_of(path, None, begin))
    assert ours.cost < travel(path, published.points, begin)


def test_begin_and_end_at_the_same_feature_give_two_different_ends():
    path = flat_path(0.8, 0.4, 0.2)
    here = np.array([-0.6, -0.4, 0.3])
    order = ants_order(task_of(path, None, here, here))
    assert sorted(order.points) == list(range(len(path)))
    # The best closed tour over three rows: there on the first, back on the last.
    assert path.groups[order.points[0]] == 0


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_few_points(count):
    path = mixed()
    for first in (0, 60):
        points = np.arange(first, first + count)
        assert sorted(ants_order(task_of(path, points)).points) == points.tolist()


def test_coincident_points():
    targets = np.zeros((7, 3))
    path = path_of(targets, np.tile(DOWN, (7, 1)), [ROW] * 3 + [FEATURE] * 4, [0] * 3 + [1] * 4)
    assert sorted(ants_order(task_of(path)).points) == list(range(7))


def test_the_order_is_deterministic_and_does_not_depend_on_the_frame():
    path = mixed()
    T = transform((1.0, -2.0, 0.5), np.array([0.1, 0.5, -0.3, 0.8]))
    moved = path_of(apply(T, path.targets), rotate(T, path.directions), path.kinds, path.groups)
    begin, end = np.array([[-0.9, -0.5, 0.3], [0.9, 0.6, 0.3]])
    a = ants_order(task_of(path, None, begin, end)).points
    assert np.array_equal(a, ants_order(task_of(path, None, begin, end)).points)
    ends = apply(T, np.stack([begin, end]))
    assert np.array_equal(a, ants_order(task_of(moved, None, *ends)).points)


def test_positions_that_are_not_finite_are_refused():
    path = mixed()
    path.positions[5, 1] = math.nan
    with pytest.raises(ScanPathInvalidError, match="finite positions"):
        ants_order(task_of(path))


def test_the_strategy_is_registered():
    assert STRATEGIES["ants"] is ants_order
