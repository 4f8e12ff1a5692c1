"""Local search on tours against brute force over all orders."""

from itertools import permutations

import numpy as np
import pytest

from skinplan.trajectory.moves import _candidates, _moved, improved, kicked, tour_costs

INNER = 7
SEEDS = range(30)


def instance(seed, inner=INNER, price=0.3):
    """Places in the unit square, the ends among them: distances, and turns by their sharpness."""
    rng = np.random.default_rng(seed)
    places = rng.random((inner + 2, 2))
    step = places[None] - places[:, None]
    length = np.linalg.norm(step, axis=2)
    unit = step / np.where(length > 0, length, 1.0)[:, :, None]
    turns = price * 0.5 * (1.0 - np.einsum("abi,bci->abc", unit, unit))
    return length, turns


def cost_by_hand(order, cost, turns):
    edges = sum(cost[a, b] for a, b in zip(order, order[1:], strict=False))
    return edges + sum(turns[a, b, c] for a, b, c in zip(order, order[1:], order[2:], strict=False))


def best_of_all(cost, turns):
    n = len(cost)
    inner = np.array(list(permutations(range(1, n - 1))))
    orders = np.column_stack([np.zeros(len(inner), int), inner, np.full(len(inner), n - 1)])
    return tour_costs(orders, cost, turns).min()


def neighbours(order):
    """Every order that one 2-opt or or-opt move of up to three nodes leads to, ends kept."""
    order = list(order)
    n = len(order)
    for i in range(1, n - 1):
        for j in range(i + 1, n - 1):
            yield order[:i] + order[i : j + 1][::-1] + order[j + 1 :]
    for length in (1, 2, 3):
        for i in range(1, n - length):
            piece, rest = order[i : i + length], order[:i] + order[i + length :]
            for at in range(1, len(rest)):
                yield rest[:at] + piece + rest[at:]
                yield rest[:at] + piece[::-1] + rest[at:]


def require_tour(order, n):
    assert sorted(order.tolist()) == list(range(n)) and order[0] == 0 and order[-1] == n - 1


def test_costs_by_hand():
    cost = np.array([[0.0, 1.0, 4.0], [1.0, 0.0, 2.0], [4.0, 2.0, 0.0]])
    turns = np.zeros((3, 3, 3))
    turns[0, 1, 2], turns[1, 0, 2] = 0.25, 0.5
    orders = np.array([[0, 1, 2], [1, 0, 2], [2, 1, 0]])
    assert tour_costs(orders, cost, turns).tolist() == [3.25, 5.5, 3.0]
    assert tour_costs(np.array([[0, 2]]), cost, turns).tolist() == [4.0]


@pytest.mark.parametrize("seed", range(5))
def test_costs_equal_sums_one_by_one(seed):
    rng = np.random.default_rng(seed)
    cost, turns = rng.random((9, 9)), rng.random((9, 9, 9))
    orders = np.array([rng.permutation(9) for _ in range(20)])
    expected = [cost_by_hand(order.tolist(), cost, turns) for order in orders]
    assert tour_costs(orders, cost, turns) == pytest.approx(expected)


@pytest.mark.parametrize("seed", SEEDS)
def test_it_is_never_worse_than_before_and_its_cost_is_the_tours(seed):
    cost, turns = instance(seed, 12)
    order = np.concatenate([[0], 1 + np.random.default_rng(seed).permutation(12), [13]])
    before = tour_costs(order[None], cost, turns)[0]
    given = order.copy()
    tour, looked_at = improved(order, cost, turns)
    require_tour(tour.order, 14)
    assert np.array_equal(order, given) and looked_at > 0
    assert tour.cost <= before
    assert tour.cost == pytest.approx(cost_by_hand(tour.order.tolist(), cost, turns), abs=1e-8)


@pytest.mark.parametrize("seed", SEEDS)
def test_no_single_move_makes_it_any_better(seed):
    """With all edges of little length, so that no move is beyond what is looked at exactly."""
    cost, turns = instance(seed, 6)
    for order in ([0, 1, 2, 3, 4, 5, 6, 7], [0, 6, 2, 4, 3, 5, 1, 7]):
        best = improved(np.array(order), cost, 0.0 * turns)[0]
        around = np.array(list(neighbours(best.order)))
        assert tour_costs(around, cost, 0.0 * turns).min() >= best.cost - 1e-8


@pytest.mark.parametrize("seed", range(10))
def test_the_gain_of_every_move_is_the_change_in_length_and_no_move_is_missing(seed):
    cost, turns = instance(seed)
    order = np.concatenate([[0], 1 + np.random.default_rng(seed).permutation(INNER), [INNER + 1]])
    gains, moves = _candidates(order, cost)
    moved = np.array([_moved(order, move) for move in moves])
    before = tour_costs(order[None], cost, 0.0 * turns)
    assert gains == pytest.approx(tour_costs(moved, cost, 0.0 * turns) - before, abs=1e-12)
    for new in moved:
        require_tour(new, INNER + 2)
    unchanged = tuple(order.tolist())
    expected = {tuple(new) for new in neighbours(order.tolist())} - {unchanged}
    assert {tuple(new) for new in moved.tolist()} - {unchanged} == expected


def test_it_is_the_best_of_all_orders_or_near_it():
    """From one start a local optimum; of the starts that kicks give the best one is taken."""
    hits, excess = 0, []
    for seed in SEEDS:
        cost, turns = instance(seed)
        random = np.random.default_rng(seed)
        best = improved(np.arange(INNER + 2), cost, turns)[0]
        for _ in range(10):
            tried = improved(kicked(best.order, random), cost, turns)[0]
            best = min(best, tried, key=lambda tour: tour.cost)
        least = best_of_all(cost, turns)
        assert best.cost >= least - 1e-8
        hits += best.cost <= least + 1e-8
        excess.append(best.cost / least - 1.0)
    assert hits >= 25 and max(excess) <= 0.05


