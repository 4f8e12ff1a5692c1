"""Timing by joint velocity, joint acceleration and scanner speed limits (TOPP-RA)."""

import logging
from dataclasses import dataclass

import numpy as np
import toppra
from toppra.algorithm import TOPPRA
from toppra.constraint import DiscretizationType, JointAccelerationConstraint
from toppra.constraint.linear_constraint import LinearConstraint

from skinplan.robot.arm import ArmModel
from skinplan.transforms import Array

SAMPLE_S = 0.04
DWELL_S = 0.2  # time that the scanner rests at a point that no straight move leads to or from
_GRID_PER_STEP = 4
_PARTS = 4  # pieces of a sample interval in which the scanner's speed is checked
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
    times, places, speeds = _sampled(grid, paces)
    positions, velocities = spline(places), spline(places, 1) * speeds[:, None]
    positions[0], positions[-1] = q[0], q[-1]
    stretch = _excess(arm, times, positions, velocities, limits)
    steps = np.interp(places, knots, np.arange(len(knots)))
    return Timed(stretch * times, positions, velocities / stretch, steps)


def _excess(
    arm: ArmModel, times: Array, positions: Array, velocities: Array, limits: Limits
) -> float:
    """How much slower a motion has to be for limits to hold between grid points too; 1 = none."""
    steps = np.diff(times)
    joint = float((np.abs(velocities) / limits.velocity).max())
    rate = float((np.abs(np.diff(velocities, axis=0)) / steps[:, None]).max()) / limits.acceleration
    parts = np.arange(_PARTS)[:, None] / _PARTS
    fine = (positions[:-1, None] + parts * np.diff(positions, axis=0)[:, None]).reshape(-1, 6)
    places = arm.forward_scanner(np.vstack([fine, positions[-1:]]))[:, :3, 3]
    tcp = np.linalg.norm(np.diff(places, axis=0), axis=1) / np.repeat(steps / _PARTS, _PARTS)
    return max(1.0, joint, float(np.sqrt(rate)), float(tcp.max()) / limits.tcp_speed)


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


def _sampled(grid: Array, paces: Array) -> tuple[Array, Array, Array]:
    """Times, places and paces of samples, with constant pace change between grid points."""
    steps = 2.0 * np.diff(grid) / (paces[:-1] + paces[1:])
    grid_times = np.concatenate([[0.0], np.cumsum(steps)])
    rates = np.diff(paces) / steps
    times = _samples(float(grid_times[-1]))
    cell = np.clip(np.searchsorted(grid_times, times, side="right") - 1, 0, len(rates) - 1)
    since = times - grid_times[cell]
    places = grid[cell] + paces[cell] * since + 0.5 * rates[cell] * since**2
    return (
        times,
        np.clip(places, grid[0], grid[-1]),
        np.maximum(paces[cell] + rates[cell] * since, 0.0),
    )


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
