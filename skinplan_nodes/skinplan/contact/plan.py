"""Contact measurement of a part: stations, tracker, poses, checks (C 3 and 4)."""

import logging
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from skinplan.contact.axial_frame import axial_frame
from skinplan.contact.axial_radial import AxialRadialPlan, plan_axial_radial
from skinplan.contact.model import ContactPlan, ContactStation, MissedPoint, TrackerStation
from skinplan.contact.motion import StationMotion, T_axial_probe
from skinplan.contact.probing import StationReach
from skinplan.contact.probing_arm import ProbingArm
from skinplan.contact.settings import ContactSettings, require_settings
from skinplan.contact.sight import Sight
from skinplan.contact.tours import Tours, plan_tours, preference
from skinplan.contact.tracker import (
    SightOptions,
    find_tracker,
    seen_options,
    tracker_candidates,
    tracker_station,
)
from skinplan.errors import CancelledError, NoTrackerStationError
from skinplan.mesh.model import SurfaceMesh
from skinplan.part.inspection_points import require_normals, require_points
from skinplan.transforms import Array, apply, inverse, planar, require_transform, rotate

_LOG = logging.getLogger(__name__)
_TRACKERS_TRIED = 2
NOT_SEEN = "hidden from the tracker in every pose"
NO_APPROACH = "no approach on which the tracker holds the T-Mac"


