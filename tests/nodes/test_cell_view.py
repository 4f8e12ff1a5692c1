"""What RViz and Foxglove show: markers of plan and part, description and frames of the robot."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from skinplan_msgs import msg as messages
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from nodes.bench import Bench
from nodes.small_part import write_small_part
from skinplan.mesh.prepare import prepare_mesh
from skinplan.pipeline import plan_path
from skinplan.robot.arm import ArmModel
from skinplan.robot.cell import load_cell
from skinplan.robot.urdf import DrawnRobot
from skinplan.stations.model import Station, StationPlan
from skinplan_nodes.cell_markers import frustum_markers, station_markers
from skinplan_nodes.cell_view import CellView
from skinplan_nodes.conversions import PathFacts, scan_path_to_msg, transform_stamped_from_msg
from skinplan_nodes.qos import LATCHED, STATE


def all_of(array: MarkerArray, kind: int) -> list[Marker]:
    return [marker for marker in array.markers if marker.type == kind and marker.action == 0]


def test_part_path_and_coverage_are_drawn(bench: Bench, tmp_path: Path) -> None:
    part = write_small_part(tmp_path)
    prepared = prepare_mesh(part)
    path = plan_path(prepared, part.scan, None, part.points, part.fixture)
    facts = PathFacts(part.id, part.mesh_sha256, len(prepared.mesh.faces), prepared.mesh.area)
    publisher = bench.tester.create_publisher(messages.ScanPath, "scan_path", LATCHED)
    publisher.publish(scan_path_to_msg(path, facts, 1.0))
    bench.start(CellView, simulated=False, part_uri=str(part.source))
    drawn = {
        name: bench.collect_before(MarkerArray, f"view/{name}", LATCHED)
        for name in ("part", "scan_path", "frusta", "coverage")
    }
    bench.wait(lambda: all(drawn.values()))
    (surface,) = all_of(drawn["part"][0], Marker.TRIANGLE_LIST)
    assert len(surface.points) == 3 * len(prepared.mesh.faces)
    dots = all_of(drawn["scan_path"][0], Marker.SPHERE_LIST)
    assert sum(len(marker.points) for marker in dots) == len(path)
    (views,) = all_of(drawn["coverage"][0], Marker.POINTS)
    assert len(views.colors) == len(views.points) > 100
    assert all(m.frame_locked for a in drawn.values() for m in a[0].markers if m.action == 0)


def test_a_viewing_volume_has_its_ends_where_the_scanner_measures(tmp_path: Path) -> None:
    part = write_small_part(tmp_path)
    path = plan_path(prepare_mesh(part), part.scan, None, part.points, part.fixture)
    (volume,) = all_of(frustum_markers(path, part.scan), Marker.LINE_LIST)
    ends = np.array([(p.x, p.y, p.z) for p in volume.points]).reshape(len(path), -1, 3)
    along = np.einsum("pnk,pk->pn", ends - path.positions[:, None], path.directions)
    assert np.isclose(along.min(), part.scan.range_min_m)
    assert np.isclose(along.max(), part.scan.range_max_m)
    off = ends - path.positions[:, None] - along[:, :, None] * path.directions[:, None]
    assert np.allclose(np.linalg.norm(off, axis=2), part.scan.field_radius_m)


def station_plan(station: Station) -> StationPlan:
    return StationPlan(
        strategy="reach",
        stations=(station,),
        candidates=1,
        lower_bound=1,
        proven_optimal=True,
        reached_ratio=1.0,
        skipped=(),
    )


def test_stations_are_drawn_where_the_base_stands() -> None:
    T = np.eye(4)
    T[:3, 3] = 1.0, 2.0, 0.0
    plan = station_plan(Station(0, T, np.array([1, 2])))
    (body,) = all_of(station_markers(plan), Marker.CUBE)
    assert (body.header.frame_id, body.pose.position.x, body.pose.position.y) == ("map", 1.0, 2.0)
    (label,) = all_of(station_markers(plan), Marker.TEXT_VIEW_FACING)
    assert label.text == "station 1: 2 points"


def test_links_of_the_description_are_where_the_arm_model_has_them(bench: Bench) -> None:
    cell = load_cell(None)
    arm, robot = ArmModel.load(cell), DrawnRobot(cell)
    generator = np.random.default_rng(5)
    for q in generator.uniform(-3.0, 3.0, (20, 6)):
        found = {robot.root: np.eye(4)}
        for parent, child, T in robot.links(dict(zip(arm.joint_names, q, strict=True))):
            found[child] = found[parent] @ T
        assert np.allclose(found["tool0"], arm.forward(q[None])[0], atol=1e-9)
    links = ElementTree.fromstring(robot.text)
    drawn = {link.get("name") for link in links.iter("link") if link.find("visual") is not None}
    assert {"arm_base", "upper_arm_link", "scanner"} <= drawn


def test_description_and_frames_of_the_links(bench: Bench) -> None:
    states = bench.tester.create_publisher(JointState, "joint_states", STATE)
    bench.start(CellView, simulated=False, tf_rate_hz=50.0)
    texts = bench.collect_before(String, "robot_description", QoSProfile(depth=1, durability=1))
    frames = bench.collect_before(TFMessage, "tf", STATE)
    bench.wait(lambda: texts)
    assert texts[0].data.startswith("<robot")
    names = ArmModel.load(load_cell(None)).joint_names
    state = JointState(name=list(names), position=[0.3] * 6)
    state.header.stamp.sec = 7
    bench.wait(lambda: states.publish(state) or frames)
    edges = {e[1]: e for e in map(transform_stamped_from_msg, frames[0].transforms)}
    assert "shoulder_link" in edges and "tool0" not in edges
    assert edges["shoulder_link"][0] == "arm_base" and edges["shoulder_link"][3] == 7.0
