import dataclasses

import numpy as np
import pytest

from meshes import grid
from reach_scene import flat_panel, flat_path, in_arm_base, path_of, problems, upright
from skinplan.errors import (
    CancelledError,
    InputError,
    JointsInvalidError,
    NoTrajectoryError,
    ScanPathInvalidError,
    StartStateError,
    StrategyUnknownError,
)
from skinplan.mesh.check import check_mesh
from skinplan.mesh.load import load_mesh
from skinplan.mesh.segment import segment_mesh
from skinplan.part.defaults import default_placement
from skinplan.part.model import ScanSettings
from skinplan.part.samples import write_sample
from skinplan.robot.arm import ArmModel
from skinplan.robot.cell import CellConfig, Obstacle
from skinplan.robot.collision import CollisionWorld
from skinplan.scan_path.model import FEATURE
from skinplan.scan_path.plan import plan_scan_path
from skinplan.stations.plan import plan_stations
from skinplan.trajectory.cycle import cycle_time
from skinplan.trajectory.model import SCAN as SCANNING
from skinplan.trajectory.model import TRANSIT
from skinplan.trajectory.plan import plan_station_trajectory, plan_trajectories
from skinplan.transforms import apply, inverse, planar, transform
from trajectory_checker import check_station

CELL = CellConfig()
SCAN = ScanSettings()
PATH = flat_path(1.0, 0.6, 0.1)
PANEL = flat_panel(1.0, 0.6)
STAND = planar(0.0, -0.9, 0.0)
T = in_arm_base(CELL, STAND, upright(0.6))
ALL = np.arange(len(PATH))


def plan(path=PATH, points=ALL, T=T, mesh=PANEL, settings=SCAN, cell=CELL, **more):
    return plan_station_trajectory(path, points, T, mesh, settings, cell, **more)


@pytest.fixture(scope="module")
def flat_plan():
    return plan()


def scanned(trajectory):
    return np.concatenate([s.points for s in trajectory.segments])


def test_a_flat_panel_is_scanned_whole_and_nothing_is_wrong_with_it(flat_plan):
    found = flat_plan
    assert problems(found, PATH, T, PANEL, SCAN, CELL) == []
    assert sorted(scanned(found)) == ALL.tolist() and not found.skipped
    assert found.breaks == 0
    kinds = [s.kind for s in found.segments]
    assert kinds == [TRANSIT, SCANNING, TRANSIT]
    assert all(len(s.points) == 0 for s in found.segments if s.kind == TRANSIT)


def test_the_time_of_each_point_is_when_the_scanner_is_there(flat_plan):
    found = flat_plan
    segment = found.segments[1]
    assert segment.point_s.shape == segment.points.shape
    assert segment.point_s[0] == 0.0 and segment.point_s[-1] == pytest.approx(segment.duration_s)
    assert np.all(np.diff(segment.point_s) > 0.0)
    q = np.stack([np.interp(segment.point_s, segment.times, c) for c in segment.positions.T], 1)
    there = (inverse(T) @ ArmModel.load(CELL).forward_scanner(q))[:, :3, 3]
    assert np.linalg.norm(there - PATH.positions[segment.points], axis=1).max() < 2e-3


@pytest.mark.parametrize("strategy", ["published", "tour"])
def test_it_says_how_good_the_order_of_visit_is(strategy):
    found = plan(settings=dataclasses.replace(SCAN, order_strategy=strategy))
    assert found.order == strategy
    if strategy == "published":
        assert np.isnan([found.order_cost, found.order_bound]).all(), "nothing was made small"
    else:
        assert 0.0 < found.order_bound <= found.order_cost + 1e-9


def test_rows_are_driven_near_the_speed_limit(flat_plan):
    found = flat_plan
    length = np.linalg.norm(np.diff(PATH.positions[scanned(found)], axis=0), axis=1).sum()
    assert found.scan_s < 1.35 * length / SCAN.tcp_speed_m_s
    assert found.tcp_path_m == pytest.approx(length, rel=0.05)


