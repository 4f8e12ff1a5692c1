"""Going on in the middle of a segment: where on its way the arm stands, and what is left of it.

Needs no ROS.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skinplan.trajectory.model import TRANSIT, Segment
from skinplan.transforms import Array

# The arm takes its way up again from this share of the planned speed, within this planned time.
_FIRST_RATE, _RAMP_S = 0.1, 1.0
# It comes back onto its way no faster than this [rad/s].
_RETURN_RAD_S = 0.2
_LEAST_S = 1e-3
# Speed of the way back, in shares of the speed of the way there.
_BACK_RATE = 0.5


@dataclass(frozen=True)
class OnWay:
    """The nearest point of a segment's way.

    Attributes:
        time_s: When the segment passes it, from its start [s].
        distance_rad: Largest difference of a joint there [rad].
    """

    time_s: float
    distance_rad: float


def nearest(segment: Segment, joints: Array, tolerance_rad: float) -> OnWay:
    """Returns where on a segment's way the arm stands.

    Of several places within the tolerance the earliest counts: rather a point is scanned twice than
    not at all.

    Args:
        segment: The segment; linear between its samples.
        joints: Joint positions, shape (6,) [rad].
        tolerance_rad: So near counts as on the way, largest difference of a joint [rad].
    """
    if len(segment.times) < 2:
        return OnWay(0.0, float(np.abs(segment.positions[0] - joints).max()))
    begin, step = segment.positions[:-1], np.diff(segment.positions, axis=0)
    length2 = np.maximum((step**2).sum(axis=1), 1e-18)
    share = np.clip(((joints - begin) * step).sum(axis=1) / length2, 0.0, 1.0)
    distance = np.abs(begin + share[:, None] * step - joints).max(axis=1)
    best = int(np.argmin(distance))
    near = np.flatnonzero(distance <= tolerance_rad)
    if len(near):
        # The first stretch of pieces within the tolerance, and the nearest of it.
        breaks = np.flatnonzero(np.diff(near) > 1)
        first = near[: breaks[0] + 1] if len(breaks) else near
        best = int(first[np.argmin(distance[first])])
    times = segment.times
    time_s = times[best] + share[best] * (times[best + 1] - times[best])
    return OnWay(float(time_s), float(distance[best]))


def until(segment: Segment, time_s: float) -> Segment | None:
    """Returns a segment up to a time; None = nothing of it."""
    if time_s < _LEAST_S or len(segment.times) < 2:
        return None
    if time_s >= segment.duration_s:
        return segment
    kept = segment.times < time_s - 1e-9
    done = _times_of_points(segment) <= time_s
    return replace(
        segment,
        times=np.append(segment.times[kept], time_s),
        positions=np.vstack([segment.positions[kept], _at(segment, segment.positions, time_s)]),
        velocities=np.vstack([segment.velocities[kept], np.zeros(segment.positions.shape[1])]),
        points=segment.points[done],
        point_s=_times_of_points(segment)[done],
        tcp_path_m=segment.tcp_path_m * time_s / segment.duration_s,
    )


def rest(segment: Segment, time_s: float, joints: Array) -> Segment | None:
    """Returns what is left of a segment, begun slowly from where the arm stands.

    Args:
        segment: The segment.
        time_s: Where on its way the arm stands, see `nearest` [s].
        joints: Joint positions of the arm, shape (6,) [rad].

    Returns:
        It starts at the arm's position, at rest; None = nothing is left.
    """
    if segment.duration_s - time_s < _LEAST_S:
        return None
    kept = segment.times > time_s + 1e-9
    planned = segment.times[kept] - time_s
    rate = _rate(planned)
    off_rad = float(np.abs(_at(segment, segment.positions, time_s) - joints).max())
    delay_s = off_rad / _RETURN_RAD_S
    left = _times_of_points(segment) > time_s
    return replace(
        segment,
        times=np.concatenate([[0.0], delay_s + _slowed(planned)]),
        positions=np.vstack([joints, segment.positions[kept]]),
        velocities=np.vstack([np.zeros(len(joints)), segment.velocities[kept] * rate[:, None]]),
        points=segment.points[left],
        point_s=delay_s + _slowed(_times_of_points(segment)[left] - time_s),
        tcp_path_m=segment.tcp_path_m * (1.0 - time_s / segment.duration_s),
    )


def passed(segment: Segment, time_s: float) -> set[int]:
    """Returns the points that a segment has passed at a time."""
    return {int(point) for point in segment.points[_times_of_points(segment) <= time_s]}


def slowed_start(segment: Segment) -> Segment:
    """Returns a segment that is begun slowly."""
    found = rest(segment, 0.0, segment.positions[0])
    return segment if found is None else replace(found, points=segment.points)


def way_back(parts: Sequence[Segment], joints: Array, tolerance_rad: float) -> Segment | None:
    """Returns the way back over what the arm has done, at half the speed.

    It is free of collision because the arm has come along it.

    Args:
        parts: What it has done, each beginning where the one before ends.
        joints: Where it stands, shape (6,) [rad].
        tolerance_rad: So near the end of the parts it has to stand [rad].

    Returns:
        From where the arm stands to the begin of the first part; None = it stands elsewhere.
    """
    if not parts or np.abs(parts[-1].positions[-1] - joints).max() > tolerance_rad:
        return None
    begins = np.cumsum([0.0, *(part.duration_s for part in parts)])
    # Where two parts meet, one sample is enough.
    times = np.concatenate([part.times[:-1] + t for part, t in zip(parts, begins, strict=False)])
    times = np.append(times, begins[-1])
    positions = np.vstack([*(part.positions[:-1] for part in parts), parts[-1].positions[-1:]])
    velocities = np.vstack([*(part.velocities[:-1] for part in parts), 0.0 * positions[-1:]])
    back = Segment(
        TRANSIT,
        (times[-1] - times[::-1]) / _BACK_RATE,
        positions[::-1],
        -velocities[::-1] * _BACK_RATE,
        np.zeros(0, dtype=np.int64),
        sum(part.tcp_path_m for part in parts),
    )
    return rest(back, 0.0, joints)


def _times_of_points(segment: Segment) -> Array:
    """Returns when each point is passed; not known = at the segment's end, shape (p,) [s]."""
    if len(segment.point_s) == len(segment.points):
        return segment.point_s
    return np.full(len(segment.points), segment.duration_s)


def _rate(planned: Array) -> Array:
    """Returns the share of the planned speed at planned times from the re-entry on."""
    return np.minimum(1.0, _FIRST_RATE + (1.0 - _FIRST_RATE) * planned / _RAMP_S)


def _slowed(planned: Array) -> Array:
    """Returns the times at which planned times are reached: the integral of 1 / rate [s]."""
    ramp = np.minimum(planned, _RAMP_S)
    slope = (1.0 - _FIRST_RATE) / _RAMP_S
    return np.log(_rate(ramp) / _FIRST_RATE) / slope + (planned - ramp)


def _at(segment: Segment, values: Array, time_s: float) -> Array:
    return np.array([np.interp(time_s, segment.times, column) for column in values.T])
