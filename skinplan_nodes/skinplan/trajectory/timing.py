"""Timing by joint velocity, joint acceleration and scanner speed limits (TOPP-RA)."""

import logging
from dataclasses import dataclass

import numpy as np
import toppra
from numpy.typing import NDArray
from toppra.algorithm import TOPPRA
from toppra.constraint import DiscretizationType, JointAccelerationConstraint
from toppra.constraint.linear_constraint import LinearConstraint

from skinplan.robot.arm import ArmModel
from skinplan.trajectory.sampling import cubic_use, line_use
from skinplan.transforms import Array

SAMPLE_S = 0.04  # samples are never farther apart ...
SAMPLE_M = 0.00045  # ... and the middles of lines between them are so near to the motion
SPLINE_M = (
    0.0015  # a path's spline keeps the scanner so near to the straight ways between positions
)
SPLINE_RAD = 0.0087  # ... and its view axis, half a degree
_GRADE_ROUNDS = 8  # of adding positions where it does not
_CHECKED = (0.25, 0.5, 0.75)  # shares of a step at which that is looked at
_DENSER_ROUNDS = 6
_SHORTEST_S = 0.004
DWELL_S = 0.2  # time that the scanner rests at a point that no straight move leads to or from
_GRID_PER_STEP = 4
_MARGIN = 0.98  # limits hold at grid points; this much of them is used, for what happens in between
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Limits:
    """Limits of a motion.

    Attributes:
        velocity: Joint velocities, shape (6,) [rad/s].
        acceleration: Joint accelerations [rad/s^2].
        tcp_speed: Speed of the scanner's origin [m/s]; inf = none.
    """

    velocity: Array
    acceleration: float
    tcp_speed: float


@dataclass(frozen=True, eq=False)
class Timed:
    """A timed motion.

    Attributes:
        times: Strictly rising from 0, shape (t,) [s].
        positions: Joint positions, shape (t, 6) [rad].
        velocities: Joint velocities, shape (t, 6) [rad/s].
        path: Where on the joint path given each sample lies: number of the step plus share of it,
            shape (t,).
    """

    times: Array
    positions: Array
    velocities: Array
    path: Array


def rest(q: Array) -> Timed:
    """Rests at joint positions, shape (6,) [rad], for `DWELL_S`."""
    return Timed(np.array([0.0, DWELL_S]), np.tile(q, (2, 1)), np.zeros((2, 6)), np.zeros(2))


def time_line(start: Array, end: Array, limits: Limits) -> Timed:
    """Drives a straight joint-space line from rest to rest, by a trapezoid of speed."""
    change = end - start
    size = np.abs(change)
    speed = _MARGIN * float(np.min(limits.velocity[size > 0] / size[size > 0]))
    rate = _MARGIN * limits.acceleration / float(size.max())
    ramp = min(speed / rate, np.sqrt(1.0 / rate))
    top = rate * ramp
    duration = ramp + 1.0 / top
    times = _samples(duration)
    share = np.where(times < ramp, 0.5 * rate * times**2, top * (times - 0.5 * ramp))
    late = times > duration - ramp
    share[late] = 1.0 - 0.5 * rate * (duration - times[late]) ** 2
    pace = np.clip(np.minimum(rate * times, rate * (duration - times)), 0.0, top)
    share[0], share[-1] = 0.0, 1.0
    return Timed(times, start + share[:, None] * change, pace[:, None] * change, share)


def time_path(arm: ArmModel, q: Array, limits: Limits) -> Timed:
    """Drives a joint path through all its positions from rest to rest as fast as the limits allow.

    Args:
        arm: The arm.
        q: Joint positions, densely spaced, no two neighbours equal, shape (k >= 2, 6) [rad].
        limits: What must not be exceeded.
    """
    q, given = _graded(arm, q)
    knots = np.concatenate([[0.0], np.cumsum(_step_lengths(arm, q))])
    spline = toppra.SplineInterpolator(knots, q, bc_type="natural")
    shares = np.arange(_GRID_PER_STEP) / _GRID_PER_STEP
    grid = np.append((knots[:-1, None] + shares * np.diff(knots)[:, None]).ravel(), knots[-1])
    acceleration = JointAccelerationConstraint(
        np.full(6, _MARGIN * limits.acceleration),
        discretization_scheme=DiscretizationType.Interpolation,
    )
    solver = TOPPRA(
        [_SpeedLimit(arm, limits), acceleration], spline, gridpoints=grid, solver_wrapper="seidel"
    )
    solver.compute_parameterization(0.0, 0.0)
    paces = solver.problem_data.sd_vec
    if paces is None or not np.all(np.isfinite(paces)) or np.any(paces[:-1] + paces[1:] <= 0.0):
        _LOG.warning(
            "TOPP-RA found no timing for a path of %d positions; it is driven slowly instead",
            len(q),
        )
        paces = _slow_paces(
            spline, grid, limits, _fastest_pace(arm, spline(grid), spline(grid, 1), limits)
        )
    timed = _sampled_motion(arm, spline, grid, paces, limits.tcp_speed)
    stretch = _excess(arm, timed, limits)
    steps = np.interp(timed.path, knots[given], np.arange(len(given)))
    return Timed(stretch * timed.times, timed.positions, timed.velocities / stretch, steps)


