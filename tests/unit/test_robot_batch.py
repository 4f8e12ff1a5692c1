"""Reach records of many stations, confirmed by means of their own."""

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

from reach_scene import flat_panel, flat_path, in_arm_base, upright
from skinplan.errors import CancelledError, InputError
from skinplan.robot.arm import ArmModel
from skinplan.robot.batch import ReachEngine
from skinplan.robot.cell import CellConfig, Obstacle
from skinplan.robot.collision import CollisionWorld
from skinplan.robot.exact import touches
from skinplan.robot.reach import Views, reach
from skinplan.robot.tracker import TrackerSight
from skinplan.transforms import apply, inverse, planar, transform

CELL = CellConfig()
HOME = np.array(CELL.home_rad)
TILT = np.radians(15.0)
PATH = flat_path(1.6, 1.0, 0.2)
PANEL = flat_panel(1.6, 1.0)
PLACES = [(0.0, -0.85), (0.3, -0.8), (-0.5, -1.0), (0.9, -0.7), (0.0, -2.0), (0.0, -0.45)]


def engine(cell=CELL, tilt=TILT, path=PATH, sight=None, **more):
    views = (path.positions, path.directions, path.targets)
    return ReachEngine(cell, PANEL, upright(1.0), views, tilt, sight, **more)


def bases(places=PLACES, heading=0.0):
    return np.array([planar(x, y, heading) for x, y in places])


@pytest.fixture(scope="module")
def table():
    return engine().table(bases(), keep_joints=True)


def test_every_record_is_confirmed_by_forward_kinematics_and_a_fresh_collision_check(table):
    """Pinocchio's kinematics and coal's mesh check: nothing of the engine's own."""
    arm = ArmModel.load(CELL)
    data = arm.model.createData()
    number = arm.model.getFrameId("tool0")
    checked = 0
    for station, point in np.argwhere(table.reached):
        record = table.record(station, point)
        pin.framesForwardKinematics(arm.model, data, record.q)
        T = data.oMf[number].homogeneous @ CELL.T_tool0_scanner
        place = in_arm_base(CELL, bases()[station], upright(1.0))
        target = apply(place, PATH.targets[point][None])[0]
        view = place[:3, :3] @ PATH.directions[point]
        assert np.linalg.norm(T[:3, 3] + 0.3 * T[:3, 0] - target) < 1e-8
        assert np.arccos(np.clip(T[:3, 0] @ view, -1, 1)) == pytest.approx(
            record.tilt_rad, abs=1e-6
        )
        assert arm.within_limits(record.q)
        assert record.limit_margin_rad == pytest.approx(
            min((record.q - arm.lower).min(), (arm.upper - record.q).min()), abs=1e-5
        )
        sines = np.abs(np.sin(record.q[[2, 4]]))
        assert record.singularity == pytest.approx(sines.min(), abs=1e-6)
        assert sines[0] >= 0.15 - 1e-9 and sines[1] >= 0.10 - 1e-9
        world = CollisionWorld(CELL, PANEL, place)
        assert world.pair(record.q) is None
        ends = apply(inverse(place), world.bodies.segments(record.q[None])[0].reshape(-1, 3))
        for body, axis in zip(world.bodies.items, ends.reshape(-1, 2, 3), strict=True):
            assert not touches(PANEL, body, axis, CELL.collision_margin_m - 1e-9)
        checked += 1
    assert checked > 100


def test_it_agrees_with_the_search_at_one_station(table):
    """`reach` tilts only where no straight branch is free, be it singular or not, and by halves."""
    for station, pose in enumerate(bases()):
        T = in_arm_base(CELL, pose, upright(1.0))
        world = CollisionWorld(CELL, PANEL, T)
        views = Views.placed(PATH.positions, PATH.directions, PATH.targets, T)
        found = reach(world, views, TILT, HOME)
        clear = np.min(np.abs(np.sin(found.q[:, [2, 4]])) - [0.15, 0.10], axis=1) >= 0.0
        expected = np.isin(np.arange(len(PATH)), found.view[clear])
        assert not np.any(table.reached[station] & ~np.isin(np.arange(len(PATH)), found.view))
        assert np.mean(expected & ~table.reached[station]) < 0.02
        straight = engine(tilt=0.0).table(pose[None]).reached[0]
        only = reach(world, views, 0.0, HOME)
        free = np.min(np.abs(np.sin(only.q[:, [2, 4]])) - [0.15, 0.10], axis=1) >= 0.0
        assert np.array_equal(straight, np.isin(np.arange(len(PATH)), only.view[free]))


def test_reasons(table):
    far, inside = 4, 5
    assert all("no inverse kinematics" in table.record(far, p).reason for p in range(len(PATH)))
    named = [table.record(inside, p) for p in range(len(PATH))]
    assert any(r.collision and r.reason == f"collision of {r.collision}" for r in named)
    assert all(bool(r.reason) != r.reached for r in named)
    engine_ = engine()
    engine_.solver._arm = ArmModel.load(CELL)
    engine_.solver._arm.lower = np.full(6, 9.0)
    engine_.solver._arm.upper = np.full(6, 9.1)
    reasons = {engine_.table(bases()[:1]).record(0, p).reason for p in range(len(PATH))}
    assert "joint limits" in reasons and "" not in reasons


def test_stretched_out_is_too_close_to_singular():
    codes = engine(tilt=0.0).table(bases([(0.0, -y) for y in np.arange(0.9, 1.4, 0.02)]))
    words = {codes.reason(int(code)) for code in np.unique(codes.codes)}
    assert any("singular" in text for text in words)


def test_heading_of_the_base_adds_no_reach(table):
    turned = engine().table(bases(heading=np.radians(20.0)))
    assert np.mean(turned.reached == table.reached) > 0.97  # the base's box turns with it


