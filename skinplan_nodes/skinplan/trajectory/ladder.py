"""The ladder graph: one layer of joint positions per point, the least-time way through all layers.

Two kinds of edges join neighbouring layers: straight (the scan goes on) and break (stop, transit).
All of them begin as possible, with an estimate of their time; whoever drives the search forbids
those that turn out impossible and solves again, so that only edges on the best way are ever checked
(lazy evaluation).
"""

import numpy as np
from numpy.typing import NDArray

from skinplan.transforms import Array

STRAIGHT = 0
BREAK = 1
_BREAK_S = 1.2  # a stop, a retreat and a start cost about this much more than the motion
_MOTION_WEIGHT = 0.03  # [s/rad], prefers less joint motion among equally fast ways


class Ladder:
    """Layers of joint positions with the costs between them.

    Attributes:
        layers: Joint positions of each layer, shape (s_i, 6) [rad].
    """

    def __init__(
        self,
        layers: list[Array],
        straight_s: list[Array | None],
        velocity: Array,
        acceleration: float,
    ) -> None:
        """Makes the graph.

        Args:
            layers: Joint positions of each layer, shape (s_i, 6) [rad].
            straight_s: For each pair of neighbouring layers the time that the scanner's speed limit
                asks for, inf where a straight move is out of the question, shape (s_i, s_i+1) [s];
                None = no straight edges there.
            velocity: Joint velocity limits, shape (6,) [rad/s].
            acceleration: Joint acceleration limit [rad/s^2].
        """
        self.layers = layers
        self._straight: list[Array] = []
        self._break: list[Array] = []
        for a, b, least in zip(layers, layers[1:], straight_s, strict=False):
            change = np.abs(b[None] - a[:, None])
            motion = _MOTION_WEIGHT * change.sum(axis=2)
            joint = (change / velocity).max(axis=2)
            self._straight.append(
                np.full(motion.shape, np.inf)
                if least is None
                else np.maximum(least, joint) + motion
            )
            self._break.append(_BREAK_S + _rest_to_rest(change, velocity, acceleration) + motion)

    def forbid_straight(self, layer: int, state: int, following: NDArray[np.int64] | int) -> None:
        """Takes straight edges from a state to states of the next layer out."""
        self._straight[layer][state, following] = np.inf

    def forbid_break(self, layer: int, state: int, following: int) -> None:
        """Takes a break edge out."""
        self._break[layer][state, following] = np.inf

    def solve(self) -> tuple[NDArray[np.int64], NDArray[np.int64], float] | int:
        """Finds the least-time way.

        Returns:
            State in each layer, kind of each edge, time [s]; or the number of the first layer that
            can't be reached.
        """
        cost = np.zeros(len(self.layers[0]))
        origin = []
        for layer, (straight, stop) in enumerate(zip(self._straight, self._break, strict=True)):
            total = cost[:, None] + np.minimum(straight, stop)
            best = np.argmin(total, axis=0)
            cost = total[best, np.arange(total.shape[1])]
            origin.append(best)
            if not np.any(np.isfinite(cost)):
                return layer + 1
        states = [int(np.argmin(cost))]
        for best in reversed(origin):
            states.append(int(best[states[-1]]))
        states.reverse()
        kinds = [
            STRAIGHT if self._straight[i][a, b] <= self._break[i][a, b] else BREAK
            for i, (a, b) in enumerate(zip(states, states[1:], strict=False))
        ]
        return np.array(states), np.array(kinds, dtype=np.int64), float(cost.min())


def _rest_to_rest(change: Array, velocity: Array, acceleration: float) -> Array:
    """Time of a joint move from rest to rest, shape (..., 6) [rad] -> (...) [s]."""
    short = 2.0 * np.sqrt(change / acceleration)
    long = change / velocity + velocity / acceleration
    return np.asarray(np.where(change < velocity**2 / acceleration, short, long).max(axis=-1))
