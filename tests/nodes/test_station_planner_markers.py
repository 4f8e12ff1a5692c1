"""What the station planner's parameters ask of the camera's view.

In a file of its own: nodes with other parameters must not answer the same service meanwhile.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from skinplan_msgs.msg import Status
from skinplan_msgs.srv import PlanStations

from nodes.bench import Bench
from nodes.small_part import reference, write_small_part
from skinplan.mesh.prepare import prepare_mesh
from skinplan.part.files import load_part, save_part
from skinplan.part.model import Part
from skinplan.scan_path.plan import plan_scan_path
from skinplan_nodes.conversions import pose_stamped_to_msg, scan_path_to_msg
from skinplan_nodes.station_planner import StationPlanner


def test_a_station_planner_asks_for_markers_as_its_parameters_say(
    tmp_path: Path,
) -> None:
    part = write_small_part(tmp_path)
    prepared = prepare_mesh(part)
    path = scan_path_to_msg(plan_scan_path(prepared.mesh, prepared.segmentation, part.scan))
    # By this cell's figures no place is near enough.
    cell = tmp_path / "cell.yaml"
    cell.write_text("quality: {distance_min_m: 0.2}\n", encoding="utf-8")
    request = PlanStations.Request(part=reference(part), path=path, strategy="rectangles")
    request.pose = pose_stamped_to_msg(part.T_map_workpiece, "map")

    def asked(**parameters: Any) -> PlanStations.Response:
        bench = Bench()
        try:
            bench.start(StationPlanner, simulated=False, cell_file=str(cell), **parameters)
            return bench.call(PlanStations, "plan_stations", request)
        finally:
            bench.close()

    refused = asked(quality_threshold=0.9, marker_quality_margin=0.09)
    assert refused.status.code == Status.NO_CANDIDATES and not refused.plan.stations
    assert "E >= 0.990 (T_E 0.900 and a margin of 0.090)" in refused.status.message
    free = asked(markers_needed=False)
    assert free.status.code == Status.OK and np.isnan(free.plan.marker_quality)
    request.part = reference(_without_markers(part))
    bare = asked(quality_threshold=0.9, marker_quality_margin=0.09)
    assert bare.status.code == Status.OK and np.isnan(bare.plan.marker_quality)


def _without_markers(part: Part) -> Part:
    assert part.source is not None
    bare = replace(part, fixture=replace(part.fixture, dictionary="", markers=()))
    return load_part(save_part(bare, part.source.with_name("bare.yaml")))
