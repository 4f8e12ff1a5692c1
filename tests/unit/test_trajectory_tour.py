"""The tour through groups of states, and its lower bound, against all orders of small stations."""

import dataclasses
from itertools import permutations

import numpy as np
import pytest

from reach_scene import flat_panel, flat_path, in_arm_base, upright
from skinplan.errors import InputError
from skinplan.robot.cell import CellConfig
from skinplan.robot.collision import CollisionWorld
from skinplan.robot.dexterity import Dexterity
from skinplan.robot.reach import Views
from skinplan.trajectory.graph import BREAK_PRICE_S, BREAK_S, START, Problem, StationGraph
from skinplan.trajectory.graph import HOME as AT_HOME
from skinplan.trajectory.ladder import Ladder, Solution
from skinplan.trajectory.order import published_order
from skinplan.trajectory.states import find_states
from skinplan.trajectory.tour_bound import tour_bound
from skinplan.trajectory.tour_order import tour_order
from skinplan.trajectory.visit import VisitOrder, VisitTask
from skinplan.transforms import apply, inverse, planar

CELL = CellConfig()
HOME = np.array(CELL.home_rad)
PATH = flat_path(1.0, 0.6, 0.1)
T = in_arm_base(CELL, planar(0.0, -0.9, 0.0), upright(0.6))
WORLD = CollisionWorld(CELL, flat_panel(1.0, 0.6), T)
DEXTERITY = Dexterity(WORLD.arm)


def station(points, tilt_rad=0.0, start=HOME, tcp_speed=0.2):
    """The graph of some points at a station; views are numbers of these points."""
    views = Views.placed(PATH.positions[points], PATH.directions[points], PATH.targets[points], T)
    states = find_states(WORLD, DEXTERITY, views, tilt_rad, HOME)
    assert not states.reasons
    problem = Problem(
        world=WORLD,
        dexterity=DEXTERITY,
        reference=views.reference,
        home=HOME,
        start=start,
        tcp_speed=tcp_speed,
        velocity=WORLD.arm.velocity,
        acceleration=CELL.acceleration_max_rad_s2,
        seed=0,
        progress=lambda share: None,
        is_cancelled=lambda: False,
    )
    return StationGraph(problem, states)


def task_of(points, graph, **more):
    points = np.asarray(points)
    begin, end = apply(inverse(T), graph.positions(np.array([graph.start, graph.home])))
    given = {"begin": begin, "end": end, "among": points, "graph": graph, "effort_s": 0.2}
    return VisitTask(PATH, points, 0.1, **(given | more))


def cost_of(graph, views):
    """What the best states for an order cost."""
    solved = Ladder(*graph.layer_costs(list(views))).solve()
    return solved.cost_s if isinstance(solved, Solution) else np.inf


def best_order_cost(graph, count):
    return min(cost_of(graph, order) for order in permutations(range(count)))


def cheapest_by_hand(graph, count):
    """All orders, all states, all kinds, without the ladder."""
    layers = [graph.layer(view) for view in range(count)]
    best = np.inf
    for order in permutations(range(count)):
        cost = graph.node_costs(graph.layer(START))[None]
        here = graph.layer(START)
        for view in (*order, AT_HOME):
            there = graph.layer(view) if view < 0 else layers[view]
            step = np.minimum(graph.straight_s(here, there), graph.break_s(here, there))
            cost = (cost.ravel()[:, None] + step).min(axis=0) + graph.node_costs(there)
            here = there
        best = min(best, float(cost.min()))
    return best


SMALL = [
    (38, 39, 40),
    (0, 10, 66, 76),
    (24, 27, 49, 52),
    (5, 16, 27, 38, 49),
    (0, 38, 76, 10, 66),
    (33, 34, 43, 42, 38),
]


@pytest.mark.parametrize("points", SMALL)
@pytest.mark.parametrize("start", ["home", "elsewhere"])
def test_the_bound_is_below_every_order_and_more_than_nothing(points, start):
    points = np.sort(points)
    begin = HOME if start == "home" else HOME + [0.5, 0.2, -0.2, 0.0, 0.1, 0.0]
    graph = station(points, start=begin)
    least = best_order_cost(graph, len(points))
    assert least == pytest.approx(cheapest_by_hand(graph, len(points)))
    bound = tour_bound(graph, np.arange(len(points)))
    assert 0.0 < bound <= least + 1e-9


