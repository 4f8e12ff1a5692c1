"""Timing by quintic Bézier segments (R6): smooth joint motion, with bounded jerk."""

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import InputError, JointsInvalidError
from skinplan.robot.arm import ArmModel
from skinplan.trajectory.bezier_curve import BezierCurve
from skinplan.trajectory.model import Segment
from skinplan.trajectory.pacing import Course, paces, parabolas
from skinplan.trajectory.sampling import line_use, sample_counts, sample_shares, tcp_speeds
from skinplan.trajectory.timing import Limits, Timed
from skinplan.transforms import Array

_ROUNDS = 24  # of correcting the pace by what the curve really needs ...
_FREE_ROUNDS = 14  # ... of which the first also let unused acceleration be used
_FITS = 1.001  # so little slowing is not worth another round
_DENSER_ROUNDS = 6  # of halving the samples' distance where lines between them are too fast
_SAME_RAD = 1e-12  # neighbours no farther apart are equal
_GRID_S = 0.006  # the scanner's speed is checked so often ...
_GRID_MARGIN = 0.995  # ... and so much of its limit is used, for what is between


def time_bezier(arm: ArmModel, q: Array, limits: Limits, deviation_m: float = 0.0005) -> Timed:
    """Drives a joint path through all its positions from rest to rest, with bounded jerk (R6).

    Args:
        arm: The arm.
        q: Joint positions, no two neighbours equal to 1e-12, shape (k >= 2, 6) [rad].
        limits: What must not be exceeded.
        deviation_m: Between the samples, joints interpolated linearly, the scanner is at most so
            far from where the curve has it [m].

    Returns:
        The motion, with a sample at each of the positions.

    Raises:
        JointsInvalidError: Shape, a value that is not finite, or equal neighbours.
        InputError: A limit or a deviation that is not above zero.
    """
    if not deviation_m > 0.0:
        raise InputError(f"a deviation above 0 m is accepted, found {deviation_m}")
    course, curve = _driven(arm, q, limits)
    counts = sample_counts(curve.durations, curve.largest(2), arm.lever_arms(), deviation_m)
    for _ in range(_DENSER_ROUNDS):
        timed = _sampled(course, curve, counts)
        use = line_use(arm, timed.times, timed.positions, limits.tcp_speed)
        if use.max() <= 1.0:
            return timed
        # Where the scanner turns about itself, lines may move it faster than the curve does.
        segment = sample_shares(counts)[0][:-1]
        counts[np.unique(segment[use > 1.0])] *= 2
    return _sampled(course, curve.slowed(float(use.max())), counts)


def _sampled(course: Course, curve: BezierCurve, counts: NDArray[np.int64]) -> Timed:
    """The curve with so many intervals between samples in each segment."""
    segment, share = sample_shares(counts)
    positions, velocities = curve.inside(segment, share), curve.inside(segment, share, 1)
    velocities[[0, -1]] = 0.0
    whole = share == 0.0
    positions[whole] = course.positions[segment[whole]]
    positions[-1] = course.positions[-1]
    return Timed(
        times=curve.times[segment] + share * curve.durations[segment],
        positions=positions,
        velocities=velocities,
        path=_places(course, curve.durations, segment, share),
    )


def bezier_curve(arm: ArmModel, q: Array, limits: Limits) -> BezierCurve:
    """Returns the curve that `time_bezier` samples; arguments and errors as there."""
    return _driven(arm, q, limits)[1]


def _places(course: Course, durations: Array, segment: NDArray[np.int64], share: Array) -> Array:
    """Where on the path given shares of segments lie, shape (m,): a rising cubic in each."""
    step = np.diff(course.places)
    rates = step / durations
    slopes = np.zeros(len(durations) + 1)
    slopes[1:-1] = (rates[:-1] * durations[1:] + rates[1:] * durations[:-1]) / (
        durations[:-1] + durations[1:]
    )
    slopes[1:-1] = np.minimum(slopes[1:-1], 3.0 * np.minimum(rates[:-1], rates[1:]))
    start, end = (slopes[:-1] / rates)[segment], (slopes[1:] / rates)[segment]
    u, left = share, 1.0 - share
    gone = u * left**2 * start + u**2 * (3.0 - 2.0 * u) - u**2 * left * end
    return np.asarray(course.places[segment] + gone * step[segment])


