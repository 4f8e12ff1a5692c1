"""The way through an order of points: lazily checked, yet the same as with every edge checked."""

from itertools import pairwise

import numpy as np
import pytest

from reach_scene import flat_panel, flat_path, in_arm_base, upright
from skinplan.errors import CancelledError
from skinplan.robot.cell import CellConfig
from skinplan.robot.collision import CollisionWorld
from skinplan.robot.dexterity import Dexterity
from skinplan.robot.reach import Views
from skinplan.trajectory.graph import HOME as AT_HOME
from skinplan.trajectory.graph import START, Problem, StationGraph
from skinplan.trajectory.ladder import BREAK, STRAIGHT, Ladder, Solution
from skinplan.trajectory.search import NO_MOTION, Search
from skinplan.trajectory.states import States, find_states
from skinplan.trajectory.transit import Transit
from skinplan.transforms import planar

CELL = CellConfig()
HOME = np.array(CELL.home_rad)
PATH = flat_path(1.0, 0.6, 0.1)
T = in_arm_base(CELL, planar(0.0, -0.9, 0.0), upright(0.6))
WORLD = CollisionWorld(CELL, flat_panel(1.0, 0.6), T)
DEXTERITY = Dexterity(WORLD.arm)
ORDERS = [(38, 39, 40), (1, 2, 3, 4), (1, 9, 12), (24, 57, 60)]
STATES = 3  # of each view: the ones nearest to home


def station(points, is_cancelled=lambda: False, progress=lambda share: None):
    """A graph of straight views; views are numbers of the points given."""
    points = list(points)
    views = Views.placed(PATH.positions[points], PATH.directions[points], PATH.targets[points], T)
    states = few_states(find_states(WORLD, DEXTERITY, views, 0.0, HOME))
    assert not states.reasons
    start = HOME + [0.3, 0.1, 0.0, 0.0, 0.1, 0.0]
    problem = Problem(
        world=WORLD,
        dexterity=DEXTERITY,
        reference=views.reference,
        home=HOME,
        start=start,
        tcp_speed=0.2,
        velocity=WORLD.arm.velocity,
        acceleration=CELL.acceleration_max_rad_s2,
        seed=0,
        progress=progress,
        is_cancelled=is_cancelled,
    )
    return StationGraph(problem, states)


def few_states(states):
    gaps = np.abs(states.q - HOME).max(axis=1)
    parts = [states.of(view) for view in np.unique(states.view)]
    kept = np.concatenate([np.sort(p[np.argsort(gaps[p], kind="stable")[:STATES]]) for p in parts])
    return States(
        states.view[kept],
        states.poses.pick(kept),
        states.tilt_rad[kept],
        states.cost_s[kept],
        states.reasons,
    )


def layers_of(graph, views):
    return [graph.layer(view) for view in (START, *views, AT_HOME)]


def check_everything(graph, views):
    """Checks every straight edge and plans every break between neighbours in an order."""
    for first, second in pairwise(layers_of(graph, views)):
        pairs = [(int(a), int(b)) for a in first for b in second]
        graph.check_straight([p for p in pairs if not graph.knows_straight(p)])
        for pair in pairs:
            if not graph.knows_break(pair):
                graph.plan_break(pair)


def bar(graph, first, second, kinds=(True, False)):
    """Takes all edges between two layers out, of some kinds (straight or not)."""
    for a in graph.layer(first):
        for b in graph.layer(second):
            for straight in kinds:
                graph.forbid((int(a), int(b)), straight)


def isolate(graph, view, count):
    for other in (START, AT_HOME, *range(count)):
        if other != view:
            bar(graph, view, other)


def require_way(graph, way):
    """Every edge begins and ends at its nodes and is free; nodes belong to the points."""
    assert way.nodes[0] == graph.start and way.nodes[-1] == graph.home
    assert len(way.edges) == len(way.points) + 1 == len(way.nodes) - 1
    assert graph.states.view[way.nodes[1:-1]].tolist() == way.points.tolist()
    assert np.array_equal(way.states, [graph.q(node) for node in way.nodes[1:-1]])
    cost = sum(float(c) for c in graph.node_costs(np.array(way.nodes)))
    for number, edge in enumerate(way.edges):
        a, b = way.pair(number)
        assert (a, b) == (way.nodes[number], way.nodes[number + 1])
        at = np.array([a]), np.array([b])
        if isinstance(edge, Transit):
            cost += float(graph.break_s(*at)[0, 0])
            legs = edge.legs
        else:
            cost += float(graph.straight_s(*at)[0, 0])
            legs = (edge,)
        assert np.abs(legs[0][0] - graph.q(a)).max() < 1e-9
        assert np.abs(legs[-1][-1] - graph.q(b)).max() < 1e-9
        for one, following in pairwise(legs):
            assert np.array_equal(one[-1], following[0])
        for leg in legs:
            assert np.all(WORLD.free(WORLD.dense(leg)[0])) and np.all(WORLD.arm.within_limits(leg))
    assert way.cost_s == pytest.approx(cost)


def kinds_of(way):
    return [BREAK if isinstance(edge, Transit) else STRAIGHT for edge in way.edges]


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("stops", [False, True])
def test_the_way_is_the_same_as_with_every_edge_checked(order, stops):
    """With stops: the scan can't go straight on between the two points in the middle."""
    views = list(range(len(order)))
    lazy, eager = station(order), station(order)
    for graph in (lazy, eager):
        if stops:
            bar(graph, 1, 2, (True,))
    way = Search(lazy).run(np.array(views))
    check_everything(eager, views)
    costs = eager.layer_costs(views)
    solved = Ladder(*costs).solve()
    assert isinstance(solved, Solution)
    assert way.cost_s == pytest.approx(solved.cost_s, abs=1e-9)
    assert way.points.tolist() == views and way.dropped == {}
    require_way(lazy, way)
    kinds = kinds_of(way)
    assert kinds[0] == kinds[-1] == BREAK  # the start and home are no views
    assert not stops or kinds[2] == BREAK


