"""Joint motion made of quintic Bézier segments (R6, eq (2)), with its exact extrema.

Each segment has six control points (time, joint angle). Their times are spaced evenly, so that the
curve's parameter is the segment's share of time, and its derivatives are polynomials in time.
"""

from dataclasses import dataclass
from functools import cached_property
from math import comb

import numpy as np
from numpy.typing import NDArray

from skinplan.transforms import Array

DEGREE = 5
# A piece on which a cubic rises or falls is halved so often: the root is exact to 1e-8 then, the
# value of an extremum there, which is flat, to 1e-15.
_HALVINGS = 26


@dataclass(frozen=True, eq=False)
class BezierCurve:
    """Quintic Bézier segments from knot to knot, joined at position, velocity and acceleration.

    Reading note: R asks that the control points before and behind a join are on one line with it.
    In the plane of time and angle that makes position and velocity continuous, as they also are
    spaced like the durations. The acceleration is continuous because the second ones on either
    side belong to one parabola. (On the same line, as a second reading would have them, the
    acceleration would vanish at every position passed: on the ways of the sample parts that doubles
    the mean jerk and takes 1 to 4 % longer.)

    Attributes:
        durations: Of the segments, shape (n,) [s].
        positions: Joint positions at the knots, shape (n + 1, 6) [rad].
        velocities: At the knots, shape (n + 1, 6) [rad/s].
        accelerations: At the knots, shape (n + 1, 6) [rad/s^2].
    """

    durations: Array
    positions: Array
    velocities: Array
    accelerations: Array

    @cached_property
    def times(self) -> Array:
        """Times of the knots, from 0, shape (n + 1,) [s]."""
        return np.concatenate([[0.0], np.cumsum(self.durations)])

    @property
    def control_times(self) -> Array:
        """Times of the control points, shape (n, 6) [s]."""
        shares = np.arange(DEGREE + 1) / DEGREE
        return np.asarray(self.times[:-1, None] + shares * self.durations[:, None])

    @property
    def control_angles(self) -> Array:
        """Joint angles of the control points, shape (n, 6 points, 6 joints) [rad]."""
        return np.asarray(self.positions[:-1, None] + self._offsets)

    @cached_property
    def _offsets(self) -> Array:
        """Control angles from each segment's first one: small steps keep their digits so."""
        h = self.durations[:, None]
        step = np.diff(self.positions, axis=0)
        start, end = self.velocities[:-1] * h, self.velocities[1:] * h
        bend, unbend = self.accelerations[:-1] * h**2, self.accelerations[1:] * h**2
        return np.stack(
            [
                np.zeros_like(step),
                start / 5.0,
                0.4 * start + bend / 20.0,
                step - 0.4 * end + unbend / 20.0,
                step - end / 5.0,
                step,
            ],
            axis=1,
        )

    def control_values(self, order: int) -> Array:
        """Returns Bernstein coefficients of a derivative by time.

        Args:
            order: 1 velocity, 2 acceleration, 3 jerk.

        Returns:
            Coefficients, shape (n, 6 - order, 6 joints) [rad/s^order]; the derivative never leaves
            the range of a segment's coefficients.
        """
        h = self.durations[:, None]
        v, a = self.velocities, self.accelerations
        pace = 5.0 * np.diff(self.positions, axis=0) / h - 2.0 * (v[:-1] + v[1:])
        middle = pace + 0.25 * h * np.diff(a, axis=0)
        # Written out, not as differences of the angles: those of a tiny step have no digits left.
        if order == 1:
            start, end = v[:-1] + 0.25 * h * a[:-1], v[1:] - 0.25 * h * a[1:]
            return np.stack([v[:-1], start, middle, end, v[1:]], axis=1)
        start = 4.0 * (middle - v[:-1]) / h - a[:-1]
        end = 4.0 * (v[1:] - middle) / h - a[1:]
        values = np.stack([a[:-1], start, end, a[1:]], axis=1)
        return values if order == 2 else np.asarray(3.0 * np.diff(values, axis=1) / h[:, None])

    def at(self, times: Array, order: int = 0) -> Array:
        """Evaluates the curve or a derivative.

        Args:
            times: From the start, shape (m,) [s].
            order: 0 position, 1 velocity, 2 acceleration, 3 jerk.

        Returns:
            shape (m, 6) [rad/s^order].
        """
        last = len(self.durations) - 1
        before = np.searchsorted(self.times, times, side="right") - 1
        segment = np.clip(before, 0, last).astype(np.int64)
        share = np.clip((times - self.times[segment]) / self.durations[segment], 0.0, 1.0)
        return self.inside(segment, share, order)

    def inside(self, segment: NDArray[np.int64], share: Array, order: int = 0) -> Array:
        """Evaluates segments at shares of their duration.

        Args:
            segment: Numbers of segments, shape (m,).
            share: In [0, 1], shape (m,).
            order: As `at`.

        Returns:
            shape (m, 6) [rad/s^order].
        """
        values = self._offsets if order == 0 else self.control_values(order)
        weights = _bernstein(values.shape[1] - 1, share)
        result = np.einsum("mk,mkj->mj", weights, values[segment])
        return np.asarray(self.positions[segment] + result if order == 0 else result)

    def largest(self, order: int) -> Array:
        """Returns the largest absolute value of a derivative on each segment, shape (n, 6).

        Exact: the polynomial is evaluated at its ends and at the roots of its derivative.

        Args:
            order: 1 velocity [rad/s], 2 acceleration [rad/s^2], 3 jerk [rad/s^3].
        """
        values = np.moveaxis(self.control_values(order), 1, 2)
        turning = _roots(np.diff(values, axis=-1))
        inner = np.abs(_polynomial(values[..., None, :], turning)).max(axis=-1)
        return np.asarray(np.maximum(inner, np.abs(values[..., [0, -1]]).max(axis=-1)))

    @property
    def largest_jerk(self) -> float:
        """Largest jerk of a joint [rad/s^3]: it jumps at the joins, but is bounded."""
        return float(self.largest(3).max())

    def chord_deviation(self) -> Array:
        """Returns how far each segment can be from the straight line between its knots at most.

        A Bézier curve lies in the convex hull of its control points, and the distance from a line
        is largest at a corner of a hull. At a knot whose velocity and acceleration are those of the
        parabola through it and its neighbours the second control point is 0.15 |a| h^2 from where
        an even motion along the chord would be, the first one 0.1 |a| h^2: so no segment deviates
        by more than 0.15 h^2 max |a|.

        Returns:
            Distances in joint space, shape (n,) [rad].
        """
        step = np.diff(self.positions, axis=0)
        share = (
            np.einsum("nkj,nj->nk", self._offsets, step)
            / np.einsum("nj,nj->n", step, step)[:, None]
        )
        nearest = np.clip(share, 0.0, 1.0)[:, :, None] * step[:, None]
        return np.asarray(np.linalg.norm(self._offsets - nearest, axis=2).max(axis=1))

    def slowed(self, factor: float) -> "BezierCurve":
        """Returns the same curve driven so many times slower."""
        return BezierCurve(
            self.durations * factor,
            self.positions,
            self.velocities / factor,
            self.accelerations / factor**2,
        )