def _graded(arm: ArmModel, q: Array) -> tuple[Array, NDArray[np.int64]]:
    """Adds positions on straight joint motion where a spline would leave it too far.

    Returns:
        Joint positions, shape (n, 6) [rad], and which of them are the given ones, shape (k,).
    """
    steps = np.arange(len(q), dtype=float)  # of the given ones, and shares of them
    given = q
    for _ in range(_GRADE_ROUNDS):
        knots = np.concatenate([[0.0], np.cumsum(_step_lengths(arm, q))])
        spline = toppra.SplineInterpolator(knots, q, bc_type="natural")
        ends = arm.forward_scanner(q)
        off = np.zeros(len(q) - 1)  # in shares of what is allowed
        for share in _CHECKED:
            there = arm.forward_scanner(spline(knots[:-1] + share * np.diff(knots)))
            gap = _distances(there[:, :3, 3], ends[:-1, :3, 3], ends[1:, :3, 3])
            turn = _distances(there[:, :3, 0], ends[:-1, :3, 0], ends[1:, :3, 0])
            np.maximum(off, np.maximum(gap / SPLINE_M, turn / SPLINE_RAD), out=off)
        wide = np.flatnonzero(off > 1.0)
        if not len(wide):
            break
        # The swing comes from the corners at the ends of a step: both neighbours get shorter, too.
        wide = np.unique(np.clip(np.concatenate([wide - 1, wide, wide + 1]), 0, len(off) - 1))
        steps = np.sort(np.concatenate([steps, 0.5 * (steps[wide] + steps[wide + 1])]))
        whole = np.minimum(steps.astype(np.int64), len(given) - 2)
        q = given[whole] + (steps - whole)[:, None] * (given[whole + 1] - given[whole])
    return q, np.searchsorted(steps, np.arange(len(given)))


def _distances(points: Array, start: Array, end: Array) -> Array:
    """Distances of points from the lines between two others, shape (n,)."""
    way = end - start
    length = np.maximum(np.einsum("ni,ni->n", way, way), 1e-18)
    share = np.clip(np.einsum("ni,ni->n", points - start, way) / length, 0.0, 1.0)
    return np.asarray(np.linalg.norm(points - start - share[:, None] * way, axis=1))


def _sampled_motion(
    arm: ArmModel,
    spline: toppra.SplineInterpolator,
    grid: Array,
    paces: Array,
    tcp_speed: float,
) -> Timed:
    """Samples a motion so densely that lines between the samples stay near it, in speed, too.

    ``path`` of the result is the place on the grid.
    """
    times = _samples(float(_grid_times(grid, paces)[-1]))
    for _ in range(_DENSER_ROUNDS + 1):
        places, speeds = _at_times(grid, paces, times)
        positions = spline(places)
        middle = 0.5 * (times[1:] + times[:-1])
        there = arm.forward_scanner(spline(_at_times(grid, paces, middle)[0]))[:, :3, 3]
        lines = arm.forward_scanner(0.5 * (positions[1:] + positions[:-1]))[:, :3, 3]
        wide = np.linalg.norm(there - lines, axis=1) > SAMPLE_M
        # Where the scanner turns about itself, lines may move it faster than the motion does.
        wide |= line_use(arm, times, positions, tcp_speed) > 1.0
        wide &= np.diff(times) > _SHORTEST_S
        if not wide.any():
            break
        times = np.sort(np.concatenate([times, middle[wide]]))
    velocities = spline(places, 1) * speeds[:, None]
    positions[[0, -1]] = spline(grid[[0, -1]])
    return Timed(times, positions, velocities, places)


