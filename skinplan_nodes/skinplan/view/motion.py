"""The timed motion of the arm at each station, placed at the part, as the pictures show it."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import InputError
from skinplan.robot.arm import ArmModel
from skinplan.stations.model import SkippedPoint
from skinplan.trajectory.model import SCAN, Segment
from skinplan.transforms import Array, inverse
from skinplan.view.arm_shapes import arm_pose
from skinplan.view.subject import Subject

_STEP_S = 0.05
_DIFFERENCE_S = 1e-5


@dataclass(frozen=True, eq=False)
class StationMotion:
    """What the arm does at a station, as one motion; times count from its start [s].

    Attributes:
        number: The station's place in the order of visit.
        name: The station's number, for people.
        arm: The arm.
        T_workpiece_arm_base: Where it stands, shape (4, 4) [m].
        times: Of the samples, not falling, shape (t,) [s]; a segment's last sample and the next
            one's first have the same.
        positions: Joint positions, shape (t, 6) [rad]; linear between samples.
        velocities: Joint velocities, shape (t, 6) [rad/s].
        owners: Number of the segment of each sample, shape (t,).
        kinds: SCAN or TRANSIT, one of each segment, shape (k,).
        spans: Begin and end of each segment, shape (k, 2) [s].
        points: Scan path points in the order of visit, shape (p,).
        point_s: When each is passed, shape (p,) [s].
        skipped: Points of the station that are not scanned.
    """

    number: int
    name: str
    arm: ArmModel
    T_workpiece_arm_base: Array
    times: Array
    positions: Array
    velocities: Array
    owners: NDArray[np.int64]
    kinds: NDArray[np.int64]
    spans: Array
    points: NDArray[np.int64]
    point_s: Array
    skipped: tuple[SkippedPoint, ...]

    @property
    def duration_s(self) -> float:
        """How long the arm moves [s]."""
        return float(self.times[-1]) if len(self.times) else 0.0

    @property
    def scan_spans(self) -> Array:
        """Begin and end of each scan, shape (s, 2) [s]."""
        return self.spans[self.kinds == SCAN]

    @property
    def break_s(self) -> Array:
        """When the scan is broken off to go on elsewhere, shape (b,) [s]."""
        return self.scan_spans[:-1, 1]

    def is_scanning(self, time_s: float) -> bool:
        """Tells whether the scanner scans at a time [s]."""
        spans = self.scan_spans
        return bool(np.any((spans[:, 0] <= time_s) & (time_s <= spans[:, 1])))

    def joints(self, times: Array) -> Array:
        """Returns the joint positions at times [s], shape (n,), as shape (n, 6) [rad].

        Before the start and after the end the arm stands still.
        """
        return np.stack(
            [np.interp(times, self.times, self.positions[:, joint]) for joint in range(6)], axis=1
        )

    def scanner(self, q: Array) -> Array:
        """Returns ``T_workpiece_scanner``, (n, 4, 4) [m], of joint positions, (n, 6) [rad]."""
        return np.asarray(self.T_workpiece_arm_base @ self.arm.forward_scanner(q))

    @cached_property
    def speeds(self) -> Array:
        """Speed of the scanner's origin at each sample, shape (t,) [m/s]."""
        ahead, behind = (
            self.arm.forward_scanner(self.positions + sign * _DIFFERENCE_S * self.velocities)
            for sign in (0.5, -0.5)
        )
        way = ahead[:, :3, 3] - behind[:, :3, 3]
        return np.asarray(np.linalg.norm(way, axis=1) / _DIFFERENCE_S)

    @cached_property
    def accelerations(self) -> tuple[Array, Array]:
        """Begin and end of each step between samples, (m, 2) [s], and joint accelerations, (m, 6).

        Mean over the step [rad/s^2].
        """
        step = np.diff(self.times)
        inside = np.flatnonzero((np.diff(self.owners) == 0) & (step > 0.0))
        ends = np.stack([self.times[inside], self.times[inside + 1]], axis=1)
        return ends, np.diff(self.velocities, axis=0)[inside] / step[inside, None]

    def way(self, segment: int, step_s: float = _STEP_S) -> tuple[Array, Array]:
        """Returns times, shape (n,) [s], and places of the scanner, shape (n, 3) [m], workpiece.

        Args:
            segment: Number of the segment.
            step_s: Largest step between the times [s]; the joints' motion between two samples is no
                straight line of the scanner.
        """
        begin, end = self.spans[segment]
        even = np.linspace(begin, end, max(2, int(np.ceil((end - begin) / step_s)) + 1))
        times = np.union1d(even, self.times[self.owners == segment])
        return times, self.scanner(self.joints(times))[:, :3, 3]


def station_motions(subject: Subject) -> tuple[StationMotion, ...]:
    """Returns the motion at each station that has a trajectory, in the order of visit.

    Args:
        subject: What there is to show; without trajectories the result is empty.

    Raises:
        InputError: A trajectory of a station that the plan does not have, or one with values that
            are not finite.
    """
    if subject.station_plan is None:
        return ()
    numbers = {station.id: n for n, station in enumerate(subject.station_plan.stations)}
    unknown = [t.station_id for t in subject.trajectories if t.station_id not in numbers]
    if unknown:
        raise InputError(
            f"trajectories of the stations {sorted(numbers)} are accepted, found one of station "
            f"{unknown[0]}"
        )
    arm = ArmModel.load(subject.cell)
    found = []
    for trajectory in subject.trajectories:
        number = numbers[trajectory.station_id]
        T_workpiece_arm_base = inverse(subject.T_map_workpiece) @ arm_pose(subject, number)
        segments = [segment for segment in trajectory.segments if len(segment.times)]
        found.append(
            StationMotion(
                number,
                str(trajectory.station_id),
                arm,
                T_workpiece_arm_base,
                *_joined(segments, trajectory.station_id),
                trajectory.skipped,
            )
        )
    return tuple(sorted(found, key=lambda motion: motion.number))


def _joined(
    segments: Sequence[Segment], station_id: int
) -> tuple[
    Array, Array, Array, NDArray[np.int64], NDArray[np.int64], Array, NDArray[np.int64], Array
]:
    """Puts segments one after another on one clock; the fields of `StationMotion` from times on."""
    begins = np.cumsum([0.0, *(segment.duration_s for segment in segments)])
    none, joints = np.zeros(0), np.zeros((0, 6))
    times = np.concatenate([none, *(s.times + b for s, b in zip(segments, begins, strict=False))])
    positions = np.concatenate([joints, *(segment.positions for segment in segments)])
    velocities = np.concatenate([joints, *(segment.velocities for segment in segments)])
    point_s = np.concatenate(
        [none, *(s.point_s + b for s, b in zip(segments, begins, strict=False))]
    )
    points = np.concatenate([none, *(segment.points for segment in segments)]).astype(np.int64)
    if not all(np.isfinite(part).all() for part in (times, positions, velocities, point_s)):
        raise InputError(
            f"finite times, joint positions and velocities are accepted, found others in the "
            f"trajectory of station {station_id}"
        )
    if len(points) != len(point_s):
        raise InputError(
            f"one time for each of the {len(points)} points passed is accepted, found "
            f"{len(point_s)} in the trajectory of station {station_id}"
        )
    owners = np.repeat(np.arange(len(segments)), [len(segment.times) for segment in segments])
    kinds = np.array([segment.kind for segment in segments], dtype=np.int64)
    spans = np.stack([begins[:-1], begins[1:]], axis=1)
    return times, positions, velocities, owners.astype(np.int64), kinds, spans, points, point_s
