"""A run is verified: the planners are asked again; what differs is named, stage by stage."""

from pathlib import Path
from typing import Any

import pytest
import yaml
from rclpy.serialization import serialize_message
from skinplan_msgs.msg import Status
from skinplan_msgs.srv import PlanScanPath, PlanStations
from tf2_msgs.msg import TFMessage

from nodes.bench import Bench
from nodes.small_part import reference, write_small_part
from skinplan.errors import BagInvalidError, InputError
from skinplan.part.model import Part
from skinplan.recording.bag import BagWriter
from skinplan_nodes.conversions import pose_stamped_to_msg, transform_stamped_to_msg
from skinplan_nodes.replay_verify import parsed_changes, verify_bag
from skinplan_nodes.scan_path_planner import ScanPathPlanner
from skinplan_nodes.station_planner import StationPlanner
from skinplan_nodes.verify.bench import NotAnsweredError, VerifyBench


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Part]:
    """The bag of a run that ended after its stations were planned."""
    folder = tmp_path_factory.mktemp("verify")
    part = write_small_part(folder)
    bench = Bench()
    bench.start(ScanPathPlanner, simulated=False)
    bench.start(StationPlanner, simulated=False)
    asked = PlanScanPath.Request(part=reference(part))
    path = bench.call(PlanScanPath, "plan_scan_path", asked).path
    pose = pose_stamped_to_msg(part.T_map_workpiece, "map")
    request = PlanStations.Request(part=reference(part), path=path, pose=pose)
    answer = bench.call(PlanStations, "plan_stations", request)
    bench.close()
    assert answer.status.code == Status.OK
    edge = transform_stamped_to_msg("map", "workpiece", part.T_map_workpiece, 1.0)
    facts = {"part_uri": str(part.source), "mesh_sha256": part.mesh_sha256}
    with BagWriter(folder / "bag", facts) as writer:
        for at, topic, kind, message in (
            (1, "/tf", "tf2_msgs/msg/TFMessage", TFMessage(transforms=[edge])),
            (2, "/scan_path", "skinplan_msgs/msg/ScanPath", path),
            (3, "/station_plan", "skinplan_msgs/msg/StationPlan", answer.plan),
        ):
            writer.add_topic(topic, kind, "")
            writer.write(topic, serialize_message(message), at * 10**9)
    return folder / "bag", part


def changed_part(part: Part, folder: Path, **scan: Any) -> str:
    """The part file with other scan settings."""
    assert part.source is not None
    document = yaml.safe_load(part.source.read_text())
    document["scan"].update(scan)
    document["mesh"]["file"] = str(part.mesh_path)
    (folder / "part.yaml").write_text(yaml.safe_dump(document))
    return str(folder / "part.yaml")


def test_the_same_inputs_give_the_same_results(recorded: tuple[Path, Part]) -> None:
    document = verify_bag(recorded[0])
    assert document["identical"] and document["first_difference"] is None
    stages = {stage["name"]: stage for stage in document["stages"]}
    assert [stages[n]["compared"] for n in ("scan_path", "stations", "trajectory")] == [1, 1, 0]
    assert stages["trajectory"]["notes"] and stages["localization"]["notes"]


def test_the_first_stage_that_differs_is_named(recorded: tuple[Path, Part], tmp_path: Path) -> None:
    bag, part = recorded
    document = verify_bag(bag, changed_part(part, tmp_path, standoff_m=0.31))
    assert document["first_difference"] == "scan_path"
    (stage,) = [s for s in document["stages"] if s["name"] == "scan_path"]
    assert any("mm" in text for text in stage["differences"])


@pytest.mark.long
def test_another_choice_of_stations_is_named(recorded: tuple[Path, Part], tmp_path: Path) -> None:
    bag, part = recorded
    document = verify_bag(bag, changed_part(part, tmp_path, station_strategy="rectangles"))
    assert document["first_difference"] == "stations"


def test_another_mesh_is_a_difference(recorded: tuple[Path, Part], tmp_path: Path) -> None:
    other = write_small_part(tmp_path, height_m=0.02)
    document = verify_bag(recorded[0], str(other.source))
    assert document["first_difference"] == "scan_path"
    assert "SHA-256" in str(document["stages"])


def test_what_can_t_be_verified_is_named(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag"):
        pass
    with pytest.raises(BagInvalidError, match="part_uri"):
        verify_bag(tmp_path / "bag")
    assert parsed_changes(["aruco_localizer.images=1"]) == {"aruco_localizer": {"images": 1}}
    for text in ("images=1", "sim_clock.rate_hz=1", "aruco_localizer.images"):
        with pytest.raises(InputError, match="node.parameter=value"):
            parsed_changes([text])


def test_nodes_that_fail_are_named_at_once() -> None:
    """What will never be answered is not waited for to the end of the time."""

    def fail() -> None:
        raise ValueError("no such pose")

    bench = VerifyBench()
    try:
        bench.node.create_timer(0.01, fail)
        with pytest.raises(NotAnsweredError, match=r"the answer .* failed \(no such pose\)"):
            bench.wait(lambda: False, 60.0, "the answer")
    finally:
        bench.close()
