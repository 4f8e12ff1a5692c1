"""The arm in the 3-D view: its shapes, how it stands at a point, and its nodes in the scene."""

import dataclasses
import importlib.util
import threading

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from reach_scene import UPRIGHT, flat_panel, flat_path
from skinplan.mesh.model import Segmentation
from skinplan.part.model import ScanSettings
from skinplan.robot.arm import ArmModel
from skinplan.robot.bodies import Bodies
from skinplan.robot.cell import CellConfig
from skinplan.robot.shapes import segment_distances
from skinplan.scanner.model import ScannerModel
from skinplan.stations.plan import plan_stations
from skinplan.transforms import apply, inverse, rotate, transform
from skinplan.view.arm_shapes import arm_pose, arm_shapes, capsule_mesh, pedestal_shape, posture
from skinplan.view.browser import BrowserView
from skinplan.view.scene_arm import cone_lines
from skinplan.view.scene_data import SceneData
from skinplan.view.subject import Subject

CELL = CellConfig()
ARM = ArmModel.load(CELL)
SCAN = ScanSettings(station_strategy="reach")
PATH, PANEL = flat_path(1.2, 0.6, 0.3), flat_panel(1.2, 0.6)
HIGH = transform((0.1, 0.05, 1.95), UPRIGHT)
needs_viser = pytest.mark.skipif(
    importlib.util.find_spec("viser") is None, reason="viser is not installed"
)


@pytest.fixture(scope="module")
def subject():
    plan = plan_stations(PATH, HIGH, PANEL, SCAN, CELL)
    assert plan.skipped and plan.records.reached.any()
    return Subject(
        "high", PANEL, Segmentation(np.zeros(len(PANEL.faces), dtype=np.int64), PANEL), path=PATH,
        scanner=ScannerModel.from_settings(SCAN), station_plan=plan, skipped=plan.skipped,
        T_map_workpiece=HIGH, cell=CELL,
    )  # fmt: skip


def volume(mesh):
    return np.einsum("ij,ij->i", mesh.centroids, mesh.face_normals) @ mesh.face_areas / 3


@pytest.mark.parametrize("length", [0.0, 0.05, 1.3])
def test_a_capsule_is_all_that_is_near_its_axis(length):
    rng = np.random.default_rng(5)
    way = rng.normal(size=3)
    start = rng.normal(size=3)
    ends = np.stack([start, start + length * way / np.linalg.norm(way)])
    radius = 0.2
    mesh = capsule_mesh(ends, radius)
    points = np.repeat(mesh.vertices[:, None], 2, axis=1)
    gaps = segment_distances(points, np.broadcast_to(ends, points.shape))
    assert gaps == pytest.approx(radius)
    whole = np.pi * radius**2 * length + 4.0 / 3.0 * np.pi * radius**3
    assert volume(mesh) == pytest.approx(whole, rel=0.05)  # outward normals, closed
    assert mesh.face_areas.min() > 1e-6
    edges = np.sort(np.concatenate([mesh.faces[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))]))
    assert np.all(np.unique(edges, axis=0, return_counts=True)[1] == 2)


def test_the_shapes_are_the_bodies_of_the_collision_check():
    bodies, shapes = Bodies(ARM, CELL), arm_shapes(CELL)
    assert [shape.name for shape in shapes] == bodies.names
    q = np.random.default_rng(1).uniform(-2.0, 2.0, (1, 6))
    frames, segments = ARM.links(q)[0], bodies.segments(q)[0]
    for shape, axis, radius in zip(shapes, segments, bodies.radii, strict=True):
        placed = apply(frames[shape.joint], shape.mesh.vertices)
        points = np.repeat(placed[:, None], 2, axis=1)
        gaps = segment_distances(points, np.broadcast_to(axis, points.shape))
        assert gaps == pytest.approx(radius)
    foot, top = np.sort(pedestal_shape(CELL).vertices[:, 2])[[0, -1]]
    assert foot < CELL.base_size_m[2] < top <= CELL.T_base_link_arm_base[2, 3] + 1e-9


def test_a_reached_point_is_looked_at(subject):
    records = subject.station_plan.records
    T_map = subject.T_map_workpiece
    for station, point in np.argwhere(records.reached):
        shown = posture(subject, int(station), int(point))
        assert shown.reached and "reaches it" in shown.told
        T_map_scanner = arm_pose(subject, int(station)) @ ARM.forward_scanner(shown.q[None])[0]
        T = inverse(T_map) @ T_map_scanner
        gap = PATH.targets[point] - T[:3, 3]
        assert np.linalg.norm(gap) == pytest.approx(0.3, abs=1e-6)
        assert T[:3, 0] == pytest.approx(gap / 0.3, abs=1e-6)
        lean = float(np.arccos(np.clip(T[:3, 0] @ PATH.directions[point], -1.0, 1.0)))
        option = records.record(int(station), int(point))
        assert lean == pytest.approx(option.tilt_rad, abs=1e-6)
        assert ("straight" in shown.told) == (option.tilt_rad == 0.0)


