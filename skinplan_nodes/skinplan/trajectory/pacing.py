"""How fast a joint path may be gone along: the pace at its positions, as fast as limits allow.

The path is parametrised by its length in joint space. At each position it has the tangent and the
bend of the parabola through that position and its neighbours, so that joint velocity and
acceleration are ``tangent * pace`` and ``bend * pace^2 + tangent * (change of pace)``. One pass
forward and one backward make the pace as large as the accelerations allow.
"""

from dataclasses import dataclass

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
        tangents: Change of the joints along the path, shape (k, 6).
        bends: Change of the tangent along the path, shape (k, 6) [1/rad].
    """

    positions: Array
    places: Array
    lengths: Array
    tangents: Array
    bends: Array

    @classmethod
    def through(cls, q: Array) -> "Course":
        """Lays a course through joint positions, no two neighbours equal, shape (k >= 2, 6)."""
        places = _graded(np.linalg.norm(np.diff(q, axis=0), axis=1))
        step = np.minimum(places.astype(int), len(q) - 2)
        share = (places - step)[:, None]
        positions = q[step] + share * (q[step + 1] - q[step])
        positions[-1] = q[-1]
        lengths = np.linalg.norm(np.diff(positions, axis=0), axis=1)
        tangents, bends = parabolas(lengths, positions)
        tangents[[0, -1]] = (np.diff(positions, axis=0) / lengths[:, None])[[0, -1]]
        return cls(positions, places, lengths, tangents, bends)


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
    """Returns the pace at each position, zero at both ends, shape (k,) [rad/s].

    Args:
        course: The path.
        fastest: Largest pace, shape (k,) [rad/s].
        acceleration: Limit of each joint's acceleration at each position, shape (k,) [rad/s^2].
    """
    bend = np.abs(course.bends).max(axis=1)
    square = np.minimum(fastest**2, acceleration / np.maximum(bend, 1e-12))
    square[[0, -1]] = 0.0
    forward = _pass(course, square, acceleration, 1.0)
    backward = _pass(course, forward, acceleration, -1.0)
    return np.sqrt(backward)


def _pass(course: Course, square: Array, acceleration: Array, sense: float) -> Array:
    """Limits the growth of the squared pace, forward or (sense -1) backward."""
    turn = slice(None, None, int(sense))
    tangents = course.tangents
    size = np.abs(tangents)
    # Along the path (sense 1) a joint may speed up by what its limit leaves beside the bend.
    bends = np.where(tangents < 0.0, -course.bends, course.bends) * sense
    rows = zip(
        (2.0 * course.lengths[turn]).tolist(),
        np.where(size > 1e-9, size, 1e-9)[turn].tolist(),
        (sense * bends)[turn].tolist(),
        acceleration[turn].tolist(),
        strict=False,
    )
    result = square[turn].tolist()
    for number, (reach, sizes, bent, limit) in enumerate(rows):
        here = result[number]
        change = min((limit - b * here) / s for s, b in zip(sizes, bent, strict=True))
        result[number + 1] = min(result[number + 1], here + reach * max(change, 0.0))
    return np.array(result[turn])


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