def _bernstein(degree: int, share: Array) -> Array:
    """Bernstein polynomials, shape (m, degree + 1)."""
    return np.stack(
        [comb(degree, k) * share**k * (1.0 - share) ** (degree - k) for k in range(degree + 1)],
        axis=-1,
    )


def _polynomial(values: Array, share: Array) -> Array:
    """Polynomials of Bernstein coefficients, (..., d + 1), at shares, (...)."""
    return np.asarray((_bernstein(values.shape[-1] - 1, share) * values).sum(axis=-1))


def _roots(values: Array) -> Array:
    """Roots in (0, 1) of polynomials of degree d = 1, 2 or 3; where there is none, 0 or 1 stands.

    Args:
        values: Bernstein coefficients, shape (..., d + 1).

    Returns:
        shape (..., d).
    """
    degree = values.shape[-1] - 1
    with np.errstate(divide="ignore", invalid="ignore"):
        if degree == 1:
            roots = (values[..., 0] / (values[..., 0] - values[..., 1]))[..., None]
        elif degree == 2:
            roots = _quadratic_roots(values)
        else:
            return _cubic_roots(values)
    return np.clip(np.nan_to_num(roots, nan=0.0, posinf=0.0, neginf=0.0), 0.0, 1.0)


def _quadratic_roots(values: Array) -> Array:
    first, middle, last = values[..., 0], values[..., 1], values[..., 2]
    square, half = first - 2.0 * middle + last, middle - first
    root = np.sqrt(half**2 - square * first)
    far = -(half + np.where(half < 0.0, -root, root))
    return np.stack([far / square, first / far], axis=-1)


def _cubic_roots(values: Array) -> Array:
    """Halves the pieces between turning points, on each of which a cubic only rises or falls."""
    turning = np.sort(_roots(np.diff(values, axis=-1)), axis=-1)
    ends = np.zeros((*turning.shape[:-1], 1))
    low = np.concatenate([ends, turning], axis=-1)
    high = np.concatenate([turning, ends + 1.0], axis=-1)
    first, second, third, last = (values[..., None, k] for k in range(4))
    slope, bend = 3.0 * (second - first), 3.0 * (first - 2.0 * second + third)
    twist = last - first + 3.0 * (second - third)

    def cubic(share: Array) -> Array:
        return ((twist * share + bend) * share + slope) * share + first

    rises = cubic(high) > cubic(low)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        beyond = (cubic(middle) > 0.0) == rises
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    return np.asarray(0.5 * (low + high))
