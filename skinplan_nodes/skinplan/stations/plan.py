"""Where the base stands, and what it scans from there (M2.3)."""

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import (
    CancelledError,
    NoCandidatesError,
    NothingReachedError,
    ScanPathInvalidError,
)
from skinplan.mesh.model import SurfaceMesh
from skinplan.part.model import ScanSettings
from skinplan.robot.cell import CellConfig
from skinplan.robot.collision import CollisionWorld
from skinplan.robot.reach import Views, reach
from skinplan.scan_path.model import ScanPath
from skinplan.stations.assign import assign
from skinplan.stations.candidates import floor_frame, make_candidates, refined_centre
from skinplan.stations.cover import WANTED_SPACING_RATIO, choose
from skinplan.stations.model import SkippedPoint, Station, StationPlan
from skinplan.stations.rectangle import workspace_rectangle
from skinplan.strategies import chosen
from skinplan.transforms import Array, apply, inverse, planar, require_transform, rotate

_LOG = logging.getLogger(__name__)

Progress = Callable[[float, str], None]


@dataclass(frozen=True, eq=False)
class Proposal:
    """Base poses proposed by a strategy, before the true reach is known.

    Attributes:
        poses: ``T_map_base_link`` in the order of visit, each of shape (4, 4) [m].
        along: Unit direction on the floor along which stations follow one another, shape (2,), map
            frame.
        candidates: Number of candidates.
        lower_bound: Proven least number of stations over the candidates.
        proven_optimal: No smaller set of candidates covers as much.
        uncovered: Points that no candidate covers, shape (u,).
    """

    poses: tuple[Array, ...]
    along: Array
    candidates: int
    lower_bound: int
    proven_optimal: bool
    uncovered: NDArray[np.int64]


def rectangles(
    path: ScanPath, T_map_workpiece: Array, settings: ScanSettings, cell: CellConfig
) -> Proposal:
    """The paper's method: rectangles on projected points, NMS, eq (6), eq (7)."""
    rectangle = workspace_rectangle(cell, settings.standoff_m)
    floor = apply(T_map_workpiece, path.positions)[:, :2]
    heading = floor_frame(floor, rotate(T_map_workpiece, path.directions))
    turn = planar(0.0, 0.0, heading)[:2, :2]
    points = floor @ turn  # floor frame: first axis along the heading, second to the left
    candidates = make_candidates(points, rectangle)
    choice = choose(
        candidates.covers, candidates.centres, WANTED_SPACING_RATIO * rectangle.length_m
    )
    poses = []
    for number in choice.chosen:
        centre = refined_centre(
            points[candidates.covers[number]], candidates.centres[number], rectangle
        )
        arm = turn @ (centre - np.array([0.0, rectangle.offset_m]))
        # The arm axis stands there: the base so that its arm does.
        offset = turn @ cell.T_base_link_arm_base[:2, 3]
        poses.append((float(centre[0]), planar(arm[0] - offset[0], arm[1] - offset[1], heading)))
    poses.sort(key=lambda pose: pose[0])
    return Proposal(
        tuple(pose for _, pose in poses),
        turn[:, 0],
        len(candidates.centres),
        choice.lower_bound,
        choice.proven,
        np.flatnonzero(~candidates.covers.any(axis=0)),
    )


STRATEGIES: dict[str, Callable[[ScanPath, Array, ScanSettings, CellConfig], Proposal]] = {
    "rectangles": rectangles
}