def test_an_unreached_point_has_the_arm_at_home_and_the_reason(subject):
    records = subject.station_plan.records
    for station, point in np.argwhere(~records.reached):
        shown = posture(subject, int(station), int(point))
        assert not shown.reached and np.array_equal(shown.q, CELL.home_rad)
        assert records.reason(int(records.codes[station, point])) in shown.told


@pytest.mark.parametrize("keep", [True, False])
def test_without_joint_positions_the_straight_view_is_solved(subject, keep):
    plan = subject.station_plan
    records = dataclasses.replace(plan.records, q=None) if keep else None
    bare = dataclasses.replace(subject, station_plan=dataclasses.replace(plan, records=records))
    solved = 0
    for point in range(len(PATH)):
        shown = posture(bare, 0, point)
        if not shown.reached:
            assert np.array_equal(shown.q, CELL.home_rad) and "home" in shown.told
            continue
        solved += 1
        scanner = arm_pose(bare, 0) @ ARM.forward_scanner(shown.q[None])[0]
        wanted = apply(HIGH, PATH.positions[point : point + 1])[0]
        assert scanner[:3, 3] == pytest.approx(wanted, abs=1e-8)
        assert ARM.within_limits(shown.q)
    assert 0 < solved < len(PATH)


def test_the_cone_has_the_tracker_s_angle_and_range():
    lines = cone_lines(CELL, CELL.tracker.range_min_m, CELL.tracker.range_max_m).reshape(-1, 3)
    distance = np.linalg.norm(lines, axis=1)
    assert np.arccos(lines[:, 0] / distance) == pytest.approx(CELL.tracker.cone_rad)
    assert set(np.round(distance, 9)) == {CELL.tracker.range_min_m, CELL.tracker.range_max_m}
    assert len(cone_lines(CELL, 0.0, 0.8)) < len(lines) / 2


def wait_for(condition):
    waited = threading.Event()
    for _ in range(200):
        if condition():
            return
        waited.wait(0.05)
    raise AssertionError("not within 10 s")


def pose_of(handle):
    w, x, y, z = handle.wxyz
    return transform(handle.position, Rotation.from_quat([x, y, z, w]).as_matrix())


@needs_viser
def test_the_nodes_agree_with_the_forward_kinematics(subject):
    shown = subject
    owner = shown.station_of_points()
    with BrowserView(SceneData(shown), 0) as view:
        scene = view.scene
        assert {"arm", "tracker", "line of sight"} <= set(scene.layers)
        assert not scene.layers["tracker's range and cone"][0].visible
        point = int(np.flatnonzero(owner == owner.max())[-1])
        scene.slider.value = point
        wait_for(lambda: scene.station_slider.value == owner.max())
        wait_for(lambda: scene.arm.posture.reached)
        station = int(owner[point])
        wanted = posture(shown, station, point)
        wait_for(lambda: np.array_equal(scene.arm.posture.q, wanted.q))
        T_map_arm = arm_pose(shown, station)
        wait_for(lambda: np.allclose(pose_of(scene.arm.base), T_map_arm, atol=1e-5))
        links = ARM.links(wanted.q[None])[0]
        last = scene.arm.joints[-1]
        wait_for(lambda: np.allclose(pose_of(last), links[-1], atol=1e-5))
        for handle, pose in zip(scene.arm.joints, links, strict=True):
            assert pose_of(handle) == pytest.approx(pose, abs=1e-5)
        T_map_scanner = pose_of(scene.arm.base) @ pose_of(last) @ pose_of(scene.arm.scanner)
        assert T_map_scanner == pytest.approx(
            T_map_arm @ ARM.forward_scanner(wanted.q[None])[0], abs=1e-5
        )
        look = rotate(HIGH, PATH.directions[point : point + 1])[0]
        assert T_map_scanner[:3, 0] @ look > np.cos(SCAN.tilt_max_rad + 1e-6)
        sight = np.array(scene.arm.sight.points)[0]
        assert sight[0] == pytest.approx(CELL.T_map_tracker[:3, 3], abs=1e-5)
        assert sight[1] == pytest.approx(T_map_scanner[:3, 3], abs=1e-5)
        scene.checkboxes["arm"].value = False
        wait_for(lambda: not scene.arm.base.visible)


@needs_viser
def test_the_arm_goes_where_the_second_slider_says(subject):
    shown = subject
    assert len(shown.station_plan.stations) > 1
    with BrowserView(SceneData(shown), 0) as view:
        scene = view.scene
        last = len(shown.station_plan.stations) - 1
        scene.station_slider.value = last
        place = arm_pose(shown, last)[:3, 3]
        wait_for(lambda: np.allclose(scene.arm.base.position, place, atol=1e-5))
        missing = shown.skipped[0].point
        scene.slider.value = missing
        wait_for(lambda: not scene.arm.posture.reached)
        wait_for(lambda: np.allclose(scene.arm.base.position, place, atol=1e-5))
        home = ARM.links(np.array([CELL.home_rad]))[0, -1]
        wait_for(lambda: np.allclose(pose_of(scene.arm.joints[-1]), home, atol=1e-5))