def _excess(arm: ArmModel, timed: Timed, limits: Limits) -> float:
    """How much slower a motion has to be for limits to hold between grid points too; 1 = none.

    Samples carry positions and velocities; any motion through both needs an acceleration of at
    least ``2 d + sqrt(4 d^2 + r^2)``, where r is the mean one and d the defect of the trapezoid
    rule per step.
    """
    times, positions, velocities = timed.times, timed.positions, timed.velocities
    steps = np.diff(times)[:, None]
    joint = float((np.abs(velocities) / limits.velocity).max())
    mean = np.diff(positions, axis=0) / steps
    joint = max(joint, float((np.abs(mean) / limits.velocity).max()))
    rate = np.diff(velocities, axis=0) / steps
    defect = np.abs(0.5 * (velocities[1:] + velocities[:-1]) - mean) / steps
    needed = float((2.0 * defect + np.sqrt(4.0 * defect**2 + rate**2)).max())
    fast = float(line_use(arm, times, positions, limits.tcp_speed).max())
    fast = max(fast, float(cubic_use(arm, times, positions, velocities, limits.tcp_speed).max()))
    return max(1.0, joint, float(np.sqrt(needed / limits.acceleration)), fast)


def tcp_length(arm: ArmModel, q: Array) -> float:
    """Returns the length of the scanner's way through joint positions, (k, 6) [rad], [m]."""
    return float(np.linalg.norm(np.diff(arm.forward_scanner(q)[:, :3, 3], axis=0), axis=1).sum())


class _SpeedLimit(LinearConstraint):
    """Limits of joint and scanner speed, as bounds of the squared pace along the path."""

    def __init__(self, arm: ArmModel, limits: Limits) -> None:
        super().__init__()
        self.dof = 6
        self._arm = arm
        self._limits = limits

    def compute_constraint_params(
        self, path: toppra.SplineInterpolator, gridpoints: Array
    ) -> tuple[object, ...]:
        pace = _fastest_pace(self._arm, path(gridpoints), path(gridpoints, 1), self._limits)
        return None, None, None, None, None, None, np.stack([np.zeros(len(pace)), pace**2], axis=1)


def _fastest_pace(arm: ArmModel, q: Array, slopes: Array, limits: Limits) -> Array:
    """Largest speed along the path [1/s] that joint and scanner speed limits allow, shape (n,)."""
    joint = (np.abs(slopes) / limits.velocity).max(axis=1)
    small = 1e-6
    ahead, behind = arm.forward_scanner(q + small * slopes), arm.forward_scanner(q - small * slopes)
    tcp = np.linalg.norm(ahead[:, :3, 3] - behind[:, :3, 3], axis=1) / (2.0 * small)
    return np.asarray(_MARGIN / np.maximum(np.maximum(joint, tcp / limits.tcp_speed), 1e-6))


def _step_lengths(arm: ArmModel, q: Array) -> Array:
    """Parameter steps: joint and scanner motion together, so that neither stands still."""
    joint = np.linalg.norm(np.diff(q, axis=0), axis=1)
    tcp = np.linalg.norm(np.diff(arm.forward_scanner(q)[:, :3, 3], axis=0), axis=1)
    return np.asarray(np.maximum(joint + tcp, 1e-6))


def _grid_times(grid: Array, paces: Array) -> Array:
    """When the grid points are passed, with constant pace change between them, shape (n,) [s]."""
    steps = 2.0 * np.diff(grid) / (paces[:-1] + paces[1:])
    return np.concatenate([[0.0], np.cumsum(steps)])


def _at_times(grid: Array, paces: Array, times: Array) -> tuple[Array, Array]:
    """Places and paces at times."""
    passed = _grid_times(grid, paces)
    rates = np.diff(paces) / np.diff(passed)
    cell = np.clip(np.searchsorted(passed, times, side="right") - 1, 0, len(rates) - 1)
    since = times - passed[cell]
    places = grid[cell] + paces[cell] * since + 0.5 * rates[cell] * since**2
    speeds = np.maximum(paces[cell] + rates[cell] * since, 0.0)
    return np.clip(places, grid[0], grid[-1]), speeds


def _slow_paces(
    spline: toppra.SplineInterpolator, grid: Array, limits: Limits, fastest: Array
) -> Array:
    """Constant pace with ramps, slow enough for every limit anywhere on the path, shape (n,)."""
    slope, bend = np.abs(spline(grid, 1)).max(), np.abs(spline(grid, 2)).max()
    top = min(float(fastest.min()), float(np.sqrt(0.4 * limits.acceleration / max(bend, 1e-9))))
    rate = 0.4 * limits.acceleration / slope
    ramps = np.sqrt(2.0 * rate * np.minimum(grid - grid[0], grid[-1] - grid))
    return np.asarray(np.minimum(top, ramps))


def _samples(duration: float) -> Array:
    return np.linspace(0.0, duration, max(2, int(np.ceil(duration / SAMPLE_S)) + 1))
