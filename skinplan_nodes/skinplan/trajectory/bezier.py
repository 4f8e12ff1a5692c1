"""Timing by quintic Bézier segments (R6): smooth joint motion, with bounded jerk."""

import numpy as np

from skinplan.errors import InputError, JointsInvalidError
from skinplan.robot.arm import ArmModel
from skinplan.trajectory.bezier_curve import BezierCurve
from skinplan.trajectory.pacing import Course, paces, parabolas
from skinplan.trajectory.sampling import sample_shares
from skinplan.trajectory.timing import Limits, Timed
from skinplan.transforms import Array

_ROUNDS = 24  # of correcting the pace by what the curve really needs ...
_FREE_ROUNDS = 14  # ... of which the first also let unused acceleration be used
_FITS = 1.001  # so little slowing is not worth another round
_GRID = 8  # places in a segment where the scanner's speed is checked
_GRID_MARGIN = 0.995  # so much of the scanner's speed limit is used, for what is between them


def time_bezier(arm: ArmModel, q: Array, limits: Limits, deviation_m: float = 0.0005) -> Timed:
    """Drives a joint path through all its positions from rest to rest, with bounded jerk (R6).

    Args:
        arm: The arm.
        q: Joint positions, no two neighbours equal, shape (k >= 2, 6) [rad].
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
    course, curve, pace = _driven(arm, q, limits)
    segment, share = sample_shares(curve.durations, curve.largest(2), arm.lever_arms(), deviation_m)
    # Along a segment the pace changes evenly from that of its first position to that of its last.
    change = pace[segment + 1] - pace[segment]
    gone = share * (pace[segment] + 0.5 * share * change) / (0.5 * change + pace[segment])
    step = np.diff(course.places)
    positions, velocities = curve.inside(segment, share), curve.inside(segment, share, 1)
    velocities[[0, -1]] = 0.0
    whole = share == 0.0
    positions[whole] = course.positions[segment[whole]]
    positions[-1] = course.positions[-1]
    return Timed(
        times=curve.times[segment] + share * curve.durations[segment],
        positions=positions,
        velocities=velocities,
        path=course.places[segment] + gone * step[segment],
    )


def bezier_curve(arm: ArmModel, q: Array, limits: Limits) -> BezierCurve:
    """Returns the curve that `time_bezier` samples; arguments and errors as there."""
    return _driven(arm, q, limits)[1]


def largest_jerk(timed: Timed) -> float:
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


def _driven(arm: ArmModel, q: Array, limits: Limits) -> tuple[Course, BezierCurve, Array]:
    """The course, the fastest curve found that keeps the limits, and its pace at the knots."""
    course = Course.through(_require_path(arm, q, limits))
    fastest = _fastest(arm, course, limits)
    budget = np.full(len(fastest), float(limits.acceleration))
    best, best_pace, least = None, fastest, np.inf
    for turn in range(_ROUNDS):
        pace = paces(course, fastest, budget)
        curve = _curve(course, pace)
        speed, rate = _use(arm, curve, limits)
        slowing = max(float(speed.max()), float(np.sqrt(rate.max())))
        if slowing * curve.times[-1] < least:
            least = slowing * curve.times[-1]
            best, best_pace = curve.slowed(slowing), pace
        if turn >= _FREE_ROUNDS and slowing < _FITS:
            break
        fastest = fastest / np.maximum(_about_knots(speed), 1.0)
        lowest, power = (0.8, 0.7) if turn < _FREE_ROUNDS else (1.0, 1.0)
        budget = budget / np.clip(_about_knots(rate), lowest, 2.0) ** power
        budget = np.minimum(budget, 1.2 * limits.acceleration)
    assert best is not None  # the first round has made one
    return course, best, best_pace


def _curve(course: Course, pace: Array) -> BezierCurve:
    """The curve of a pace: at rest at both ends, else along the parabolas through neighbours."""
    durations = 2.0 * course.lengths / (pace[:-1] + pace[1:])
    return BezierCurve(durations, course.positions, *parabolas(durations, course.positions))


def _use(arm: ArmModel, curve: BezierCurve, limits: Limits) -> tuple[Array, Array]:
    """How much of the speed limits and of the acceleration limit segments use, each (n,)."""
    speed = (curve.largest(1) / limits.velocity).max(axis=1)
    rate = curve.largest(2).max(axis=1) / limits.acceleration
    if np.isfinite(limits.tcp_speed):
        count = len(curve.durations)
        segment = np.repeat(np.arange(count), _GRID)
        share = np.tile(np.arange(_GRID) / _GRID, count)
        tcp = _tcp_speeds(arm, curve.inside(segment, share), curve.inside(segment, share, 1))
        most = tcp.reshape(count, _GRID)
        ends = np.append(most[1:, 0], 0.0)
        tcp = np.maximum(most.max(axis=1), ends) / (_GRID_MARGIN * limits.tcp_speed)
        speed = np.maximum(speed, tcp)
    return speed, rate


def _about_knots(use: Array) -> Array:
    """The larger use of the two segments at each knot, shape (n,) -> (n + 1,)."""
    return np.maximum(np.append(use, use[-1]), np.append(use[0], use))


def _fastest(arm: ArmModel, course: Course, limits: Limits) -> Array:
    """Largest pace at the knots that joint and scanner speed limits allow, shape (k,) [rad/s]."""
    use = (np.abs(course.tangents) / limits.velocity).max(axis=1)
    if np.isfinite(limits.tcp_speed):
        tcp = _tcp_speeds(arm, course.positions, course.tangents)
        use = np.maximum(use, tcp / (_GRID_MARGIN * limits.tcp_speed))
    # A course that turns back has no tangent at the turn; its neighbours limit the pace there.
    steps = np.diff(course.positions, axis=0) / course.lengths[:, None]
    chord = _about_knots((np.abs(steps) / limits.velocity).max(axis=1))
    return np.asarray(1.0 / np.maximum(use, 0.5 * chord))


def _tcp_speeds(arm: ArmModel, q: Array, velocities: Array) -> Array:
    """Speeds of the scanner's origin, shape (n,) [m/s], by the geometric Jacobian."""
    links = arm.links(q)
    scanner = arm.forward_scanner(q)[:, :3, 3]
    axes = np.einsum("njab,jb->nja", links[:, 1:, :3, :3], arm.axes)
    arms = scanner[:, None] - links[:, 1:, :3, 3]
    return np.asarray(
        np.linalg.norm(np.einsum("nj,nja->na", velocities, np.cross(axes, arms)), axis=1)
    )


def _require_path(arm: ArmModel, q: Array, limits: Limits) -> Array:
    q = arm.require_joints(q)
    if len(q) < 2:
        raise JointsInvalidError(f"a path of at least 2 joint positions is accepted, found {len(q)}")
    same = np.flatnonzero(~np.any(np.diff(q, axis=0), axis=1))
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