def test_without_kicks_too_most_instances_end_at_the_best_of_all_orders():
    excess = []
    for seed in SEEDS:
        cost, turns = instance(seed)
        found = improved(np.arange(INNER + 2), cost, turns)[0]
        excess.append(found.cost / best_of_all(cost, turns) - 1.0)
    assert np.sum(np.array(excess) < 1e-8) >= 16 and min(excess) > -1e-8
    assert max(excess) <= 0.05


def lattice(columns, rows, first, last, price):
    """Places on a unit lattice, column by column, between two ends."""
    inner = np.array([(x, y) for x in range(columns) for y in range(rows)], float)
    places = np.vstack([[first], inner, [last]])
    step = places[None] - places[:, None]
    length = np.linalg.norm(step, axis=2)
    unit = step / np.where(length > 0, length, 1.0)[:, :, None]
    return length, price * (1.0 - np.einsum("abi,bci->abc", unit, unit))


def test_a_long_way_round_with_few_turns_beats_many_turns():
    """Two rows of four: there and back has two turns, to and fro between them seven."""
    cost, turns = lattice(4, 2, (-1.0, 0.0), (-1.0, 1.0), 0.3)
    along = np.array([0, 1, 3, 5, 7, 8, 6, 4, 2, 9])
    across = np.array([0, 1, 2, 4, 3, 5, 6, 8, 7, 9])
    assert tour_costs(along[None], cost, turns)[0] == pytest.approx(9.0 + 2 * 0.3)
    best = improved(across, cost, turns)[0]
    assert best.cost == pytest.approx(9.6) and np.array_equal(best.order, along)


def test_of_two_ways_of_equal_length_the_one_with_fewer_turns_is_taken():
    """A square of nine, entered and left along x: by rows four turns, by columns six."""
    cost, turns = lattice(3, 3, (-1.0, 0.0), (3.0, 2.0), 0.2)
    by_columns = np.array([0, 1, 2, 3, 6, 5, 4, 7, 8, 9, 10])
    by_rows = np.array([0, 1, 4, 7, 8, 5, 2, 3, 6, 9, 10])
    both = np.stack([by_columns, by_rows])
    assert tour_costs(both, cost, 0 * turns) == pytest.approx([10.0, 10.0])
    assert tour_costs(both, cost, turns) == pytest.approx([10.0 + 6 * 0.2, 10.0 + 4 * 0.2])
    random = np.random.default_rng(0)
    best = improved(by_columns, cost, turns)[0]
    for _ in range(40):
        best = min(best, improved(kicked(best.order, random), cost, turns)[0], key=lambda t: t.cost)
    assert np.array_equal(best.order, by_rows)
    # Without a price both are as short as it gets: nothing is changed.
    assert np.array_equal(improved(by_columns, cost, 0 * turns)[0].order, by_columns)


def test_impossible_edges_are_avoided_where_there_is_another_way():
    cost, turns = instance(1)
    blocked = cost.copy()
    free = improved(np.arange(INNER + 2), cost, turns)[0].order
    for a, b in zip(free[1:-2], free[2:-1], strict=False):
        blocked[a, b] = blocked[b, a] = 1.0e4
    found = improved(np.arange(INNER + 2), blocked, turns)[0]
    require_tour(found.order, INNER + 2)
    assert found.cost < 1.0e4
    used = {frozenset(pair) for pair in zip(found.order[1:-2], found.order[2:-1], strict=False)}
    assert used.isdisjoint(frozenset(pair) for pair in zip(free[1:-2], free[2:-1], strict=False))


@pytest.mark.parametrize("n", [2, 3])
def test_where_nothing_can_be_moved_nothing_is(n):
    tour, looked_at = improved(np.arange(n), np.ones((n, n)), np.zeros((n, n, n)))
    assert tour.order.tolist() == list(range(n)) and tour.cost == n - 1 and looked_at == 0


def test_two_points_are_put_in_the_right_order():
    places = np.array([0.0, 2.0, 1.0, 3.0])
    cost = np.abs(places[None] - places[:, None])
    tour, _ = improved(np.arange(4), cost, np.zeros((4, 4, 4)))
    assert tour.order.tolist() == [0, 2, 1, 3] and tour.cost == 3.0


def test_the_same_question_has_the_same_answer():
    cost, turns = instance(5, 20)
    first = improved(np.arange(22), cost, turns)
    for _ in range(3):
        again = improved(np.arange(22), cost, turns)
        assert np.array_equal(again[0].order, first[0].order) and again[1] == first[1]
    kicks = [
        [kicked(np.arange(22), random).tolist() for _ in range(5)]
        for random in (np.random.default_rng(3), np.random.default_rng(3), np.random.default_rng(4))
    ]
    assert kicks[0] == kicks[1] != kicks[2]


@pytest.mark.parametrize("inner", [2, 3, 4, 8, 40, 200])
def test_a_kick_swaps_two_neighbouring_pieces_and_keeps_the_ends(inner):
    random = np.random.default_rng(inner)
    order = np.concatenate([[0], 1 + np.random.default_rng(1).permutation(inner), [inner + 1]])
    for _ in range(50):
        new = kicked(order, random)
        require_tour(new, inner + 2)
        # At most three edges are new (each piece stays as it is).
        before = set(zip(order[:-1].tolist(), order[1:].tolist(), strict=True))
        after = set(zip(new[:-1].tolist(), new[1:].tolist(), strict=True))
        assert len(after - before) == 3
