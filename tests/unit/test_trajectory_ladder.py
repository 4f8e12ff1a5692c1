"""The ladder graph against brute force over all ways."""

from itertools import product

import numpy as np
import pytest

from skinplan.trajectory.ladder import BREAK, STRAIGHT, Ladder, Solution

KINDS = (STRAIGHT, BREAK)


def random_costs(seed, closed=0.6):
    """Costs of two to five layers of one to four states; a share of the edges is impossible."""
    rng = np.random.default_rng(seed)
    sizes = rng.integers(1, 5, rng.integers(2, 6))
    states = [rng.uniform(0.0, 1.0, size) for size in sizes]
    edges = ([], [])
    for shape in zip(sizes, sizes[1:], strict=False):
        for kind in KINDS:
            cost = rng.uniform(0.0, 3.0, shape)
            cost[rng.random(shape) < closed] = np.inf
            edges[kind].append(cost)
    return states, *edges


def ladder_of(costs):
    """A ladder of copies: it corrects the costs in place."""
    return Ladder(*([np.array(part) for part in group] for group in costs))


def ways(costs):
    """Cost, states and kinds of every way that is possible."""
    own, *edges = costs
    for states in product(*(range(len(layer)) for layer in own)):
        base = sum(layer[s] for layer, s in zip(own, states, strict=True))
        for kinds in product(KINDS, repeat=len(own) - 1):
            steps = zip(kinds, states, states[1:], strict=False)
            cost = base + sum(edges[k][i][a, b] for i, (k, a, b) in enumerate(steps))
            if np.isfinite(cost):
                yield cost, states, kinds


def first_unreached(costs):
    """The first layer that no way from the first one leads to."""
    own, straight, stop = costs
    here = np.isfinite(own[0])
    for layer, (a, b) in enumerate(zip(straight, stop, strict=True)):
        here = (here[:, None] & (np.isfinite(a) | np.isfinite(b))).any(axis=0)
        if not here.any():
            return layer + 1
    return None


def require_best(found, costs):
    """The solution is the cheapest of all ways, or the layer that none leads to."""
    best = min((cost for cost, _, _ in ways(costs)), default=np.inf)
    if isinstance(found, int):
        assert not np.isfinite(best) and found == first_unreached(costs)
        return
    assert found.cost_s == pytest.approx(best, abs=1e-12)
    known = {(states, kinds): cost for cost, states, kinds in ways(costs)}
    own = known[tuple(found.states.tolist()), tuple(found.kinds.tolist())]
    assert own == pytest.approx(best, abs=1e-12)


@pytest.mark.parametrize("seed", range(60))
def test_the_best_way_equals_brute_force(seed):
    costs = random_costs(seed)
    require_best(ladder_of(costs).solve(), costs)


def test_the_random_graphs_have_all_sorts_of_answers():
    """Without this the test above might see only closed graphs, or only one kind of edge."""
    found = [ladder_of(random_costs(seed)).solve() for seed in range(60)]
    open_ones = [way for way in found if isinstance(way, Solution)]
    assert len(open_ones) >= 30 and len(found) - len(open_ones) >= 5
    kinds = np.concatenate([way.kinds for way in open_ones])
    assert 0.2 < kinds.mean() < 0.8


@pytest.mark.parametrize("seed", range(40))
@pytest.mark.parametrize("kind", KINDS)
def test_the_most_promising_edges_equal_brute_force(seed, kind):
    costs = random_costs(seed)
    ladder = ladder_of(costs)
    count = 3
    found = ladder.best_edges(kind, dict.fromkeys(range(len(costs[0]) - 1), count))
    assert [layer for layer, _ in found] == list(range(len(costs[0]) - 1))
    for layer, pairs in found:
        # The best way through an edge, whatever kind the other edges are of.
        through = {}
        for cost, states, kinds in ways(costs):
            if kinds[layer] == kind:
                edge = states[layer], states[layer + 1]
                through[edge] = min(cost, through.get(edge, np.inf))
        expected = sorted(through, key=lambda edge: through[edge])[:count]
        assert [tuple(pair) for pair in pairs.tolist()] == expected


def test_more_edges_than_there_are_may_be_asked_for():
    costs = random_costs(3, closed=0.0)
    for layer, pairs in ladder_of(costs).best_edges(BREAK, {0: 1000}):
        size = costs[2][layer].size
        assert sorted(map(tuple, pairs.tolist())) == list(np.ndindex(costs[2][layer].shape))
        assert len(pairs) == size