def plan_stations(
    path: ScanPath,
    T_map_workpiece: Array,
    mesh: SurfaceMesh,
    settings: ScanSettings,
    cell: CellConfig,
    progress: Progress | None = None,
    is_cancelled: Callable[[], bool] | None = None,
) -> StationPlan:
    """Plans the stations and gives every point to one that the arm really reaches it from.

    Args:
        path: The scan path, workpiece frame.
        T_map_workpiece: Part in the shop, shape (4, 4) [m].
        mesh: The part, workpiece frame.
        settings: Scan settings; ``station_strategy`` names one of `STRATEGIES`.
        cell: The cell.
        progress: Told the share done and what is being done.
        is_cancelled: Asked now and then.

    Returns:
        The plan; points that no station reaches are listed with the reason at the station nearest
        to them.

    Raises:
        StrategyUnknownError: No station strategy of that name.
        ScanPathInvalidError: A path without points, or with ones that are not finite.
        NoCandidatesError: No place for the base is free of collision.
        NothingReachedError: The arm reaches no point from any station.
        CancelledError: The caller asked to stop.
    """
    strategy = chosen("station", settings.station_strategy, STRATEGIES)
    _require_path(path)
    T_map_workpiece = require_transform(T_map_workpiece, "T_map_workpiece")
    tell = progress or (lambda share, text: None)
    tell(0.0, "candidates")
    proposal = strategy(path, T_map_workpiece, settings, cell)
    poses, reaches, reasons = _true_reach(
        proposal, path, T_map_workpiece, mesh, settings, cell, tell, is_cancelled
    )
    along = apply(T_map_workpiece, path.positions)[:, :2] @ proposal.along
    places = np.array([pose[:2, 3] @ proposal.along for pose in poses])
    owner = assign(reaches, places, along)
    if np.all(owner < 0):
        reason = reasons[0].get(0, "unknown")
        raise NothingReachedError(
            f"the arm reaches none of the {len(path)} points from any of {len(poses)} stations; "
            f"the first point: {reason}"
        )
    used = [number for number in range(len(poses)) if np.any(owner == number)]
    stations = tuple(
        Station(new, poses[old], np.flatnonzero(owner == old).astype(np.int64))
        for new, old in enumerate(used)
    )
    nearest = np.argmin(np.abs(places[:, None] - along[None]), axis=0)
    skipped = tuple(
        SkippedPoint(
            int(p), _reason(reasons[nearest[p]].get(int(p), "unknown"), p in proposal.uncovered)
        )
        for p in np.flatnonzero(owner < 0)
    )
    ratio = 1.0 - len(skipped) / len(path)
    _LOG.info("%d stations of %d candidates, %.1f %% of %d points reached", len(stations),
    proposal.candidates,
              100.0 * ratio, len(path))  # fmt: skip
    tell(1.0, "done")
    return StationPlan(
        settings.station_strategy, stations, proposal.candidates, proposal.lower_bound,
        proposal.proven_optimal, ratio, skipped,
    )  # fmt: skip


def _true_reach(
    proposal: Proposal,
    path: ScanPath,
    T_map_workpiece: Array,
    mesh: SurfaceMesh,
    settings: ScanSettings,
    cell: CellConfig,
    tell: Progress,
    is_cancelled: Callable[[], bool] | None,
) -> tuple[list[Array], NDArray[np.bool_], list[dict[int, str]]]:
    """Reach at those nominal poses that are free, and the reasons where there is none."""
    home = np.array(cell.home_rad)
    poses, rows, reasons = [], [], []
    blocked = ""
    for number, T_map_base in enumerate(proposal.poses):
        if is_cancelled is not None and is_cancelled():
            raise CancelledError("station planning was cancelled")
        tell(
            0.2 + 0.8 * number / len(proposal.poses),
            f"reach of station {number + 1} of {len(proposal.poses)}",
        )
        T_arm_base_workpiece = inverse(T_map_base @ cell.T_base_link_arm_base) @ T_map_workpiece
        world = CollisionWorld(cell, mesh, T_arm_base_workpiece)
        problem = world.base_problem() or world.pair(home)
        if problem:
            blocked = f"collision of {problem}"
            _LOG.warning(
                "station at %s left out: %s", np.round(T_map_base[:2, 3], 3).tolist(), blocked
            )
            continue
        views = Views.placed(path.positions, path.directions, path.targets, T_arm_base_workpiece)
        reached = reach(world, views, settings.tilt_max_rad, home)
        row = np.zeros(len(path), dtype=bool)
        row[reached.view] = True
        poses.append(T_map_base)
        rows.append(row)
        reasons.append(reached.reasons)
    if not poses:
        raise NoCandidatesError(
            f"none of the {len(proposal.poses)} places for the base is free: {blocked}"
        )
    return poses, np.array(rows), reasons


def _reason(reason: str, uncovered: bool) -> str:
    return f"{reason} (no rectangle covers it)" if uncovered else reason


def _require_path(path: ScanPath) -> None:
    if not len(path):
        raise ScanPathInvalidError(
            "stations were asked for a scan path without points; at least one point is accepted"
        )
    for name in ("positions", "directions", "targets"):
        values = getattr(path, name)
        if values.shape != (len(path), 3) or not np.all(np.isfinite(values)):
            raise ScanPathInvalidError(
                f"scan path {name}: finite numbers of shape ({len(path)}, 3) are accepted"
            )