class ContactPlanner:
    """Plans one part; its steps can also be asked for one by one.

    Attributes:
        settings: The cell.
        T_map_axial: Axial frame in the shop, shape (4, 4) [m].
        points: Measuring points, axial frame, shape (n, 3) [m].
        normals: Outward unit normals, axial frame, shape (n, 3).
        arm: Arm and tool.
        sight: Line of sight.
    """

    def __init__(
        self,
        points: Array,
        normals: Array,
        mesh: SurfaceMesh | None,
        T_map_workpiece: Array,
        settings: ContactSettings | None = None,
        is_cancelled: Callable[[], bool] | None = None,
    ) -> None:
        """Takes the part.

        Args:
            points: On the surface, workpiece frame, shape (n, 3) [m].
            normals: Outward unit normals, shape (n, 3).
            mesh: The part, workpiece frame; None = nothing to collide with.
            T_map_workpiece: Part in the shop, shape (4, 4) [m]; its y axis, the axis of C, is level
                and the stations are on its x side.
            settings: The cell; None = that of the paper.
            is_cancelled: Asked now and then.

        Raises:
            InspectionPointsError: Points or normals that can't be used.
            InputError: Settings out of range, or a part whose axis is not level.
        """
        self.settings = require_settings(settings or ContactSettings())
        points = require_points(points)
        normals = require_normals(normals, len(points))
        T_map_workpiece = require_transform(T_map_workpiece, "T_map_workpiece")
        self.T_map_axial = axial_frame(T_map_workpiece, self.settings.base_height_m)
        T_axial_workpiece = inverse(self.T_map_axial) @ T_map_workpiece
        self.points = apply(T_axial_workpiece, points)
        self.normals = rotate(T_axial_workpiece, normals)
        self._mesh = None
        if mesh is not None:
            self._mesh = SurfaceMesh(apply(T_axial_workpiece, mesh.vertices), mesh.faces)
        self.arm = ProbingArm(self.settings, self._mesh)
        self.sight = Sight(self.arm, self._mesh)
        self._is_cancelled = is_cancelled or (lambda: False)
        self._facing = np.array([0.0, -1.0, 0.0])

    def place(self, x: float, y: float) -> Array:
        """``T_axial_arm`` of the arm's base at (x, y) [m], shape (4, 4)."""
        return planar(x, y, self.settings.heading_rad)

    def at(self, x: float, y: float) -> StationReach:
        """What the arm reaches with its base at (x, y) [m], axial frame."""
        if self._is_cancelled():
            raise CancelledError("contact planning was cancelled")
        return StationReach(self.arm, self.place(x, y), self.points, self.normals, self._facing)

    def stations(self) -> AxialRadialPlan:
        """Runs steps (1) to (9)."""

        def reach(x: float, y: float) -> NDArray[np.bool_]:
            here = self.at(x, y)
            return here.reached() if self.settings.collision_counts else here.kinematic()

        return plan_axial_radial(self.points, reach, self.settings.stations)

    def options(self, plan: AxialRadialPlan) -> SightOptions:
        """All ways to measure all points from the stations."""
        parts = []
        for number, station in enumerate(plan.stations):
            found = self.at(station.x_m, station.y_m).options()
            mirrors = self.place(station.x_m, station.y_m) @ self.arm.forward_mirror(found.q)
            parts.append((found.point, np.full(len(found.point), number), found.q, mirrors))
        point, owner, q, mirror = (np.concatenate(c) for c in zip(*parts, strict=True))
        return SightOptions(point, owner, q, mirror, len(self.points))

    def seen_from(self, tracker: Array, plan: AxialRadialPlan) -> TrackerStation:
        """Static check of a given tracker: which points it sees in some pose.

        Args:
            tracker: Its place, shape (3,) [m], axial frame.
            plan: The stations.
        """
        options = self.options(plan)
        seen = seen_options(
            np.asarray(tracker, dtype=float), options, self._places(plan), self.sight
        )
        return tracker_station(tracker, options.chosen(seen), self.sight)

    def run(self, tracker: Array | None = None) -> ContactPlan:
        """Plans everything.

        Args:
            tracker: Place of the tracker, shape (3,) [m], axial frame; None = found.

        Raises:
            NothingReachedError: No point is reached from anywhere.
            NoTrackerStationError: No candidate sees all points that are reached.
        """
        plan = self.stations()
        options = self.options(plan)
        if tracker is not None:
            seen = seen_options(tracker, options, self._places(plan), self.sight)
            return self._with_tracker(plan, options, np.asarray(tracker, dtype=float), seen)
        places = tracker_candidates(
            self.points,
            self._mesh.bounds if self._mesh is not None else _box(self.points),
            np.array([[station.x_m, station.y_m] for station in plan.stations]),
            self.arm,
        )
        found = find_tracker(places, options, self._places(plan), self.sight, _TRACKERS_TRIED)
        if not found:
            raise NoTrackerStationError(
                f"none of {len(places)} places around the part sees the T-Mac at all of "
                f"{len(np.unique(options.point))} points; wider limits of the tracker or another "
                "T-Mac mount are needed"
            )
        results = []
        for place, seen in found:
            results.append(self._with_tracker(plan, options, place, seen))
            if not _flaws(results[-1]):
                break
        return min(results, key=_flaws)

    def _places(self, plan: AxialRadialPlan) -> tuple[Array, ...]:
        return tuple(self.place(station.x_m, station.y_m) for station in plan.stations)

    def _with_tracker(
        self, plan: AxialRadialPlan, options: SightOptions, tracker: Array, seen: NDArray[np.int64]
    ) -> ContactPlan:
        if self._is_cancelled():
            raise CancelledError("contact planning was cancelled")
        places = self._places(plan)
        held = options.chosen(seen)
        tours = plan_tours(
            [
                StationMotion(self.arm, self.sight, tracker, place, number)
                for number, place in enumerate(places)
            ],
            held,
            self.points,
            preference(plan, self.points),
        )
        return self._answer(plan, tracker, tours)

    def _answer(self, plan: AxialRadialPlan, tracker: Array, tours: Tours) -> ContactPlan:
        q, owner = tours.q, tours.station_of
        places = self._places(plan)
        measured = np.isfinite(q[:, 0])
        missed = self._missed(plan, owner, measured)
        owner = np.where(measured, owner, -1)
        probe = np.full((len(q), 4, 4), np.nan)
        for number, place in enumerate(places):
            here = owner == number
            probe[here] = T_axial_probe(self.arm, q[here], place)
        mirror = self.arm.mirror_poses(probe)
        used = SightOptions(
            np.flatnonzero(measured), owner[measured], q[measured], mirror[measured], len(q)
        )
        stations = tuple(
            ContactStation(s.x_m, s.y_m, s.start_x_m, s.k, s.counts, s.reached, order, place)
            for s, order, place in zip(plan.stations, tours.orders, places, strict=True)
        )
        return ContactPlan(
            self.T_map_axial, stations, plan.complete, plan.reached_sum, plan.history,
            tracker_station(tracker, used, self.sight), owner, q, probe,
            self.arm.flange_poses(probe), mirror, tours.motions, missed,
        )  # fmt: skip

    def _missed(
        self, plan: AxialRadialPlan, owner: NDArray[np.int64], measured: NDArray[np.bool_]
    ) -> tuple[MissedPoint, ...]:
        lost = np.flatnonzero(~measured)
        if not len(lost):
            return ()
        rows = np.array([station.y_m for station in plan.stations])
        nearest = np.argmin(np.abs(rows[:, None] - self.points[None, lost, 1]), axis=0)
        reasons = {
            number: self.at(plan.stations[number].x_m, plan.stations[number].y_m).reasons()
            for number in sorted(set(nearest.tolist()))
        }
        result = []
        for point, number in zip(lost.tolist(), nearest.tolist(), strict=True):
            reason = reasons[number][point] if not plan.covered[point] else NOT_SEEN
            reason = NO_APPROACH if owner[point] >= 0 else reason
            result.append(MissedPoint(point, reason))
        return tuple(result)


def plan_contact(
    points: Array,
    normals: Array,
    mesh: SurfaceMesh | None,
    T_map_workpiece: Array,
    settings: ContactSettings | None = None,
    tracker: Array | None = None,
    is_cancelled: Callable[[], bool] | None = None,
) -> ContactPlan:
    """Plans contact measurement; arguments and errors as `ContactPlanner` and its `run`."""
    planner = ContactPlanner(points, normals, mesh, T_map_workpiece, settings, is_cancelled)
    plan = planner.run(tracker)
    _LOG.info(
        "%d stations, reachable sum %d, %d of %d points measured",
        len(plan.stations),
        plan.reached_sum,
        int(np.count_nonzero(plan.station_of >= 0)),
        len(plan.q),
    )
    return plan


def _flaws(plan: ContactPlan) -> int:
    """Points not measured and motions that fail."""
    return len(plan.missed) + sum(1 for motion in plan.motions if motion.problem)


def _box(points: Array) -> Array:
    return np.stack([points.min(axis=0), points.max(axis=0)])
