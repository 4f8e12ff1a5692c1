"""Where a motion has to be sampled so that straight lines between the samples are near enough."""

import numpy as np
from numpy.typing import NDArray

from skinplan.robot.arm import ArmModel
from skinplan.transforms import Array, inverse

_LONGEST_S = 0.04  # samples also say where the arm is: they are never farther apart
_CUBIC_SHARES = (0.25, 0.5, 0.75)  # of an interval at which the speed of a cubic is looked at


def sample_counts(
    durations: Array, accelerations: Array, levers: Array, deviation_m: float
) -> NDArray[np.int64]:
    """Says into how many intervals segments have to be divided for lines to stay near the motion.

    Between samples a step dt apart a joint is at most ``a dt^2 / 8`` from the line, which moves the
    scanner by at most that times the joint's lever arm; all joints together at most by the sum.

    Args:
        durations: Of the segments, shape (n,) [s].
        accelerations: Largest absolute ones on each segment, shape (n, 6) [rad/s^2].
        levers: Lever arm of each joint, shape (6,) [m].
        deviation_m: Largest distance of the scanner [m].

    Returns:
        Counts, shape (n,).
    """
    way = accelerations @ levers  # [m/s^2]
    step = np.sqrt(8.0 * deviation_m / np.maximum(way, 1e-12))
    counts = np.ceil(durations / np.minimum(step, _LONGEST_S) - 1e-9)
    return np.maximum(counts, 1).astype(np.int64)


def sample_shares(counts: NDArray[np.int64]) -> tuple[NDArray[np.int64], Array]:
    """Divides segments evenly.

    Args:
        counts: Number of intervals of each segment, shape (n,).

    Returns:
        Segment and share of its duration for each sample, in order of time, both of shape (m,):
        the start of each segment, and at last the end of the last one as share 1.
    """
    owner = np.repeat(np.arange(len(counts), dtype=np.int64), counts)
    share = (np.arange(len(owner)) - (np.cumsum(counts) - counts)[owner]) / counts[owner]
    return np.append(owner, len(counts) - 1), np.append(share, 1.0)


def line_use(arm: ArmModel, times: Array, positions: Array, tcp_speed_m_s: float) -> Array:
    """Returns how much of the scanner's speed limit lines between samples use, shape (m - 1,).

    Args:
        arm: The arm.
        times: Of the samples, shape (m,) [s].
        positions: Joint positions, shape (m, 6) [rad].
        tcp_speed_m_s: Speed limit of the scanner [m/s]; inf = none.
    """
    if not np.isfinite(tcp_speed_m_s):
        return np.zeros(len(times) - 1)
    pace = np.diff(positions, axis=0) / np.diff(times)[:, None]
    start, end = tcp_speeds(arm, positions[:-1], pace), tcp_speeds(arm, positions[1:], pace)
    return np.asarray(np.maximum(start, end) / tcp_speed_m_s)


def cubic_use(
    arm: ArmModel, times: Array, positions: Array, velocities: Array, tcp_speed_m_s: float
) -> Array:
    """Returns how much of the scanner's speed limit cubics through the samples use, shape (m - 1,).

    Args:
        arm: The arm.
        times: Of the samples, shape (m,) [s].
        positions: Joint positions, shape (m, 6) [rad].
        velocities: Joint velocities, shape (m, 6) [rad/s].
        tcp_speed_m_s: Speed limit of the scanner [m/s]; inf = none.
    """
    if not np.isfinite(tcp_speed_m_s):
        return np.zeros(len(times) - 1)
    step = np.diff(times)[:, None]
    change, start, end = np.diff(positions, axis=0), velocities[:-1], velocities[1:]
    bend, twist = 3.0 * change / step - 2.0 * start - end, start + end - 2.0 * change / step
    use = np.zeros(len(step))
    for share in _CUBIC_SHARES:
        q = positions[:-1] + step * share * (start + share * (bend + share * twist))
        pace = start + share * (2.0 * bend + 3.0 * share * twist)
        np.maximum(use, tcp_speeds(arm, q, pace) / tcp_speed_m_s, out=use)
    return use


def tcp_speeds(arm: ArmModel, q: Array, velocities: Array) -> Array:
    """Returns speeds of the scanner's origin by the geometric Jacobian, shape (n,) [m/s].

    Args:
        arm: The arm.
        q: Joint positions, shape (n, 6) [rad].
        velocities: Joint velocities, shape (n, 6) [rad/s].
    """
    zero = np.zeros((1, 6))
    T_6_scanner = inverse(arm.links(zero)[0, 6]) @ arm.forward_scanner(zero)[0]
    links = arm.links(q)
    scanner = links[:, 6, :3, :3] @ T_6_scanner[:3, 3] + links[:, 6, :3, 3]
    axes = np.einsum("njab,jb->nja", links[:, 1:, :3, :3], arm.axes)
    arms = scanner[:, None] - links[:, 1:, :3, 3]
    return np.asarray(
        np.linalg.norm(np.einsum("nj,nja->na", velocities, np.cross(axes, arms)), axis=1)
    )