def largest_jerk(timed: Timed | Segment) -> float:
    """Returns the largest jerk of a joint that the samples of a motion show [rad/s^3].

    It is taken from second divided differences of the velocities, which are means of the jerk: a
    lower bound of the largest one. Where the acceleration jumps, as by TOPP-RA, it grows with the
    number of samples.
    """
    step = np.diff(timed.times)[:, None]
    if len(step) < 2:
        return 0.0
    rate = np.diff(timed.velocities, axis=0) / step
    return float(np.abs(2.0 * np.diff(rate, axis=0) / (step[1:] + step[:-1])).max())


def _driven(arm: ArmModel, q: Array, limits: Limits) -> tuple[Course, BezierCurve]:
    """The course, and the fastest curve found that keeps the limits."""
    course = Course.through(_require_path(arm, q, limits))
    fastest = _fastest(arm, course, limits)
    budget = np.full(len(course.positions), float(limits.acceleration))
    best, least = None, np.inf
    for turn in range(_ROUNDS):
        free = turn < _FREE_ROUNDS
        durations = course.lengths / paces(course, fastest, budget)
        # At rest at both ends, else along the parabolas through neighbours.
        curve = BezierCurve(durations, course.positions, *parabolas(durations, course.positions))
        speed, rate = _use(arm, curve, limits, np.inf if free else _GRID_S)
        slowing = max(float(speed.max()), float(np.sqrt(rate.max())))
        if not free and slowing * curve.times[-1] < least:
            best, least = curve.slowed(slowing), slowing * curve.times[-1]
        if not free and slowing < _FITS:
            break
        fastest = fastest / np.maximum(speed, 1.0)
        lowest, power = (0.8, 0.7) if free else (1.0, 1.0)
        budget = budget / np.clip(_about_knots(rate), lowest, 2.0) ** power
        budget = np.minimum(budget, 1.2 * limits.acceleration)
    assert best is not None  # one of the later rounds has made it
    return course, best


def _use(arm: ArmModel, curve: BezierCurve, limits: Limits, grid_s: float) -> tuple[Array, Array]:
    """How much of the speed limits and of the acceleration limit segments use, each (n,)."""
    speed = (curve.largest(1) / limits.velocity).max(axis=1)
    rate = curve.largest(2).max(axis=1) / limits.acceleration
    if np.isfinite(limits.tcp_speed):
        counts = np.maximum(2, np.ceil(curve.durations / grid_s)).astype(np.int64)
        first = np.cumsum(counts) - counts
        segment = np.repeat(np.arange(len(counts), dtype=np.int64), counts)
        share = (np.arange(len(segment)) - first[segment]) / counts[segment]
        tcp = tcp_speeds(arm, curve.inside(segment, share), curve.inside(segment, share, 1))
        ends = np.append(tcp[first[1:]], 0.0)
        most = np.maximum(np.maximum.reduceat(tcp, first), ends)
        speed = np.maximum(speed, most / (_GRID_MARGIN * limits.tcp_speed))
    return speed, rate


def _about_knots(use: Array) -> Array:
    """The larger use of the two segments at each knot, shape (n,) -> (n + 1,)."""
    return np.maximum(np.append(use, use[-1]), np.append(use[0], use))


def _fastest(arm: ArmModel, course: Course, limits: Limits) -> Array:
    """Largest pace of the steps that joint and scanner speed limits allow, shape (n,) [rad/s]."""
    use = (np.abs(course.directions) / limits.velocity).max(axis=1)
    if np.isfinite(limits.tcp_speed):
        middle = 0.5 * (course.positions[:-1] + course.positions[1:])
        tcp = tcp_speeds(arm, middle, course.directions)
        use = np.maximum(use, tcp / (_GRID_MARGIN * limits.tcp_speed))
    return np.asarray(1.0 / use)


def _require_path(arm: ArmModel, q: Array, limits: Limits) -> Array:
    q = arm.require_joints(q)
    if len(q) < 2:
        raise JointsInvalidError(
            f"a path of at least 2 joint positions is accepted, found {len(q)}"
        )
    same = np.flatnonzero(np.abs(np.diff(q, axis=0)).max(axis=1) < _SAME_RAD)
    if len(same):
        raise JointsInvalidError(
            f"a path without equal neighbours is accepted, found positions {same[0]} and "
            f"{same[0] + 1} equal"
        )
    values = np.append(limits.velocity, [limits.acceleration, limits.tcp_speed])
    if not np.all(values > 0.0) or not np.all(np.isfinite(values[:-1])):
        raise InputError(
            "limits above zero are accepted, finite but for the scanner's speed; found "
            f"velocity {np.asarray(limits.velocity).tolist()}, acceleration {limits.acceleration}, "
            f"scanner's speed {limits.tcp_speed}"
        )
    return q