@pytest.mark.parametrize("points", SMALL[:3])
def test_the_bound_holds_with_tilted_states_too(points):
    points = np.sort(points)
    graph = station(points, np.radians(10.0))
    least = best_order_cost(graph, len(points))
    bound = tour_bound(graph, np.arange(len(points)))
    assert 0.0 < bound <= least + 1e-9


@pytest.mark.parametrize("tcp_speed", [0.02, 0.1])
def test_the_bound_follows_the_scanners_speed_limit(tcp_speed):
    """Where the scanner is slow its way counts most: then the bound is most of the optimum."""
    points = np.array([33, 35, 37, 39])
    graph = station(points, tcp_speed=tcp_speed)
    bound, least = tour_bound(graph, np.arange(4)), best_order_cost(graph, 4)
    # Three steps of 0.2 m, or breaks where these are quicker: standing still, their price.
    step = min(0.2 / tcp_speed, BREAK_S + BREAK_PRICE_S)
    assert 3 * step <= bound <= least + 1e-9 and bound > 0.5 * least


def test_the_bound_of_one_point_is_what_it_costs():
    """From the start to it and home: the least of both ends, and the cheapest state."""
    graph = station(np.array([38]))
    nodes = graph.layer(0)
    start, home = np.array([graph.start]), np.array([graph.home])
    ends = graph.break_s(start, nodes), graph.break_s(nodes, home)
    bound = tour_bound(graph, np.array([0]))
    by_hand = ends[0].min() + ends[1].min() + graph.node_costs(nodes).min()
    assert bound == pytest.approx(by_hand) and bound <= cost_of(graph, [0]) + 1e-9


def test_the_bound_of_two_points_by_hand():
    graph = station(np.array([38, 40]))
    way = 0.2 / 0.2
    ends = [
        [float(graph.break_s(np.array([end]), graph.layer(v)).min()) for v in range(2)]
        for end in (graph.start, graph.home)
    ]
    own = sum(float(graph.node_costs(graph.layer(v)).min()) for v in range(2))
    tours = min(ends[0][0] + ends[1][1], ends[0][1] + ends[1][0])
    bound = tour_bound(graph, np.arange(2))
    assert bound <= own + way + tours + 1e-9
    assert bound >= own + way + min(ends[0]) + min(ends[1]) - 1e-9


@pytest.mark.parametrize("points", SMALL)
def test_a_tour_visits_each_point_once_and_is_the_best_or_near_it(points):
    points = np.sort(points)
    graph = station(points)
    found = tour_order(task_of(points, graph))
    assert sorted(found.points.tolist()) == points.tolist()
    views = np.searchsorted(points, found.points)
    assert found.cost == pytest.approx(cost_of(graph, views))
    least = best_order_cost(graph, len(points))
    assert found.bound <= least + 1e-9 and least - 1e-9 <= found.cost <= 1.05 * least
    assert found.gap == pytest.approx(found.cost / found.bound - 1.0)


WHOLE = np.arange(len(PATH))


@pytest.fixture(scope="module")
def panel():
    """The graph of every other column of the panel, straight views only."""
    points = WHOLE[WHOLE % 11 % 2 == 0]
    return points, station(points)


def test_on_a_panel_it_is_no_worse_than_the_published_order(panel):
    points, graph = panel
    task = task_of(points, graph, effort_s=1.0)
    found, published = tour_order(task), published_order(task)
    assert sorted(found.points.tolist()) == points.tolist()
    cost = cost_of(graph, np.searchsorted(points, published.points))
    assert found.bound < found.cost <= cost + 1e-9
    assert found.cost == pytest.approx(cost_of(graph, np.searchsorted(points, found.points)))


def test_the_same_seed_gives_the_same_tour(panel):
    points, graph = panel
    first, again = (tour_order(task_of(points, graph, effort_s=0.5)) for _ in range(2))
    assert np.array_equal(first.points, again.points) and first.cost == again.cost
    other = tour_order(task_of(points, station(points), effort_s=0.5))
    assert np.array_equal(first.points, other.points)
    reseeded = tour_order(task_of(points, graph, effort_s=0.5, seed=7))
    assert sorted(reseeded.points.tolist()) == points.tolist()