@pytest.mark.parametrize("seed", range(40))
def test_a_corrected_ladder_is_like_one_made_anew(seed):
    costs = random_costs(seed, closed=0.2)
    ladder = ladder_of(costs)
    rng = np.random.default_rng(1000 + seed)
    for _ in range(12):
        kind, layer = int(rng.integers(2)), int(rng.integers(len(costs[0]) - 1))
        a, b = (int(rng.integers(size)) for size in costs[1 + kind][layer].shape)
        price = np.inf if rng.random() < 0.5 else float(rng.uniform(0.0, 3.0))
        ladder.set_cost(kind, layer, a, b, price)
        costs[1 + kind][layer][a, b] = price
        found, fresh = ladder.solve(), ladder_of(costs).solve()
        require_best(found, costs)
        if isinstance(fresh, int):
            assert found == fresh
            continue
        assert np.array_equal(found.states, fresh.states)
        assert np.array_equal(found.kinds, fresh.kinds) and found.cost_s == fresh.cost_s
        for kind in KINDS:
            ones = [made.best_edges(kind, {layer: 4})[0][1] for made in (ladder, ladder_of(costs))]
            assert np.array_equal(*ones)


def test_an_edge_that_gets_cheaper_is_taken():
    none = np.array([[np.inf]])
    ladder = Ladder([np.zeros(1), np.zeros(1)], [np.array([[2.0]])], [none])
    assert ladder.solve().kinds.tolist() == [STRAIGHT]
    ladder.set_cost(BREAK, 0, 0, 0, 1.0)
    found = ladder.solve()
    assert found.kinds.tolist() == [BREAK] and found.cost_s == 1.0


def test_of_edges_that_cost_the_same_the_straight_one_is_taken():
    same = [np.array([[0.5]])]
    assert Ladder([np.zeros(1)] * 2, same, [same[0].copy()]).solve().kinds.tolist() == [STRAIGHT]


@pytest.mark.parametrize("gap", [1, 2, 3])
def test_the_layer_that_nothing_leads_to_is_named(gap):
    open_ones, closed = np.ones((2, 2)), np.full((2, 2), np.inf)
    straight = [closed if i + 1 == gap else open_ones for i in range(3)]
    stop = [closed if i + 1 >= gap else open_ones for i in range(3)]
    assert Ladder([np.zeros(2)] * 4, straight, stop).solve() == gap
    open_again = Ladder([np.zeros(2)] * 4, [c.copy() for c in straight], [c.copy() for c in stop])
    open_again.set_cost(BREAK, gap - 1, 1, 0, 9.0)
    found = open_again.solve()
    assert isinstance(found, Solution) and found.cost_s == 11.0


def test_a_layer_is_unreached_also_where_only_dead_ends_lead_on():
    """The second layer's reached state and its open state are not the same."""
    inf = np.inf
    straight = [np.array([[1.0, inf]]), np.array([[inf], [1.0]])]
    stop = [np.full((1, 2), inf), np.full((2, 1), inf)]
    assert Ladder([np.zeros(1), np.zeros(2), np.zeros(1)], straight, stop).solve() == 2


def test_one_layer_is_its_cheapest_state():
    found = Ladder([np.array([3.0, 1.0, 2.0])], [], []).solve()
    assert found.states.tolist() == [1] and found.kinds.size == 0 and found.cost_s == 1.0


def test_greedy_would_be_wrong():
    """The nearest state of the second layer leads nowhere good; so does the cheapest one."""
    inf = np.inf
    straight = [np.array([[0.1, 0.5, 0.4]]), np.array([[5.0], [0.1], [inf]])]
    stop = [np.full((1, 3), inf), np.array([[4.0], [inf], [9.0]])]
    states = [np.zeros(1), np.array([0.0, 0.2, 0.0]), np.zeros(1)]
    found = Ladder(states, straight, stop).solve()
    assert found.states.tolist() == [0, 1, 0] and found.cost_s == pytest.approx(0.8)


def test_the_same_costs_give_the_same_way_every_time():
    """Also where many ways cost the same."""
    costs = [np.zeros(4)] * 5, [np.ones((4, 4))] * 4, [np.ones((4, 4))] * 4
    first = ladder_of(costs).solve()
    edges = ladder_of(costs).best_edges(STRAIGHT, {1: 5})[0][1]
    for _ in range(5):
        again = ladder_of(costs)
        assert np.array_equal(again.solve().states, first.states)
        assert np.array_equal(again.solve().states, first.states)
        assert np.array_equal(again.best_edges(STRAIGHT, {1: 5})[0][1], edges)
