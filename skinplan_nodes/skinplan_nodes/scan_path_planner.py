"""Node ``scan_path_planner``: plans the scan path of a part."""

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from skinplan_msgs import msg as messages
from skinplan_msgs.msg import Status
from skinplan_msgs.srv import PlanScanPath

from skinplan.pipeline import plan_path
from skinplan.scanner.predict import predict_coverage
from skinplan_nodes.conversions import PathFacts, finding_to_msg, scan_path_to_msg
from skinplan_nodes.node import CellNode
from skinplan_nodes.parameters import MESHES_KEPT
from skinplan_nodes.part_cache import PartCache, cloud_points
from skinplan_nodes.qos import LATCHED
from skinplan_nodes.replies import replies_in_thread
from skinplan_nodes.run import run_node


class ScanPathPlanner(CellNode):
    """Serves ``plan_scan_path``; publishes the last path on ``scan_path``."""

    NAME = "scan_path_planner"
    PARAMETERS = (MESHES_KEPT,)

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._parts = PartCache(self.values.meshes_kept)
        self._publisher = self.create_publisher(messages.ScanPath, "scan_path", LATCHED)
        self.create_service(
            PlanScanPath,
            "plan_scan_path",
            self._on_plan_scan_path,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )

    @replies_in_thread(invalid=Status.PART_INVALID)
    def _on_plan_scan_path(
        self, request: PlanScanPath.Request, response: PlanScanPath.Response
    ) -> None:
        begin = time.perf_counter()
        part, prepared = self._parts.prepared(request.part)
        response.mesh_time = time.perf_counter() - begin
        mesh = prepared.mesh
        settings = replace(part.scan, strategy=request.strategy or part.scan.strategy)
        seen = cloud_points(request.seen_cloud)
        path = plan_path(prepared, settings, seen, part.points, part.fixture)
        planned = time.perf_counter()
        segmentation = prepared.segmentation
        figures = predict_coverage(mesh, segmentation, path, settings, part.fixture).figures
        response.coverage_time = time.perf_counter() - planned
        facts = PathFacts(part.id, part.mesh_sha256, len(mesh.faces), mesh.area, figures)
        response.path = scan_path_to_msg(path, facts, self.now_s())
        response.findings = [finding_to_msg(finding) for finding in prepared.findings]
        response.planning_time = time.perf_counter() - begin
        self._publisher.publish(response.path)
        self.set_health("ok", f"planned {part.id}", points=len(path), regions=path.regions)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    return run_node(ScanPathPlanner, arguments)


if __name__ == "__main__":
    sys.exit(main())
