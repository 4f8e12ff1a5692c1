"""The three planning nodes one after the other, and what they refuse."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from skinplan_msgs import msg as messages
from skinplan_msgs.msg import Heartbeat, Status
from skinplan_msgs.srv import PlanScanPath, PlanStations, PlanTrajectories

import meshes
from nodes.bench import Bench
from nodes.small_part import reference, write_small_part
from skinplan.errors import CellInvalidError
from skinplan.inspection.cloud import write_ply
from skinplan.mesh.prepare import prepare_mesh
from skinplan.part.files import save_part
from skinplan.part.model import Part
from skinplan.part.resolve import resolve_part
from skinplan.pipeline import plan_path
from skinplan.plan_record import scan_path_hash, station_hash
from skinplan.robot.cell import CellConfig
from skinplan.scan_path.plan import plan_scan_path
from skinplan.scanner.predict import predict_coverage
from skinplan.scanner.samples import sample_surface
from skinplan.stations.marker_view import MARGIN, MarkerView
from skinplan.stations.plan import plan_stations
from skinplan.trajectory.model import StationTrajectory
from skinplan.transforms import inverse
from skinplan_nodes.conversions import (
    pose_from_msg,
    pose_stamped_to_msg,
    scan_path_from_msg,
    scan_path_to_msg,
    station_plan_from_msg,
    station_trajectory_from_msg,
)
from skinplan_nodes.qos import LATCHED, STATE
from skinplan_nodes.scan_path_planner import ScanPathPlanner
from skinplan_nodes.station_planner import StationPlanner
from skinplan_nodes.trajectory_planner import PlannedStations, TrajectoryPlanner

NAN = float("nan")


@pytest.fixture(scope="module")
def part(tmp_path_factory: pytest.TempPathFactory) -> Part:
    return write_small_part(tmp_path_factory.mktemp("part"))


@pytest.fixture(scope="module")
def bench() -> Iterator[Bench]:
    found = Bench()
    for kind in (ScanPathPlanner, StationPlanner, TrajectoryPlanner):
        found.start(kind, simulated=False)
    yield found
    found.close()
    assert not found.failures


@pytest.fixture(scope="module")
def path(bench: Bench, part: Part) -> messages.ScanPath:
    answer = bench.call(PlanScanPath, "plan_scan_path", PlanScanPath.Request(part=reference(part)))
    assert (answer.status.code, answer.status.message) == (Status.OK, "")
    return answer.path


@pytest.fixture(scope="module")
def plan(bench: Bench, part: Part, path: messages.ScanPath) -> messages.StationPlan:
    request = PlanStations.Request(part=reference(part), path=path)
    request.pose = pose_stamped_to_msg(part.T_map_workpiece, "map")
    answer = bench.call(PlanStations, "plan_stations", request)
    assert (answer.status.code, answer.status.message) == (Status.OK, "")
    return answer.plan


def trajectory_request(part: Part, path: Any, plan: Any) -> PlanTrajectories.Request:
    station = plan.stations[0]
    T_map_arm_base = pose_from_msg(station.pose) @ CellConfig().T_base_link_arm_base
    return PlanTrajectories.Request(
        part=reference(part),
        path=path,
        station_id=station.id,
        pose=pose_stamped_to_msg(inverse(T_map_arm_base) @ part.T_map_workpiece, "arm_base"),
        points=station.points,
    )


def test_path_is_the_library_s(bench: Bench, part: Part, path: messages.ScanPath) -> None:
    prepared = prepare_mesh(part)
    wanted = plan_scan_path(prepared.mesh, prepared.segmentation, part.scan)
    np.testing.assert_array_equal(scan_path_from_msg(path).positions, wanted.positions)
    assert path.mesh_sha256 == part.mesh_sha256
    assert path.triangles == len(prepared.mesh.faces)
    assert 0.9 < path.coverage.area_ratio <= 1.0
    latched = bench.collect(messages.ScanPath, "scan_path", LATCHED)
    bench.wait(lambda: latched)
    assert latched[-1].plan_hash == path.plan_hash


@pytest.mark.parametrize("strategy", ["published", "coverage", "patches"])
def test_service_and_library_have_one_hash(bench: Bench, part: Part, strategy: str) -> None:
    request = PlanScanPath.Request(part=reference(part), strategy=strategy)
    answer = bench.call(PlanScanPath, "plan_scan_path", request)
    assert (answer.status.code, answer.status.message) == (Status.OK, "")
    prepared = prepare_mesh(part)
    settings = replace(part.scan, strategy=strategy)
    wanted = plan_scan_path(prepared.mesh, prepared.segmentation, settings)
    assert answer.path.strategy == strategy
    assert answer.path.plan_hash == scan_path_hash(wanted)
    assert answer.path.lower_bound == wanted.lower_bound
    found = scan_path_from_msg(answer.path)
    for name in ("positions", "directions", "targets", "kinds", "groups"):
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name))
    figures = predict_coverage(
        prepared.mesh, prepared.segmentation, wanted, settings, part.fixture
    ).figures
    assert answer.path.coverage.area_ratio == figures.area_ratio
    whole = answer.path.coverage.regions[0]
    assert whole.name == "whole part"
    assert whole.often_seen_of_seeable_ratio == figures.regions[0].often_seen_of_seeable_ratio
    assert whole.area == pytest.approx(prepared.mesh.area, rel=1e-6)


def test_service_and_library_optimise_passes_alike(
    bench: Bench, part: Part, path: messages.ScanPath, tmp_path: Path
) -> None:
    asked = replace(part, scan=replace(part.scan, optimise_passes=True))
    asked = replace(asked, source=save_part(asked, tmp_path / "part.yaml"))
    request = PlanScanPath.Request(part=reference(asked))
    answer = bench.call(PlanScanPath, "plan_scan_path", request)
    assert (answer.status.code, answer.status.message) == (Status.OK, "")
    wanted = plan_path(prepare_mesh(asked), asked.scan, None, asked.points, asked.fixture)
    assert answer.path.plan_hash == scan_path_hash(wanted) != path.plan_hash
    assert answer.path.coverage.area_ratio >= path.coverage.area_ratio


def test_rescan_plans_what_a_cloud_leaves_out(
    bench: Bench, part: Part, path: messages.ScanPath, tmp_path: Path
) -> None:
    mesh = prepare_mesh(part).mesh
    points = sample_surface(mesh, 0.004).points
    write_ply(tmp_path / "cloud.ply", points[points[:, 0] < 0.1])
    request = PlanScanPath.Request(part=reference(part), seen_cloud=str(tmp_path / "cloud.ply"))
    answer = bench.call(PlanScanPath, "plan_scan_path", request)
    assert (answer.status.code, answer.path.strategy) == (Status.OK, "rescan")
    assert 0 < len(answer.path.points) < len(path.points)
    assert all(point.target.x > -0.1 for point in answer.path.points)
    write_ply(tmp_path / "cloud.ply", points)
    answer = bench.call(PlanScanPath, "plan_scan_path", request)
    assert answer.status.code == Status.NOTHING_MISSING
    for uri in ("cloud.ply", str(tmp_path / "none.ply"), "http://host/cloud.ply"):
        request.seen_cloud = uri
        answer = bench.call(PlanScanPath, "plan_scan_path", request)
        assert answer.status.code == Status.NO_CLOUD, uri
        assert not answer.path.points


def test_findings_of_the_mesh_travel_with_the_path(bench: Bench, tmp_path: Path) -> None:
    surface = meshes.grid(0.5, 0.3, 0.01)
    twice = np.concatenate([surface.faces, surface.faces[:5]])
    trimesh.Trimesh(surface.vertices, twice, process=False).export(tmp_path / "twice.stl")
    part = resolve_part(str(tmp_path / "twice.stl"), "m", tmp_path)
    answer = bench.call(PlanScanPath, "plan_scan_path", PlanScanPath.Request(part=reference(part)))
    assert answer.status.code == Status.OK
    found = {finding.name: finding for finding in answer.findings}
    assert (found["duplicate faces"].count, found["duplicate faces"].action) == (5, "repaired")


@pytest.mark.parametrize("strategy", ["rectangles", "reach", "axial_radial"])
def test_station_service_and_library_have_one_hash(
    bench: Bench, part: Part, path: messages.ScanPath, strategy: str
) -> None:
    request = PlanStations.Request(part=reference(part), path=path, strategy=strategy)
    request.pose = pose_stamped_to_msg(part.T_map_workpiece, "map")
    answer = bench.call(PlanStations, "plan_stations", request)
    assert (answer.status.code, answer.status.message) == (Status.OK, "")
    settings = replace(part.scan, station_strategy=strategy)
    mesh = prepare_mesh(part).mesh
    asked = scan_path_from_msg(path)
    # The pose as the service gets it: a quaternion is not quite the matrix it was made of.
    T_map_workpiece = pose_from_msg(request.pose.pose)
    markers = MarkerView(part.fixture)
    wanted = plan_stations(asked, T_map_workpiece, mesh, settings, CellConfig(), markers=markers)
    assert answer.plan.marker_quality == pytest.approx(0.85 + MARGIN)
    assert answer.plan.strategy == strategy
    assert answer.plan.plan_hash == station_hash(wanted)
    assert answer.plan.lower_bound == wanted.lower_bound
    assert answer.plan.reached_ratio == wanted.reached_ratio
    assert answer.plan.robust_ratio == pytest.approx(wanted.robust_ratio, nan_ok=True)


def test_stations_reach_the_points(
    bench: Bench, path: messages.ScanPath, plan: messages.StationPlan
) -> None:
    found = station_plan_from_msg(plan)
    assigned = [int(p) for station in found.stations for p in station.points]
    left_out = [item.point for item in found.skipped]
    assert sorted(assigned + left_out) == list(range(len(path.points)))
    assert found.reached_ratio > 0.9
    latched = bench.collect(messages.StationPlan, "station_plan", LATCHED)
    bench.wait(lambda: latched)
    assert latched[-1].plan_hash == plan.plan_hash


def test_trajectory_scans_the_points_while_the_heart_beats(
    bench: Bench, part: Part, path: messages.ScanPath, plan: messages.StationPlan
) -> None:
    beats = bench.collect(Heartbeat, "heartbeat", STATE)
    answer = bench.call(PlanTrajectories, "plan_trajectories", trajectory_request(part, path, plan))
    assert (answer.status.code, answer.status.message) == (Status.OK, "")
    found = station_trajectory_from_msg(answer.trajectory)
    scanned = {int(p) for segment in found.segments for p in segment.points}
    skipped = {item.point for item in found.skipped}
    assert scanned | skipped == set(plan.stations[0].points)
    assert not scanned & skipped
    latched = bench.collect(messages.TrajectoryPlan, "trajectory_plan", LATCHED)
    bench.wait(lambda: latched)
    assert [s.station_id for s in latched[-1].stations] == [0]
    bench.wait(lambda: {beat.node for beat in beats} >= {"/trajectory_planner", "/station_planner"})


@pytest.mark.parametrize(
    ("changes", "code", "words"),
    [
        ({"uri": ""}, Status.PART_INVALID, "absolute path"),
        ({"uri": "part.yaml"}, Status.PART_INVALID, "absolute path"),
        ({"uri": "http://host/part.yaml"}, Status.PART_INVALID, "file:// URI"),
        ({"uri": "/no/such/part.yaml"}, Status.PART_NOT_FOUND, "no such file"),
        ({"uri": "/" + 300 * "x"}, Status.PART_NOT_FOUND, "no such file"),
        ({"mesh_sha256": "00" * 32}, Status.MESH_HASH_MISMATCH, "SHA-256"),
    ],
)
def test_a_part_that_is_none_is_refused_by_every_planner(
    bench: Bench, part: Part, path: Any, plan: Any, changes: Any, code: int, words: str
) -> None:
    stations = PlanStations.Request(path=path)
    stations.pose = pose_stamped_to_msg(part.T_map_workpiece, "map")
    requests = [
        (PlanScanPath, "plan_scan_path", PlanScanPath.Request()),
        (PlanStations, "plan_stations", stations),
        (PlanTrajectories, "plan_trajectories", trajectory_request(part, path, plan)),
    ]
    for kind, name, request in requests:
        request.part = reference(part, **changes)
        answer = bench.call(kind, name, request)
        assert answer.status.code == code
        assert words in answer.status.message


def test_unreadable_and_refused_meshes(bench: Bench, part: Part, tmp_path: Path) -> None:
    (tmp_path / "part.yaml").write_text("id: a\nmesh: {file: a.stl, unit: m}\n", encoding="utf-8")
    mesh = tmp_path / "a.stl"
    for content, code in ((None, Status.MESH_NOT_FOUND), (b"no mesh", Status.MESH_UNREADABLE)):
        if content is not None:
            mesh.write_bytes(content)
        request = PlanScanPath.Request(part=messages.PartReference(uri=str(tmp_path / "part.yaml")))
        assert bench.call(PlanScanPath, "plan_scan_path", request).status.code == code


def test_unknown_strategies_are_named(bench: Bench, part: Part, path: Any, plan: Any) -> None:
    paths = PlanScanPath.Request(part=reference(part), strategy="magic")
    stations = PlanStations.Request(part=reference(part), path=path, strategy="magic")
    stations.pose = pose_stamped_to_msg(part.T_map_workpiece, "map")
    trajectories = trajectory_request(part, path, plan)
    trajectories.strategy = "magic"
    for kind, name, request in (
        (PlanScanPath, "plan_scan_path", paths),
        (PlanStations, "plan_stations", stations),
        (PlanTrajectories, "plan_trajectories", trajectories),
    ):
        answer = bench.call(kind, name, request)
        assert answer.status.code == Status.STRATEGY_UNKNOWN
        assert "magic" in answer.status.message


def _changed(path: messages.ScanPath, change: str) -> messages.ScanPath:
    found = scan_path_to_msg(scan_path_from_msg(path))
    found.mesh_sha256 = path.mesh_sha256
    if change == "empty":
        found.points, found.plan_hash = [], ""
    elif change == "frame":
        found.header.frame_id = "map"
    elif change == "nan":
        found.points[0].position.x = NAN
    elif change == "hash":
        found.points[0].position.x += 0.1
    elif change == "mesh":
        found.mesh_sha256 = "00" * 32
    return found


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        ("empty", Status.SCAN_PATH_INVALID, "0 points"),
        ("frame", Status.SCAN_PATH_INVALID, "frame 'workpiece'"),
        ("nan", Status.SCAN_PATH_INVALID, "finite"),
        ("hash", Status.SCAN_PATH_INVALID, "hash"),
        ("mesh", Status.MESH_HASH_MISMATCH, "SHA-256"),
    ],
)
def test_paths_that_are_none(
    bench: Bench, part: Part, path: Any, plan: Any, change: str, code: int, words: str
) -> None:
    stations = PlanStations.Request(part=reference(part), path=_changed(path, change))
    stations.pose = pose_stamped_to_msg(part.T_map_workpiece, "map")
    trajectories = trajectory_request(part, path, plan)
    trajectories.path = stations.path
    for kind, name, request in (
        (PlanStations, "plan_stations", stations),
        (PlanTrajectories, "plan_trajectories", trajectories),
    ):
        answer = bench.call(kind, name, request)
        assert answer.status.code == code
        assert words in answer.status.message


def test_poses_that_are_none(bench: Bench, part: Part, path: Any, plan: Any) -> None:
    stations = PlanStations.Request(part=reference(part), path=path)
    trajectories = trajectory_request(part, path, plan)
    for kind, name, request, frame in (
        (PlanStations, "plan_stations", stations, "map"),
        (PlanTrajectories, "plan_trajectories", trajectories, "arm_base"),
    ):
        request.pose = pose_stamped_to_msg(np.eye(4), "odom")
        answer = bench.call(kind, name, request)
        assert answer.status.code == Status.REQUEST_INVALID
        assert f"frame '{frame}' is accepted, found 'odom'" in answer.status.message
        request.pose.header.frame_id = frame
        request.pose.pose.position.x = NAN
        answer = bench.call(kind, name, request)
        assert answer.status.code == Status.REQUEST_INVALID
        assert "finite" in answer.status.message


def test_points_and_start_states_that_are_none(
    bench: Bench, part: Part, path: Any, plan: Any
) -> None:
    cases: list[tuple[Any, int, str]] = [
        (lambda r: setattr(r, "points", []), Status.SCAN_PATH_INVALID, "0 points"),
        (lambda r: setattr(r, "points", [10**6]), Status.SCAN_PATH_INVALID, "1000000"),
        (lambda r: setattr(r, "points", [0, 0]), Status.SCAN_PATH_INVALID, "each once"),
        (lambda r: setattr(r.start, "name", ["a"]), Status.JOINTS_INVALID, "missing"),
    ]
    for change, code, words in cases:
        request = trajectory_request(part, path, plan)
        change(request)
        answer = bench.call(PlanTrajectories, "plan_trajectories", request)
        assert answer.status.code == code
        assert words in answer.status.message
        assert not answer.trajectory.segments


def test_a_part_out_of_reach_is_no_crash(bench: Bench, part: Part, path: Any, plan: Any) -> None:
    request = trajectory_request(part, path, plan)
    request.pose.pose.position.x = 50.0
    answer = bench.call(PlanTrajectories, "plan_trajectories", request)
    assert answer.status.code == Status.NO_TRAJECTORY
    assert answer.status.message


def test_stations_planned_so_far(path: messages.ScanPath) -> None:
    planned, first = PlannedStations(), scan_path_from_msg(path)
    other = replace(first, strategy="other")

    def add(way: Any, number: int) -> list[int]:
        return [t.station_id for t in planned.add(way, StationTrajectory(number, (), ()))]

    assert [add(first, i) for i in (0, 1, 2)] == [[0], [0, 1], [0, 1, 2]]
    assert add(first, 1) == [0, 1], "what comes behind is of an earlier run"
    assert add(other, 3) == [3], "another path begins anew"


def test_parameters_are_checked_at_the_start() -> None:
    bench = Bench()
    try:
        with pytest.raises(InvalidParameterValueException):
            bench.start(ScanPathPlanner, meshes_kept=0)
        with pytest.raises(InvalidParameterTypeException):
            bench.start(ScanPathPlanner, meshes_kept=2.0)
        with pytest.raises(CellInvalidError, match="no cell file"):
            bench.start(StationPlanner, cell_file="/no/such/cell.yaml")
    finally:
        bench.close()
