"""A job for a part without markers: it is located by its shape, first and at every station."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from skinplan_msgs.msg import JobStatus, Status

from nodes.shape_part import write_shape_part
from shape_parts import two_bumps
from skinplan.part.files import load_part, save_part
from skinplan.part.model import Part
from skinplan.part.recognition_plan import RecognitionPlan
from skinplan.robot.cell import CellConfig
from skinplan_nodes.conversions import pose_stamped_from_msg, stamp_from_msg
from skinplan_nodes.qos import LATCHED, STATE
from skinplan_nodes.truth import TruthLog
from system.graph_run import TIMEOUT_S
from system.served_cell import ServedCell


@pytest.fixture
def part(tmp_path: Path) -> Part:
    """What stands on the fixture; it asks to be identified, too."""
    written = replace(write_shape_part(tmp_path / "part"), recognition=RecognitionPlan(True))
    assert written.source is not None
    save_part(written, written.source)
    return load_part(written.source)


@pytest.fixture
def cell(tmp_path: Path, part: Part) -> Iterator[ServedCell]:
    """The graph, the part in it."""
    found = ServedCell(tmp_path, 1, "10", {}, part)
    yield found
    found.end()


class Truths:
    """Notes where part and base truly are."""

    def __init__(self, cell: ServedCell) -> None:
        self.log = TruthLog(CellConfig().T_base_link_arm_base)
        node = cell.watch.bench.tester
        node.create_subscription(PoseStamped, "truth/workpiece_pose", self._on_part, LATCHED)
        node.create_subscription(PoseStamped, "truth/base_pose", self._on_base, STATE)

    def _on_part(self, message: PoseStamped) -> None:
        self.log.T_map_workpiece = pose_stamped_from_msg(message, "map", "part")

    def _on_base(self, message: PoseStamped) -> None:
        pose = pose_stamped_from_msg(message, "map", "base")
        self.log.base_stood(stamp_from_msg(message.header.stamp), pose)


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_part_without_markers_is_measured(cell: ServedCell, part: Part) -> None:
    truths = Truths(cell)
    cell.order("shape", part)
    assert cell.until_over("shape", 2.0 * TIMEOUT_S), cell.watch.status
    assert cell.watch.status.state == JobStatus.ENDED, cell.watch.status.status.message
    summary = json.loads((cell.runs / "shape" / "summary.json").read_text())
    assert summary["identification"]["fits"] and not summary["interruptions"]
    judged = [truths.log.judged(entry) for entry in summary["localization"]]
    assert [entry["station"] for entry in judged] == list(range(len(judged))) and len(judged) > 1
    for entry in judged:
        assert entry["E"] == 1.0
        assert entry["position_error_m"] < 0.002, judged
        assert entry["angle_error_rad"] < np.radians(0.2), judged
    assert summary["measured"]["area_ratio"] > 0.99


@pytest.mark.long
@pytest.mark.timeout(600)
def test_another_part_without_markers_is_refused_with_both_names(
    tmp_path: Path, cell: ServedCell, part: Part
) -> None:
    written = write_shape_part(tmp_path / "other", "other", lambda x, y: 2.0 * two_bumps(-x, y))
    assert written.source is not None and part.source is not None
    checked = replace(written, recognition=RecognitionPlan(True, (part.source,)))
    cell.order("wrong", load_part(save_part(checked, written.source)))
    assert cell.until_over("wrong", 2.0 * TIMEOUT_S), cell.watch.status
    status = cell.watch.status
    assert status.state == JobStatus.ABORTED and status.status.code == Status.WRONG_PART
    assert "the job is for part other, on the fixture is two_bumps" in status.status.message
    assert cell.watch.motion()[0] < 1e-3, "the arm did not move"