def test_the_order_of_stations_and_points_does_not_matter(table):
    order = np.array([3, 0, 5, 1, 4, 2])
    again = engine().table(bases()[order])
    assert np.array_equal(again.codes, table.codes[order])


def test_moving_the_shop_changes_nothing(table):
    shift = planar(4.0, -2.0, 2.0)
    views = (PATH.positions, PATH.directions, PATH.targets)
    moved = ReachEngine(CELL, PANEL, shift @ upright(1.0), views, TILT)
    assert np.array_equal(moved.table(shift @ bases()).reached, table.reached)


def test_promising_is_what_is_reached_but_for_limits_and_collisions(table):
    promising = engine().promising(bases())
    straight = table.reached & (table.options == 0)
    assert not np.any(straight & ~promising)
    assert promising.sum() < 1.2 * straight.sum() + 20


def test_a_given_roll_is_kept():
    fixed = engine(roll_rad=0.0)
    table = fixed.table(bases()[:2], keep_joints=True)
    assert table.reached.any()
    arm = ArmModel.load(CELL)
    for station, point in np.argwhere(table.reached & (table.options == 0))[:20]:
        T = arm.forward_scanner(table.q[station, point][None])[0]
        level = (bases()[station] @ CELL.T_base_link_arm_base)[:3, :3] @ T[:3, 1]
        assert abs(level[2]) < 1e-6  # views level, roll 0: the scanner's y is level too
        assert table.record(station, point).roll_rad == 0.0
    assert np.isnan(engine().table(bases()[:1]).rolls).all()


def test_a_scanner_beside_the_tool_axis_is_tried_with_several_rolls():
    aside = CELL.T_tool0_scanner @ transform((0.0, 0.05, 0.0))
    cell = dataclasses.replace(CELL, T_tool0_scanner=aside)
    table = engine(cell=cell, tilt=0.0).table(bases()[:1], keep_joints=True)
    assert len(table.rolls) == 8 and not np.isnan(table.rolls).any()
    arm = ArmModel.load(cell)
    place = in_arm_base(cell, bases()[0], upright(1.0))
    found = np.flatnonzero(table.reached[0])
    T = arm.forward_scanner(table.q[0, found])
    assert len(found) > 20
    assert np.abs(T[:, :3, 3] - apply(place, PATH.positions[found])).max() < 1e-8


def test_an_obstacle_is_in_the_way():
    wall = Obstacle("wall", transform((0.0, -0.45, 1.2)), (3.0, 0.05, 2.4))
    cell = dataclasses.replace(CELL, obstacles=(wall,))
    walled = engine(cell=cell).table(bases([(0.0, -0.9)]))
    assert not walled.reached.any()
    assert any("wall" in walled.reason(int(code)) for code in np.unique(walled.codes))


def test_the_first_joint_keeps_a_margin_for_the_heading_error(table):
    arm = ArmModel.load(CELL)
    wide = engine(first_joint_margin_rad=0.5).table(bases(), keep_joints=True)
    q = wide.q[wide.reached]
    assert np.all(q[:, 0] <= arm.upper[0] - 0.5) and np.all(q[:, 0] >= arm.lower[0] + 0.5)
    assert np.array_equal(wide.reached, table.reached)  # two full turns leave room


def test_another_arm_by_its_urdf():
    cell = dataclasses.replace(CELL, robot="gcr14_1400", home_rad=(0.0, -1.2, -1.5, 1.0, 1.5, 0.0))
    table = engine(cell=cell, tilt=0.0).table(bases([(0.0, -1.1)]), keep_joints=True)
    arm = ArmModel.load(cell)
    found = np.flatnonzero(table.reached[0])
    assert len(found) > 10
    T = arm.forward_scanner(table.q[0, found])
    place = in_arm_base(cell, bases([(0.0, -1.1)])[0], upright(1.0))
    assert np.abs(T[:, :3, 3] - apply(place, PATH.positions[found])).max() < 1e-8
    assert np.all(arm.within_limits(table.q[0, found]))


def test_what_is_no_question_is_refused_and_a_cancelled_one_ends():
    with pytest.raises(InputError, match=r"\(s, 4, 4\)"):
        engine().table(np.eye(4))
    with pytest.raises(InputError, match="finite"):
        engine().table(np.full((1, 4, 4), np.nan))
    with pytest.raises(InputError, match="views"):
        ReachEngine(
            CELL, PANEL, upright(), (PATH.positions[:3], PATH.directions, PATH.targets), 0.1
        )
    with pytest.raises(InputError, match="NaN"):
        bad = PATH.positions * np.nan
        ReachEngine(CELL, PANEL, upright(), (bad, PATH.directions, PATH.targets), 0.1)
    with pytest.raises(CancelledError):
        engine().table(bases(), is_cancelled=lambda: True)
    assert engine().table(np.zeros((0, 4, 4))).codes.shape == (0, len(PATH))


def test_what_the_tracker_can_not_see_is_not_reached(table):
    behind = dataclasses.replace(CELL, T_map_tracker=transform((0.0, 3.0, 1.5)))
    sight = TrackerSight(behind, PANEL, upright(1.0))
    blind = engine(cell=behind, sight=sight).table(bases()[:1])
    assert not blind.reached.any()
    record = blind.record(0, int(np.flatnonzero(table.reached[0])[0]))
    assert record.visible is False and "tracker" in record.reason
    seen = engine(sight=TrackerSight(CELL, PANEL, upright(1.0))).table(bases())
    assert seen.reached.mean() > 0.95 * table.reached.mean()
    assert not np.any(seen.reached & ~table.reached)
    assert seen.record(*np.argwhere(seen.reached)[0]).visible is True
