"""A place for the tracker where the cell gives none."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from skinplan.robot.cell import CellConfig, TrackerSettings
from skinplan.robot.tracker_place import Postures, propose_tracker
from skinplan.stations.model import StationPlan
from skinplan.stations.problem import StationProblem

# Sees everything, from everywhere: no target has to be visible.
_ALL_SEEING = TrackerSettings(
    range_min_m=0.0, range_max_m=1000.0, cone_rad=math.pi, targets_least=0
)


def with_proposed_tracker(
    problem: StationProblem, plan: Callable[[StationProblem], StationPlan]
) -> CellConfig:
    """Plans as if the tracker saw everything, then finds a place that sees all of that plan.

    Args:
        problem: What stations are wanted for, in a cell without a place for the tracker.
        plan: Plans the stations of a problem.

    Returns:
        The cell with the place proposed. Stations have to be planned anew for it: that checks
        every pose.

    Raises:
        TrackerBlindError: From nowhere anything is seen.
        SkinplanError: As planning does.
    """
    cell = replace(problem.cell, propose_tracker=False)
    first = plan(replace(problem, cell=replace(cell, tracker=_ALL_SEEING)))
    place = propose_tracker(cell, problem.mesh, problem.T_map_workpiece, _postures(first, cell))
    return replace(cell, T_map_tracker=place)


def _postures(plan: StationPlan, cell: CellConfig) -> Postures:
    """The arm at all points of a plan."""
    table = plan.records
    assert table is not None and table.q is not None
    q = [table.q[row, station.points] for row, station in enumerate(plan.stations)]
    arms = [
        np.tile(station.T_map_base_link @ cell.T_base_link_arm_base, (len(station.points), 1, 1))
        for station in plan.stations
    ]
    return Postures(np.concatenate(q), np.concatenate(arms))
