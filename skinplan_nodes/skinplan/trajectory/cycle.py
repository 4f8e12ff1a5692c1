"""Cycle time of a whole plan."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skinplan.part.model import ScanSettings
from skinplan.robot.cell import CellConfig
from skinplan.scan_path.model import ROW, ScanPath
from skinplan.stations.model import StationPlan
from skinplan.trajectory.bezier import largest_jerk
from skinplan.trajectory.model import SCAN, StationTrajectory
from skinplan.transforms import difference


@dataclass(frozen=True)
class StationTime:
    """What one station costs.

    Attributes:
        station_id: Number of the station.
        scan_s: Scan segments [s].
        transit_s: Transit segments [s].
        base_s: Driving to it from the station before, and settling with localisation [s].
        breaks: Interruptions of the scan.
    """

    station_id: int
    scan_s: float
    transit_s: float
    base_s: float
    breaks: int


@dataclass(frozen=True)
class CycleTime:
    """What a plan costs.

    Attributes:
        scan_s: Scan segments [s].
        transit_s: Transit segments [s].
        base_s: Driving between the stations, and settling with localisation at each [s].
        cycle_s: Sum of the three [s].
        lower_bound_s: Swept length of the scanned rows at the scanner's speed limit [s]; 0 when the
            path was not given.
        breaks: Interruptions of the scan within stations.
        tcp_path_m: Way of the scanner's origin while scanning [m].
        jerk_rad_s3: Largest change of a joint's acceleration from sample to sample of a scan
            [rad/s^3]; timing ``toppra`` does not limit it, timing ``bezier`` keeps it bounded.
        stations: The times of each station.
    """

    scan_s: float
    transit_s: float
    base_s: float
    cycle_s: float
    lower_bound_s: float
    breaks: int
    tcp_path_m: float
    jerk_rad_s3: float = float("nan")
    stations: tuple[StationTime, ...] = ()


def cycle_time(
    plan: StationPlan,
    trajectories: Sequence[StationTrajectory],
    cell: CellConfig,
    settings: ScanSettings,
    path: ScanPath | None = None,
) -> CycleTime:
    """Adds up the times of a plan.

    The base drives straight at `CellConfig.base_speed_m_s` from station to station (the way to the
    first one is not counted) and each station costs `CellConfig.settle_s`.

    Args:
        plan: The stations.
        trajectories: Their trajectories.
        cell: The cell.
        settings: Scan settings.
        path: The scan path, for the lower bound.
    """
    stations = _station_times(plan, trajectories, cell)
    scan = sum(t.scan_s for t in trajectories)
    transit = sum(t.transit_s for t in trajectories)
    base = sum(station.base_s for station in stations)
    length = 0.0 if path is None else row_length(path, trajectories)
    scans = [s for t in trajectories for s in t.segments if s.kind == SCAN]
    return CycleTime(
        scan_s=scan,
        transit_s=transit,
        base_s=base,
        cycle_s=scan + transit + base,
        lower_bound_s=length / settings.tcp_speed_m_s,
        breaks=sum(t.breaks for t in trajectories),
        tcp_path_m=sum(t.tcp_path_m for t in trajectories),
        jerk_rad_s3=max((largest_jerk(segment) for segment in scans), default=float("nan")),
        stations=stations,
    )


def _station_times(
    plan: StationPlan, trajectories: Sequence[StationTrajectory], cell: CellConfig
) -> tuple[StationTime, ...]:
    poses = [station.T_map_base_link for station in plan.stations]
    ways = [0.0, *(difference(a, b)[0] for a, b in zip(poses, poses[1:], strict=False))]
    done = {trajectory.station_id: trajectory for trajectory in trajectories}
    result = []
    for station, way in zip(plan.stations, ways, strict=True):
        motion = done.get(station.id, StationTrajectory(station.id, (), ()))
        base = way / cell.base_speed_m_s + cell.settle_s
        result.append(StationTime(station.id, motion.scan_s, motion.transit_s, base, motion.breaks))
    return tuple(result)


def row_length(path: ScanPath, trajectories: Sequence[StationTrajectory]) -> float:
    """Returns the length of the rows between scanned neighbours, as planned (no tilt) [m]."""
    scanned = np.zeros(len(path), dtype=bool)
    for trajectory in trajectories:
        for segment in trajectory.segments:
            scanned[segment.points] = True
    both = (
        scanned[1:] & scanned[:-1] & (path.kinds[1:] == ROW) & (path.groups[1:] == path.groups[:-1])
    )
    return float(np.linalg.norm(np.diff(path.positions, axis=0), axis=1)[both].sum())
