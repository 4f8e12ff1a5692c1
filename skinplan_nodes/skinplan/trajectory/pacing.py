"""How fast a joint path may be gone along: the pace of its steps, as fast as limits allow.

The path is parametrised by its length in joint space; a step's pace is its length by its duration.
At each position the motion has the velocity and the acceleration of the parabola through that
position and its neighbours in time: with the mean velocities m of the steps before and behind and
their durations h the acceleration is ``2 (m' - m) / (h + h')``. One pass forward and one backward
make the paces as large as the accelerations allow.
"""

from dataclasses import dataclass
from math import sqrt

import numpy as np

from skinplan.transforms import Array

_GROWTH = 0.9  # neighbouring steps differ in length by e to this much at most
_END_SHARE = 0.1  # the first and the last step are divided as if a step so short preceded them


@dataclass(frozen=True, eq=False)
class Course:
    """A joint path, with further positions on its chords where steps of very unequal length meet.

    Attributes:
        positions: Joint positions, shape (k, 6) [rad].
        places: Where they are on the path given: number of the step plus share of it, shape (k,).
        lengths: Of the steps in joint space, shape (k - 1,) [rad].
        directions: Of the steps, unit vectors, shape (k - 1, 6).
    """

    positions: Array
    places: Array
    lengths: Array
    directions: Array

    @classmethod
    def through(cls, q: Array) -> "Course":
        """Lays a course through joint positions, no two neighbours equal, shape (k >= 2, 6)."""
        places = _graded(np.linalg.norm(np.diff(q, axis=0), axis=1))
        step = np.minimum(places.astype(int), len(q) - 2)
        share = (places - step)[:, None]
        positions = q[step] + share * (q[step + 1] - q[step])
        positions[-1] = q[-1]
        steps = np.diff(positions, axis=0)
        lengths = np.linalg.norm(steps, axis=1)
        return cls(positions, places, lengths, steps / lengths[:, None])


def parabolas(steps: Array, values: Array) -> tuple[Array, Array]:
    """First and second derivative of the parabola through each value and its two neighbours.

    Args:
        steps: Between the values, shape (k - 1,).
        values: shape (k, 6).

    Returns:
        Derivatives, each of shape (k, 6); zero at both ends.
    """
    slopes = np.diff(values, axis=0) / steps[:, None]
    before, behind = steps[:-1, None], steps[1:, None]
    first, second = np.zeros_like(values), np.zeros_like(values)
    first[1:-1] = (slopes[:-1] * behind + slopes[1:] * before) / (before + behind)
    second[1:-1] = 2.0 * np.diff(slopes, axis=0) / (before + behind)
    return first, second


def paces(course: Course, fastest: Array, acceleration: Array) -> Array:
    """Returns the pace of each step, from rest to rest, shape (k - 1,) [rad/s].

    Args:
        course: The path.
        fastest: Largest pace of each step, shape (k - 1,) [rad/s].
        acceleration: Limit of each joint's acceleration at each position, shape (k,) [rad/s^2].
    """
    lengths, directions = course.lengths, course.directions
    # Where the path bends, steps of one pace: |change of direction| pace = acceleration * time.
    bend = np.maximum(np.abs(np.diff(directions, axis=0)).max(axis=1), 1e-12)
    turn = np.sqrt(0.5 * acceleration[1:-1] * (lengths[:-1] + lengths[1:]) / bend)
    # At the ends, from rest: half the acceleration for the whole step.
    size = np.abs(directions).max(axis=1)
    ends = np.sqrt(0.5 * acceleration[[0, -1]] * lengths[[0, -1]] / size[[0, -1]])
    most = np.minimum(fastest, np.minimum(np.append(ends[0], turn), np.append(turn, ends[1])))
    forward = _pass(lengths, directions, most, acceleration[1:-1])
    return _pass(lengths[::-1], directions[::-1], forward[::-1], acceleration[-2:0:-1])[::-1]


def _pass(lengths: Array, directions: Array, most: Array, acceleration: Array) -> Array:
    """Limits the growth of the pace from step to step.

    For a joint that moves by ``u`` per length, its direction reckoned positive, the next pace x
    solves ``u x - m = a / 2 (h + length / x)``: a quadratic equation.
    """
    sign = np.where(directions[1:] < 0.0, -1.0, 1.0)
    rows = zip(
        (sign * directions[:-1]).tolist(),
        np.maximum(np.abs(directions[1:]), 1e-9).tolist(),
        (0.5 * acceleration * lengths[:-1]).tolist(),
        (0.5 * acceleration * lengths[1:]).tolist(),
        strict=True,
    )
    result = most.tolist()
    pace = result[0]
    for number, (before, behind, held, gained) in enumerate(rows, 1):
        gain = held / pace
        for b, u in zip(before, behind, strict=True):
            half = 0.5 * (b * pace + gain)
            # The positive root, in the form that keeps its digits for a negative half.
            root = sqrt(half * half + u * gained)
            most_here = (half + root) / u if half > 0.0 else gained / (root - half)
            if most_here < result[number]:
                result[number] = most_here
        pace = result[number]
    return np.array(result)


def _graded(lengths: Array) -> Array:
    """Places of all positions, with further ones where a step has a much shorter neighbour."""
    before = np.concatenate([[_END_SHARE * lengths[0]], lengths[:-1]])
    behind = np.concatenate([lengths[1:], [_END_SHARE * lengths[-1]]])
    # Steps as long as the distance from the shorter neighbour plus its length: the integral of
    # 1 / length along the step says how many that are.
    middle = np.clip(0.5 * (lengths + behind - before), 0.0, lengths)
    rising = np.log1p(middle / before)
    total = rising + np.log1p((lengths - middle) / behind)
    counts = np.maximum(1, np.ceil(total / _GROWTH)).astype(np.int64)
    owner = np.repeat(np.arange(len(counts)), counts)
    share = (np.arange(len(owner)) - (np.cumsum(counts) - counts)[owner]) / counts[owner]
    reached = share * total[owner]
    up = before[owner] * np.expm1(reached)
    down = lengths[owner] - behind[owner] * np.expm1(total[owner] - reached)
    inside = np.where(reached <= rising[owner], up, down) / lengths[owner]
    return np.append(owner + np.where(share == 0.0, 0.0, inside), float(len(lengths)))