def test_more_effort_is_no_worse(panel):
    points, graph = panel
    costs = [tour_order(task_of(points, graph, effort_s=s)).cost for s in (0.0, 0.5, 1.5)]
    assert costs[0] >= costs[1] - 1e-9 >= costs[2] - 2e-9


def test_a_known_order_is_improved_or_kept(panel):
    points, graph = panel
    known = np.random.default_rng(0).permutation(points)
    cost = cost_of(graph, np.searchsorted(points, known))
    found = tour_order(task_of(points, graph, known=known, effort_s=0.0))
    assert found.cost < cost and sorted(found.points.tolist()) == points.tolist()
    again = tour_order(task_of(points, graph, known=found.points, effort_s=0.0))
    assert again.cost <= found.cost + 1e-9


def test_no_effort_at_all_still_gives_a_tour(panel):
    points, graph = panel
    found = tour_order(task_of(points, graph, effort_s=0.0))
    assert sorted(found.points.tolist()) == points.tolist() and np.isfinite(found.cost)


def test_only_some_of_the_points_are_asked_for(panel):
    points, graph = panel
    some = points[3:9]
    task = dataclasses.replace(task_of(points, graph), points=some)
    found = tour_order(task)
    assert sorted(found.points.tolist()) == some.tolist()
    assert found.cost == pytest.approx(cost_of(graph, np.searchsorted(points, found.points)))


@pytest.mark.parametrize("points", [[38], [38, 39], [0, 76], [10, 38, 66]])
@pytest.mark.parametrize("effort_s", [0.0, 0.1])
def test_few_points(points, effort_s):
    graph = station(np.array(points))
    found = tour_order(task_of(points, graph, effort_s=effort_s))
    assert sorted(found.points.tolist()) == points
    least = best_order_cost(graph, len(points))
    assert found.cost == pytest.approx(least)
    assert 0.0 < found.bound <= least + 1e-9


def test_a_task_without_a_graph_is_refused():
    task = dataclasses.replace(task_of([38, 39], station(np.array([38, 39]))), graph=None)
    with pytest.raises(InputError, match="'tour' needs the states"):
        tour_order(task)


def bar(graph, first, second, kinds):
    """Takes all edges between the states of two views out, of some kinds, both ways."""
    for a in graph.layer(first):
        for b in graph.layer(second):
            for straight in kinds:
                graph.forbid((int(a), int(b)), straight)


@pytest.mark.parametrize("place", [0, 1, 2, 3])
@pytest.mark.parametrize("kinds", [(True,), (True, False)])
def test_edges_that_were_checked_in_vain_are_not_gone_again(place, kinds):
    """Also where nothing leads through the order that the search begins with."""
    points = np.array([33, 34, 35, 36, 37])
    graph = station(points)
    before = tour_order(task_of(points, graph))
    order = np.searchsorted(points, before.points)
    bar(graph, order[place], order[place + 1], kinds)
    after = tour_order(task_of(points, graph))
    again = np.searchsorted(points, after.points)
    assert sorted(again.tolist()) == list(range(5))
    least = best_order_cost(graph, 5)
    assert before.cost < least < np.inf
    assert least - 1e-9 <= after.cost <= 1.05 * least
    if False in kinds:
        barred = set(order[place : place + 2].tolist())
        steps = zip(again[:-1].tolist(), again[1:].tolist(), strict=True)
        assert all(set(step) != barred for step in steps)


def test_where_no_order_is_possible_one_is_given_at_no_finite_cost():
    points = np.array([33, 34])
    graph = station(points)
    bar(graph, 0, 1, (True, False))
    found = tour_order(task_of(points, graph))
    assert sorted(found.points.tolist()) == points.tolist() and found.cost == np.inf


def test_the_gap_of_an_order_without_a_bound_is_not_known():
    assert np.isnan(VisitOrder(np.arange(3)).gap)
    assert VisitOrder(np.arange(3), 3.0, 2.0).gap == pytest.approx(0.5)
    assert np.isnan(VisitOrder(np.arange(3), 3.0, 0.0).gap)
