"""Another part on the fixture than the job's: the graph refuses it before it moves the arm."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from skinplan_msgs.msg import Job, JobStatus, Status

from nodes.small_part import reference, write_small_part
from skinplan.part.files import load_part, save_part
from skinplan.part.model import Part
from skinplan.part.recognition_plan import RecognitionPlan
from system.graph_run import TIMEOUT_S
from system.served_cell import ServedCell


def checked_part(folder: Path, name: str, height_m: float, others: tuple[Path, ...] = ()) -> Part:
    """Writes a part that asks to be identified."""
    folder.mkdir()
    written = replace(
        write_small_part(folder, height_m), id=name, recognition=RecognitionPlan(True, others)
    )
    assert written.source is not None
    save_part(written, written.source)
    return load_part(written.source)


@pytest.fixture
def rib(tmp_path: Path) -> Part:
    """What stands on the fixture."""
    return checked_part(tmp_path / "rib", "rib", 0.03)


@pytest.fixture
def cell(tmp_path: Path, rib: Part) -> Iterator[ServedCell]:
    """The graph, the rib on its fixture."""
    found = ServedCell(tmp_path, 1, "10", {}, rib)
    yield found
    found.end()


def measure(cell: ServedCell, job_id: str, part: Part) -> JobStatus:
    """Orders a job and waits for its end."""
    cell.watch.forget()
    cell.watch.submit(Job(job_id=job_id, part=reference(part)))
    assert cell.until_over(job_id, TIMEOUT_S), cell.watch.status
    return cell.watch.status


def test_the_wrong_part_is_refused_with_both_names(
    tmp_path: Path, cell: ServedCell, rib: Part
) -> None:
    assert rib.source is not None
    frame = checked_part(tmp_path / "frame", "frame", 0.08, (rib.source,))
    refused = measure(cell, "wrong", frame)
    assert refused.state == JobStatus.ABORTED
    assert refused.status.code == Status.WRONG_PART
    assert "the job is for part frame, on the fixture is rib" in refused.status.message
    arm_rad, _ = cell.watch.motion()
    assert arm_rad < 1e-3, "the arm did not move"
    summary = json.loads((cell.runs / "wrong" / "summary.json").read_text())
    assert summary["identification"]["alike"] == ["rib"] and not summary["identification"]["fits"]
    assert "scan_path" not in summary


@pytest.mark.long
@pytest.mark.timeout(400)
def test_an_unknown_part_is_refused_and_the_right_one_measured(
    tmp_path: Path, cell: ServedCell, rib: Part
) -> None:
    unknown = measure(cell, "unknown", checked_part(tmp_path / "frame", "frame", 0.08))
    assert unknown.status.code == Status.UNKNOWN_PART
    assert "for part frame, on the fixture is another one: unknown part (frame:" in (
        unknown.status.message
    )
    right = measure(cell, "right", rib)
    assert right.state == JobStatus.ENDED, right.status.message
    summary = json.loads((cell.runs / "right" / "summary.json").read_text())
    assert summary["identification"]["fits"] and summary["identification"]["part"] == "rib"
    assert summary["measured"]["area_ratio"] > 0.99
    assert len(summary["interruptions"]) == 0
