"""What the motion of a run was certified to see, beside what was measured. Needs no ROS."""

import logging
from collections.abc import Sequence
from dataclasses import replace

from skinplan.errors import SkinplanError
from skinplan.mesh.prepare import prepare_mesh
from skinplan.part.model import Part
from skinplan.robot.cell import CellConfig
from skinplan.robot.tracker import TrackerSight
from skinplan.scanner.predict import part_certifier
from skinplan.stations.model import Station
from skinplan.trajectory.certify import TimedCoverage, certify_trajectories
from skinplan.transforms import Array, inverse
from skinplan_nodes.supervisor.run_data import RunData

_log = logging.getLogger(__name__)


def certified_motion(data: RunData, part: Part, cell: CellConfig) -> TimedCoverage | None:
    """Certifies the trajectories of a run's first scan, the base where it located the part.

    Args:
        data: What the run has gathered.
        part: The part.
        cell: The cell.

    Returns:
        None = the scan is not complete, or can't be certified.
    """
    done = data.first
    if done.station_plan is None or not done.trajectories:
        return None
    try:
        prepared = prepare_mesh(part)
        mesh = prepared.mesh
        certifier = part_certifier(mesh, prepared.segmentation, part.scan, part.fixture)
        place = part.T_map_workpiece
        stations = _where_it_stood(data, done.station_plan.stations, place, cell)
        sight = TrackerSight(cell, mesh, place, done.station_plan.T_map_tracker)
        return certify_trajectories(
            certifier, done.trajectories, stations, place, cell, part.scan.frame_rate_hz, sight
        )
    except SkinplanError as error:
        _log.warning("the motion can't be certified: %s", error)
        return None


def _where_it_stood(
    data: RunData, stations: Sequence[Station], T_map_workpiece: Array, cell: CellConfig
) -> list[Station]:
    """Returns the stations with the base where the first localisation at each found it."""
    found: dict[int, Array] = {}
    for entry in data.localizations:
        found.setdefault(entry.station, entry.T_arm_base_workpiece)
    T_arm_base_link = inverse(cell.T_base_link_arm_base)
    return [
        replace(
            station,
            T_map_base_link=T_map_workpiece @ inverse(found[station.id + 1]) @ T_arm_base_link,
        )
        if station.id + 1 in found
        else station
        for station in stations
    ]