def test_only_a_part_of_the_edges_is_checked(monkeypatch):
    order = (1, 2, 3, 4, 15)
    graph = station(order)
    asked = []
    plan, check = graph.plan_break, graph.check_straight

    def plan_break(pair):
        asked.append((BREAK, pair))
        return plan(pair)

    def check_straight(pairs):
        asked.extend((STRAIGHT, pair) for pair in pairs)
        return check(pairs)

    monkeypatch.setattr(graph, "plan_break", plan_break)
    monkeypatch.setattr(graph, "check_straight", check_straight)
    Search(graph).run(np.arange(5))
    every = sum(2 * len(a) * len(b) for a, b in pairwise(layers_of(graph, range(5))))
    assert len(set(asked)) == len(asked)  # and each of them once
    assert 6 <= len(asked) < 0.5 * every
    before = len(asked)
    Search(graph).run(np.arange(5))
    assert len(asked) == before  # the graph keeps what it knows


def test_a_forbidden_edge_leads_to_another_way():
    order = (38, 39, 40)
    graph = station(order)
    way = Search(graph).run(np.arange(3))
    pair = way.pair(1)
    assert kinds_of(way)[1] == STRAIGHT
    graph.forbid(pair, True)
    other = Search(graph).run(np.arange(3))
    require_way(graph, other)
    assert other.points.tolist() == [0, 1, 2] and other.cost_s >= way.cost_s - 1e-9
    assert other.pair(1) != pair or isinstance(other.edges[1], Transit)
    # The same the other way round: an edge that can't be driven can't be driven back.
    back = Search(graph).run(np.array([2, 1, 0]))
    for number in range(1, 3):
        if back.pair(number) == pair[::-1]:
            assert isinstance(back.edges[number], Transit)


def test_a_forbidden_break_leads_to_another_way():
    graph = station((38, 39))
    way = Search(graph).run(np.arange(2))
    pair = way.pair(0)
    graph.forbid(pair, False)
    other = Search(graph).run(np.arange(2))
    require_way(graph, other)
    assert other.pair(0) != pair and other.cost_s >= way.cost_s - 1e-9


@pytest.mark.parametrize("lost", [0, 1, 2, 3])
def test_a_point_that_no_motion_leads_to_is_dropped_by_name_and_the_others_stay(lost):
    graph = station((1, 2, 3, 4))
    isolate(graph, lost, 4)
    way = Search(graph).run(np.arange(4))
    assert way.dropped == {lost: NO_MOTION}
    assert way.points.tolist() == [view for view in range(4) if view != lost]
    require_way(graph, way)


def test_where_nothing_leads_home_all_points_are_dropped_by_name():
    graph = station((38, 39, 40))
    for view in range(3):
        bar(graph, view, AT_HOME)
    way = Search(graph).run(np.arange(3))
    assert way.dropped == dict.fromkeys(range(3), NO_MOTION)
    assert len(way.points) == len(way.edges) == len(way.nodes) == 0 and way.states.shape == (0, 6)


def test_points_that_were_dropped_before_are_left_out():
    graph = station((38, 39, 40))
    given = {1: "a reason of its own"}
    way = Search(graph).run(np.arange(3), given)
    assert way.points.tolist() == [0, 2] and way.dropped == {1: "a reason of its own"}
    isolate(graph, 2, 3)
    way = Search(graph).run(np.arange(3), given)
    assert way.points.tolist() == [0] and given == {1: "a reason of its own"}
    assert way.dropped == {1: "a reason of its own", 2: NO_MOTION}


def test_an_order_of_nothing_is_an_empty_way():
    way = Search(station((38,))).run(np.zeros(0, dtype=np.int64))
    assert len(way.points) == 0 and way.edges == [] and way.dropped == {}


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [3, 1, 0, 2], [2, 0]])
def test_points_are_visited_in_the_order_asked_for(order):
    graph = station((1, 5, 9, 20))
    way = Search(graph).run(np.array(order))
    assert way.points.tolist() == order
    require_way(graph, way)


def test_the_same_question_has_the_same_answer():
    ways = [Search(station((1, 9, 12, 20))).run(np.arange(4)) for _ in range(2)]
    assert ways[0].nodes == ways[1].nodes and ways[0].cost_s == ways[1].cost_s
    for a, b in zip(ways[0].edges, ways[1].edges, strict=True):
        for one, other in zip(
            a.legs if isinstance(a, Transit) else [a],
            b.legs if isinstance(b, Transit) else [b],
            strict=True,
        ):
            assert np.array_equal(one, other)


@pytest.mark.parametrize("calls", [1, 2, 3])
def test_it_stops_when_asked(calls):
    asked = []

    def is_cancelled():
        asked.append(True)
        return len(asked) >= calls

    with pytest.raises(CancelledError):
        Search(station((1, 9, 12, 20), is_cancelled)).run(np.arange(4))
    assert len(asked) == calls


def test_it_tells_how_far_it_is():
    told = []
    Search(station((1, 9, 12, 20), progress=told.append)).run(np.arange(4))
    assert told and all(0.0 <= share <= 1.0 for share in told)
