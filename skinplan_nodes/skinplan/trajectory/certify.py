"""What the timed trajectories will see: the certificate at the scanner's frames.

Each scan segment gives a frame at its start and then at the scanner's frame rate, the last one at
its end. A frame counts when the tracker sees the scanner; all that it sees is certified as for a
scan path.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.robot.arm import ArmModel
from skinplan.robot.bodies import Bodies
from skinplan.robot.cell import CellConfig
from skinplan.robot.tracker import TrackerSight
from skinplan.scanner.certifier import Certifier
from skinplan.scanner.model import Coverage
from skinplan.stations.model import Station
from skinplan.trajectory.model import SCAN, StationTrajectory
from skinplan.transforms import Array, inverse


@dataclass(frozen=True, eq=False)
class TimedCoverage:
    """What timed trajectories see.

    Attributes:
        coverage: The certificate.
        frames: Number of frames.
        hidden: How many of them do not count, because the tracker does not see the scanner.
    """

    coverage: Coverage
    frames: int
    hidden: int


def certify_trajectories(
    certifier: Certifier,
    trajectories: Sequence[StationTrajectory],
    stations: Sequence[Station],
    T_map_workpiece: Array,
    cell: CellConfig,
    frame_rate_hz: float,
    sight: TrackerSight | None = None,
) -> TimedCoverage:
    """Certifies the trajectories of a plan, the base at its nominal poses.

    Args:
        certifier: The part.
        trajectories: Of the stations, by `StationTrajectory.station_id`.
        stations: The stations.
        T_map_workpiece: Part in the shop, shape (4, 4) [m].
        cell: The cell.
        frame_rate_hz: Frames of the scanner [Hz].
        sight: The tracker; None = every frame counts.
    """
    arm = ArmModel.load(cell)
    bodies = Bodies(arm, cell)
    poses = {station.id: station.T_map_base_link for station in stations}
    tracks, seen = [np.zeros((0, 4, 4))], [np.zeros(0, dtype=bool)]
    for trajectory in trajectories:
        T_map_arm = poses[trajectory.station_id] @ cell.T_base_link_arm_base
        q = frames(trajectory, frame_rate_hz)
        segments, T_arm_scanner = bodies.placed(q)
        tracks.append(inverse(T_map_workpiece) @ T_map_arm @ T_arm_scanner)
        visible = np.ones(len(q), dtype=bool)
        if sight is not None and len(q):
            placed = np.tile(T_map_arm, (len(q), 1, 1))
            visible = sight.codes(bodies, segments, T_arm_scanner, placed) == 0
        seen.append(visible)
    track, visible = np.concatenate(tracks), np.concatenate(seen)
    coverage = certifier.track(track[visible][:, :3, 3], track[visible][:, :3, 0])
    return TimedCoverage(coverage, len(track), int(np.sum(~visible)))


def frames(trajectory: StationTrajectory, frame_rate_hz: float) -> Array:
    """Returns the joint positions at the scanner's frames, shape (n, 6) [rad]."""
    result = [np.zeros((0, 6))]
    for segment in trajectory.segments:
        if segment.kind == SCAN:
            times = frame_times(segment.duration_s, frame_rate_hz)
            columns = [np.interp(times, segment.times, column) for column in segment.positions.T]
            result.append(np.stack(columns, axis=1))
    return np.concatenate(result)


def frame_times(duration_s: float, frame_rate_hz: float) -> NDArray[np.float64]:
    """Returns when frames are taken in a segment: at the rate, and at its end, shape (n,) [s]."""
    times = np.arange(int(np.floor(duration_s * frame_rate_hz + 1e-9)) + 1) / frame_rate_hz
    return times if times[-1] > duration_s - 1e-9 else np.append(times, duration_s)
