from itertools import product

import numpy as np
import pytest

from skinplan.trajectory.ladder import BREAK, STRAIGHT, Ladder

VELOCITY = np.full(6, np.pi)


def random_ladder(seed, layers=4, states=3):
    rng = np.random.default_rng(seed)
    nodes = [rng.uniform(-2, 2, (states, 6)) for _ in range(layers)]
    least = [rng.uniform(0, 3, (states, states)) for _ in range(layers - 1)]
    for matrix in least:
        matrix[rng.random(matrix.shape) < 0.4] = np.inf
    ladder = Ladder(nodes, [None, *least[1:]], VELOCITY, 5.0)
    for layer, a, b in product(range(layers - 1), range(states), range(states)):
        if rng.random() < 0.5:
            ladder.forbid_break(layer, a, b)
    return ladder


def brute_force(ladder):
    best = np.inf
    for states in product(*(range(len(layer)) for layer in ladder.layers)):
        cost = 0.0
        for i, (a, b) in enumerate(zip(states, states[1:], strict=False)):
            cost += min(ladder._straight[i][a, b], ladder._break[i][a, b])
        best = min(best, cost)
    return best


@pytest.mark.parametrize("seed", range(40))
def test_the_best_way_equals_brute_force(seed):
    ladder = random_ladder(seed)
    found = ladder.solve()
    best = brute_force(ladder)
    if isinstance(found, int):
        assert not np.isfinite(best)
    else:
        states, kinds, seconds = found
        assert seconds == pytest.approx(best)
        cost = [
            (ladder._straight if kind == STRAIGHT else ladder._break)[i][states[i], states[i + 1]]
            for i, kind in enumerate(kinds)
        ]
        assert sum(cost) == pytest.approx(best)


def test_a_slow_straight_way_is_taken_before_a_stop_and_forbidden_edges_are_not():
    nodes = [np.zeros((1, 6)), np.array([[0.0] * 6, [0.1] * 6])]
    ladder = Ladder(nodes, [np.array([[0.5, 0.6]])], VELOCITY, 5.0)
    states, kinds, _ = ladder.solve()
    assert states.tolist() == [0, 0] and kinds.tolist() == [STRAIGHT]
    ladder.forbid_straight(0, 0, 0)
    states, kinds, _ = ladder.solve()
    assert states.tolist() == [0, 1] and kinds.tolist() == [STRAIGHT]
    ladder.forbid_straight(0, 0, 1)
    assert ladder.solve()[1].tolist() == [BREAK]
    ladder.forbid_break(0, 0, 0)
    ladder.forbid_break(0, 0, 1)
    assert ladder.solve() == 1  # the layer that nothing leads to


def test_greedy_would_be_wrong():
    """The nearest state of the second layer leads nowhere good."""
    a, near, far = [0.0] * 6, [0.1] * 6, [0.5] * 6
    nodes = [np.array([a]), np.array([near, far]), np.array([far])]
    ladder = Ladder(nodes, [np.zeros((1, 2)), np.array([[np.inf], [0.1]])], VELOCITY, 5.0)
    assert ladder.solve()[0].tolist() == [0, 1, 0]