@pytest.mark.parametrize("seed", range(3))
def test_after_the_base_has_stopped_beside_its_goal_it_is_fine_too(seed):
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0, 2 * np.pi)
    error = planar(0.1 * np.cos(angle), 0.1 * np.sin(angle), rng.choice([-1, 1]) * np.radians(1.0))
    beside = in_arm_base(CELL, STAND @ error, upright(0.6))
    found = plan(T=beside)
    assert problems(found, PATH, beside, PANEL, SCAN, CELL) == []
    assert len(found.skipped) == 0


def steep_bump():
    def height(x, y):
        r = np.hypot(x, y)
        return 0.08 * np.clip((0.22 - r) / 0.05, 0.0, 1.0)

    mesh = grid(1.0, 0.6, 0.01, height)
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    side = np.stack([np.cos(angle), np.sin(angle), np.full(12, 0.9)], axis=1)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    targets = np.stack([0.2 * np.cos(angle), 0.2 * np.sin(angle), np.full(12, 0.04)], axis=1)
    rows = [i for i in ALL if np.hypot(*PATH.targets[i, :2]) > 0.3]
    path = path_of(
        np.vstack([PATH.targets[rows], targets]),
        np.vstack([PATH.directions[rows], -side]),
        np.append(PATH.kinds[rows], np.full(12, FEATURE)),
        np.append(PATH.groups[rows], np.ones(12)),
    )
    return mesh, path


def test_a_bump_with_views_from_all_sides():
    mesh, path = steep_bump()
    found = plan(path, np.arange(len(path)), mesh=mesh)
    assert problems(found, path, T, mesh, SCAN, CELL) == []
    assert sorted([*scanned(found), *(s.point for s in found.skipped)]) == list(range(len(path)))
    assert len(found.skipped) <= 2


def test_single_points_are_looked_at_for_a_moment():
    far_apart = np.array([0, 10])
    found = plan(points=far_apart)
    assert sorted(scanned(found)) == far_apart.tolist()
    alone = plan(points=np.array([37]))
    assert problems(alone, PATH, T, PANEL, SCAN, CELL) == []
    segment = next(s for s in alone.segments if s.kind == SCANNING)
    assert segment.duration_s >= 0.1 and segment.points.tolist() == [37]


def test_points_out_of_reach_are_skipped_with_a_reason_and_the_rest_is_scanned():
    path, panel = flat_path(3.0, 0.4, 0.2), flat_panel(3.0, 0.4)
    there = in_arm_base(CELL, STAND, upright(0.4))
    found = plan(path, np.arange(len(path)), there, panel)
    assert problems(found, path, there, panel, SCAN, CELL) == []
    skipped = {s.point: s.reason for s in found.skipped}
    assert {p for p in range(len(path)) if abs(path.positions[p, 0]) > 1.2} <= set(skipped)
    assert all(skipped.values())
    assert sorted([*scanned(found), *skipped]) == list(range(len(path)))


def test_it_begins_where_the_arm_is():
    start = np.array(CELL.home_rad) + [0.3, 0.1, -0.2, 0.1, 0.0, 0.4]
    found = plan(start=start)
    assert problems(found, PATH, T, PANEL, SCAN, CELL, start) == []


def test_the_same_question_has_the_same_answer():
    mesh, path = steep_bump()
    a, b = (plan(path, np.arange(len(path)), mesh=mesh) for _ in range(2))
    assert len(a.segments) == len(b.segments)
    for first, second in zip(a.segments, b.segments, strict=True):
        assert np.array_equal(first.positions, second.positions)
        assert np.array_equal(first.times, second.times)


