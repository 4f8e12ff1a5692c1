"""Node ``station_planner``: chooses where the base stands."""

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from skinplan_msgs import msg as messages
from skinplan_msgs.msg import Status
from skinplan_msgs.srv import PlanStations

from skinplan.part.model import Fixture
from skinplan.stations.marker_view import MARGIN, MarkerView
from skinplan.stations.plan import plan_stations
from skinplan_nodes.conversions import pose_stamped_from_msg, station_plan_to_msg
from skinplan_nodes.node import CellNode
from skinplan_nodes.parameters import CELL_FILE, MESHES_KEPT, Parameter
from skinplan_nodes.part_cache import PartCache
from skinplan_nodes.planning import configured_cell, requested_path
from skinplan_nodes.qos import LATCHED
from skinplan_nodes.replies import replies_in_thread
from skinplan_nodes.run import run_node


class StationPlanner(CellNode):
    """Serves ``plan_stations``; publishes the last plan on ``station_plan``."""

    NAME = "station_planner"
    PARAMETERS = (
        CELL_FILE,
        MESHES_KEPT,
        Parameter(
            "markers_needed",
            True,
            "Stations are places from where the camera will locate the part; false = its place is "
            "known without.",
        ),
        Parameter(
            "quality_threshold",
            0.0,
            "T_E of eq (3) that aruco_localizer asks for [1]; 0 = the one of the cell file.",
            0.0,
            1.0,
        ),
        Parameter(
            "marker_quality_margin",
            MARGIN,
            "So much more than T_E is asked of the E predicted for a station [1].",
            0.0,
            1.0,
        ),
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._cell = configured_cell(self.values.cell_file)
        self._parts = PartCache(self.values.meshes_kept)
        self._publisher = self.create_publisher(messages.StationPlan, "station_plan", LATCHED)
        self.create_service(
            PlanStations,
            "plan_stations",
            self._on_plan_stations,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )

    @replies_in_thread(invalid=Status.REQUEST_INVALID)
    def _on_plan_stations(
        self, request: PlanStations.Request, response: PlanStations.Response
    ) -> None:
        begin = time.perf_counter()
        T_map_workpiece = pose_stamped_from_msg(request.pose, "map", "pose of the workpiece")
        part, prepared = self._parts.prepared(request.part)
        path = requested_path(request.path, part)
        strategy = request.strategy or part.scan.station_strategy
        plan = plan_stations(
            path,
            T_map_workpiece,
            prepared.mesh,
            replace(part.scan, station_strategy=strategy),
            self._cell,
            progress=self.note_progress,
            is_cancelled=self.ended,
            markers=self._marker_view(part.fixture),
        )
        response.plan = station_plan_to_msg(plan, self.now_s())
        response.planning_time = time.perf_counter() - begin
        self._publisher.publish(response.plan)
        self.set_health("ok", f"planned {part.id}", stations=len(plan.stations))

    def _marker_view(self, fixture: Fixture) -> MarkerView | None:
        """What the camera is to see of a part from each station; None = nothing."""
        values = self.values
        # A part without markers is located by its shape.
        if not values.markers_needed or not fixture.markers:
            return None
        return MarkerView(fixture, values.marker_quality_margin, values.quality_threshold)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    return run_node(StationPlanner, arguments)


if __name__ == "__main__":
    sys.exit(main())