def test_a_start_in_collision_or_out_of_limits_is_refused():
    into_the_part = np.array([np.pi / 2, 0.0, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(StartStateError, match="collision"):
        plan(start=into_the_part)
    with pytest.raises(StartStateError, match="limits"):
        plan(start=np.array([7.0, -2.4, 2.1, 0.3, 1.4, 0.0]))
    with pytest.raises(JointsInvalidError):
        plan(start=np.zeros(5))
    with pytest.raises(JointsInvalidError):
        plan(start=np.full(6, np.nan))


def test_nothing_to_scan_is_an_error_that_says_why():
    away = in_arm_base(CELL, planar(0.0, -4.0, 0.0), upright(0.6))
    with pytest.raises(NoTrajectoryError, match="no inverse kinematics"):
        plan(T=away)
    with pytest.raises(NoTrajectoryError, match="no points"):
        plan(points=np.zeros(0, dtype=int))


def test_an_obstacle_that_closes_the_way_leaves_points_out_but_no_motion_unchecked():
    """A second skin between arm and part."""
    wall = grid(1.0, 0.6, 0.05)
    both = dataclasses.replace(
        PANEL,
        vertices=np.vstack([PANEL.vertices, wall.vertices + [0.0, 0.0, 0.33]]),
        faces=np.vstack([PANEL.faces, wall.faces + len(PANEL.vertices)]),
    )
    with pytest.raises(NoTrajectoryError):
        plan(mesh=both)


def station_of(cell, **more):
    """A plan that knows where the arm stands in the shop, so the cell's obstacles are there."""
    T_arm_base_map = inverse(STAND @ CELL.T_base_link_arm_base)
    return plan(cell=cell, T_arm_base_map=T_arm_base_map, **more)


def obstacle(name, low, high):
    """A box in the shop between two corners."""
    low, high = np.array(low, float), np.array(high, float)
    return Obstacle(name, transform(0.5 * (low + high)), tuple(high - low))


def in_shop(points):
    """Where the scanner is to be in the shop, shape (n, 3) [m]."""
    return apply(upright(0.6), PATH.positions[points])


SPARSE = ALL[(ALL % 11 % 2 == 0) & (ALL // 11 % 2 == 0)]


def test_an_obstacle_before_a_part_of_the_points_leaves_these_out_by_name():
    """A crate where the scanner would have to be, for the points on the right."""
    places = in_shop(SPARSE)
    right = SPARSE[places[:, 0] > 0.25]
    there = in_shop(right)
    crate = obstacle("crate", there.min(axis=0) - 0.02, there.max(axis=0) + [0.3, 0.02, 0.02])
    cell = dataclasses.replace(CELL, obstacles=(crate,))
    found = station_of(cell, points=SPARSE)
    skipped = {s.point: s.reason for s in found.skipped}
    assert set(right) <= set(skipped) < set(SPARSE)
    assert all("crate" in skipped[p] or "motion" in skipped[p] for p in right)
    assert sorted([*scanned(found), *skipped]) == SPARSE.tolist()
    assert len(scanned(found)) >= 0.5 * len(SPARSE)
    T_arm_base_map = inverse(STAND @ CELL.T_base_link_arm_base)
    world = CollisionWorld(cell, PANEL, T, T_arm_base_map)
    for segment in found.segments:
        assert np.all(world.free(world.dense(segment.positions)[0]))
    assert check_station(found, PATH, T, PANEL, SCAN, cell, None, T_arm_base_map) == []
    # Without its place the crate is not there: then all of them are scanned.
    assert not plan(points=SPARSE, cell=cell).skipped


def test_an_obstacle_around_everything_is_an_error_that_names_it():
    there = in_shop(SPARSE)
    crate = obstacle("crate", there.min(axis=0) - 0.05, there.max(axis=0) + 0.05)
    cell = dataclasses.replace(CELL, obstacles=(crate,))
    with pytest.raises(NoTrajectoryError, match="none of the 24 points can be scanned.*crate"):
        station_of(cell, points=SPARSE)


def test_a_home_or_a_start_in_an_obstacle_is_refused_by_name():
    arm_map = inverse(STAND @ CELL.T_base_link_arm_base)
    scanner = ArmModel.load(CELL).forward_scanner(np.array([CELL.home_rad]))[0, :3, 3]
    place = apply(inverse(arm_map), scanner[None])[0]
    cell = dataclasses.replace(CELL, obstacles=(obstacle("shelf", place - 0.05, place + 0.05),))
    with pytest.raises(StartStateError, match="home position.*in collision.*shelf"):
        station_of(cell, points=SPARSE)
    away = np.array(CELL.home_rad) + [0.9, 0.0, 0.0, 0.0, 0.0, 0.0]
    scanner = ArmModel.load(CELL).forward_scanner(away[None])[0, :3, 3]
    place = apply(inverse(arm_map), scanner[None])[0]
    cell = dataclasses.replace(CELL, obstacles=(obstacle("shelf", place - 0.05, place + 0.05),))
    with pytest.raises(StartStateError, match="start position.*in collision.*shelf"):
        station_of(cell, points=SPARSE, start=away)


@pytest.mark.parametrize("joint", range(6))
def test_a_start_out_of_any_joints_limits_is_refused(joint):
    arm = ArmModel.load(CELL)
    for limit, side in ((arm.lower, -1.0), (arm.upper, 1.0)):
        start = np.array(CELL.home_rad)
        start[joint] = limit[joint] + side * 0.01
        with pytest.raises(StartStateError, match="start position.*out of the joint limits"):
            plan(points=SPARSE, start=start)


def test_a_tour_of_a_flat_panel_has_no_breaks_and_straight_views_only():
    found = plan(settings=dataclasses.replace(SCAN, order_strategy="tour"))
    assert found.breaks == 0 and not found.skipped
    assert sorted(scanned(found)) == ALL.tolist()
    segment = next(s for s in found.segments if s.kind == SCANNING)
    q = np.stack([np.interp(segment.point_s, segment.times, c) for c in segment.positions.T], 1)
    frames = inverse(T) @ ArmModel.load(CELL).forward_scanner(q)
    lean = np.linalg.norm(frames[:, :3, 0] - PATH.directions[segment.points], axis=1)
    # A tilted view would lean by half of the largest tilt at least.
    assert lean.max() < 0.05 * SCAN.tilt_max_rad


def test_bad_requests_are_refused():
    with pytest.raises(ScanPathInvalidError, match="0.."):
        plan(points=np.array([0, len(PATH)]))
    with pytest.raises(StrategyUnknownError, match="published"):
        plan(settings=dataclasses.replace(SCAN, order_strategy="random"))
    with pytest.raises(InputError, match="T_arm_base_workpiece"):
        plan(T=np.full((4, 4), np.nan))


def test_it_tells_how_far_it_is_and_stops_when_asked():
    told = []
    plan(progress=lambda share, text: told.append((share, text)))
    assert [s for s, _ in told] == sorted(s for s, _ in told) and told[-1][0] == 1.0
    with pytest.raises(CancelledError):
        plan(is_cancelled=lambda: True)
    told.clear()
    with pytest.raises(CancelledError):
        plan(progress=lambda share, text: told.append(text), is_cancelled=lambda: True)
    assert told == ["inverse kinematics"], "the joint branches were not found to the end"


def test_a_scanner_beside_the_tool_axis_is_driven_too():
    aside = CELL.T_tool0_scanner.copy()
    aside[:3, 3] += (0.05, 0.0, 0.0)
    cell = dataclasses.replace(CELL, T_tool0_scanner=aside)
    points = ALL[(np.abs(PATH.positions[:, 0]) < 0.16) & (np.abs(PATH.positions[:, 1]) < 0.11)]
    found = plan(points=points, cell=cell)
    assert problems(found, PATH, T, PANEL, SCAN, cell) == []
    assert sorted(scanned(found)) == points.tolist()


def whole(part_mesh, path, T_map_workpiece, scan):
    stations = plan_stations(path, T_map_workpiece, part_mesh, scan, CELL)
    found = plan_trajectories(path, stations, T_map_workpiece, part_mesh, scan, CELL)
    require_no_violation(part_mesh, path, T_map_workpiece, scan, stations, found)
    return stations, found


def require_no_violation(part_mesh, path, T_map_workpiece, scan, stations, found):
    for station, trajectory in zip(stations.stations, found, strict=True):
        there = in_arm_base(CELL, station.T_map_base_link, T_map_workpiece)
        assert problems(trajectory, path, there, part_mesh, scan, CELL) == []
        assert trajectory.station_id == station.id
        given = [*scanned(trajectory), *(s.point for s in trajectory.skipped)]
        assert sorted(given) == station.points.tolist()


@pytest.mark.parametrize(
    ("strategy", "cycle_s"),
    [
        pytest.param("published", (200.0, 400.0), marks=pytest.mark.long),
        ("coverage", (80.0, 160.0)),
    ],
)
def test_the_hardest_scene_is_driven_without_violation(scene_plan, strategy, cycle_s):
    plan = scene_plan("scene4", strategy=strategy)
    part, path = plan.part, plan.path
    scan, stations, found = part.scan, plan.station_plan, plan.trajectories
    require_no_violation(plan.prepared.mesh, path, part.T_map_workpiece, scan, stations, found)
    assert sum(len(t.skipped) for t in found) <= 0.02 * len(path)
    cycle = cycle_time(stations, found, CELL, scan, path)
    assert cycle_s[0] < cycle.cycle_s < cycle_s[1]
    assert cycle.lower_bound_s < cycle.scan_s


@pytest.mark.long
@pytest.mark.parametrize("name", ["scene1", "scene2", "scene3"])
def test_the_other_scenes_are_driven_without_violation(tmp_path, name):
    part = write_sample(name, tmp_path)
    mesh, _ = check_mesh(load_mesh(part.mesh_path, part.unit))
    path = plan_scan_path(mesh, segment_mesh(mesh), part.scan)
    _, found = whole(mesh, path, part.T_map_workpiece, part.scan)
    assert sum(len(t.skipped) for t in found) <= 0.02 * len(path)


@pytest.mark.parametrize(
    "name",
    [
        "crm_fuselage_side_2.9x0.8",
        pytest.param("d150_nose_rippled_1.8x0.8", marks=pytest.mark.long),
    ],
)
def test_real_panels_are_driven_without_violation(shared_data, name):
    mesh, _ = check_mesh(load_mesh(shared_data / "panels" / f"{name}.stl", "m"))
    path = plan_scan_path(mesh, segment_mesh(mesh), SCAN)
    _, found = whole(mesh, path, default_placement(mesh.bounds), SCAN)
    assert sum(len(t.skipped) for t in found) <= 0.05 * len(path)


def test_cycle_time_adds_up():
    path, panel = flat_path(2.0, 0.4, 0.2), flat_panel(2.0, 0.4)
    stations = plan_stations(path, upright(0.4), panel, SCAN, CELL)
    found = plan_trajectories(path, stations, upright(0.4), panel, SCAN, CELL)
    cycle = cycle_time(stations, found, CELL, SCAN, path)
    places = np.array([s.T_map_base_link[:3, 3] for s in stations.stations])
    way = np.linalg.norm(np.diff(places, axis=0), axis=1).sum()
    assert cycle.base_s == pytest.approx(way / CELL.base_speed_m_s + len(places) * CELL.settle_s)
    assert cycle.cycle_s == pytest.approx(cycle.scan_s + cycle.transit_s + cycle.base_s)
    # Three rows of 2 m, each cut once between the two stations (0.2 m).
    assert cycle.lower_bound_s == pytest.approx(3 * 2.0 / SCAN.tcp_speed_m_s)
    assert cycle.breaks == sum(t.breaks for t in found)
