import dataclasses

import numpy as np
import pytest

from reach_scene import flat_panel, flat_path, in_arm_base, upright
from skinplan.robot.cell import CellConfig
from skinplan.robot.collision import CollisionWorld
from skinplan.robot.reach import Views, nearest_solutions, nearest_winding, reach, solve_views
from skinplan.transforms import planar, transform

CELL = CellConfig()
HOME = np.array(CELL.home_rad)
TILT = np.radians(15.0)


def scene(distance=0.85, height=0.8, cell=CELL):
    path = flat_path(1.6, height, 0.2)
    T = in_arm_base(cell, planar(0.0, -distance, 0.0), upright(height))
    views = Views.placed(path.positions, path.directions, path.targets, T)
    return CollisionWorld(cell, flat_panel(1.6, height), T), views


def test_every_solution_shows_the_scanner_at_its_view_free_and_within_limits():
    world, views = scene()
    found = reach(world, views, TILT, HOME)
    frames = world.arm.forward_scanner(found.q)
    assert np.abs(frames[:, :3, 3] - found.positions).max() < 1e-8
    assert np.abs(frames[:, :3, 0] - found.directions).max() < 1e-8
    assert np.all(world.free(found.q)) and np.all(world.arm.within_limits(found.q))
    assert np.all(np.diff(found.view) >= 0)
    assert np.allclose(found.q[:, 5], HOME[5])  # roll is free: the last joint rests


def test_reached_and_not_reached_are_everything():
    world, views = scene()
    found = reach(world, views, 0.0, HOME)
    assert sorted(set(found.view.tolist()) | set(found.reasons)) == list(range(len(views)))
    assert not set(found.view.tolist()) & set(found.reasons)


def test_tilt_adds_reach_and_turns_about_the_target():
    world, views = scene(height=1.4)
    straight = reach(world, views, 0.0, HOME)
    leaning = reach(world, views, TILT, HOME)
    more = set(leaning.view.tolist()) - set(straight.view.tolist())
    assert more and not set(straight.view.tolist()) - set(leaning.view.tolist())
    for state in np.flatnonzero(np.isin(leaning.view, list(more))):
        view = leaning.view[state]
        gap = views.targets[view] - leaning.positions[state]
        assert np.isclose(np.linalg.norm(gap), 0.3)
        assert np.allclose(gap / 0.3, leaning.directions[state])
        lean = np.arccos(leaning.directions[state] @ views.directions[view])
        assert np.isclose(lean, TILT) or np.isclose(lean, 0.5 * TILT)
    kept = np.isin(leaning.view, straight.view)
    assert np.allclose(leaning.positions[kept], views.positions[leaning.view[kept]])


def test_reasons_say_what_is_wrong():
    world, views = scene(distance=3.0)
    found = reach(world, views, TILT, HOME)
    assert not len(found.view)
    assert all("no inverse kinematics" in reason for reason in found.reasons.values())
    world, views = scene(distance=0.35)
    assert any(
        r.startswith("collision of ") for r in reach(world, views, 0.0, HOME).reasons.values()
    )


def test_limits_that_exclude_everything_are_named():
    world, views = scene()
    world.arm.lower = np.full(6, 9.0)
    world.arm.upper = np.full(6, 9.1)
    found = reach(world, views, TILT, HOME)
    assert not len(found.view) and "joint limits" in found.reasons.values()


def test_a_scanner_beside_the_tool_axis_is_reached_with_several_rolls():
    aside = CELL.T_tool0_scanner @ transform((0.0, 0.05, 0.0))
    cell = dataclasses.replace(CELL, T_tool0_scanner=aside)
    world, views = scene(cell=cell)
    found = reach(world, views, 0.0, HOME)
    frames = world.arm.forward_scanner(found.q)
    assert np.abs(frames[:, :3, 3] - found.positions).max() < 1e-8
    assert len(np.unique(found.rolls)) == 8


def test_nearest_winding_is_within_half_a_turn_and_the_same_angle():
    q = np.random.default_rng(0).uniform(-20, 20, (100, 6))
    found = nearest_winding(q, HOME)
    assert np.all(np.abs(found - HOME) <= np.pi + 1e-9)
    assert np.allclose(np.sin(found), np.sin(q))


@pytest.mark.parametrize("angle", [0.05, 0.2])
@pytest.mark.parametrize("sides", [1, 4, 8, 16])
def test_tilted_views_look_at_the_same_target_from_as_far_from_evenly_spread_sides(angle, sides):
    _, views = scene()
    which = np.array([3, 0, 17])
    leaned = views.tilted(which, angle, sides)
    assert len(leaned) == 3 * sides and np.array_equal(leaned.reference, views.reference)
    targets = np.repeat(views.targets[which], sides, axis=0)
    planned = np.repeat(views.directions[which], sides, axis=0)
    assert np.array_equal(leaned.targets, targets)
    assert np.abs(leaned.positions + 0.3 * leaned.directions - targets).max() < 1e-12
    assert np.einsum("ni,ni->n", leaned.directions, planned) == pytest.approx(np.cos(angle))
    across = leaned.directions - np.cos(angle) * planned
    for part in across.reshape(3, sides, 3) / np.sin(angle):
        # Neighbours are an even share of a turn apart; of several sides all cancel out.
        turn = np.einsum("si,si->s", part, np.roll(part, -1, axis=0))
        assert turn == pytest.approx(np.cos(2.0 * np.pi / sides), abs=1e-9)
        assert sides == 1 or np.abs(part.sum(axis=0)).max() < 1e-9


def test_a_tilt_to_the_usual_number_of_sides_has_sixteen():
    _, views = scene()
    assert len(views.tilted(np.array([0, 1]), 0.1)) == 32
    assert len(views.tilted(np.zeros(0, dtype=np.int64), 0.1)) == 0


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("aside", [0.0, 0.05])
def test_nearest_solutions_are_the_nearest_of_all_branches_and_windings(seed, aside):
    place = CELL.T_tool0_scanner.copy()
    place[0, 3] += aside
    world, views = scene(cell=dataclasses.replace(CELL, T_tool0_scanner=place))
    arm, rng = world.arm, np.random.default_rng(seed)
    near = HOME + rng.uniform(-4, 4, (len(views), 6))
    rolls = rng.uniform(-1, 1, len(views))
    given = views.positions, views.directions, rolls, views.reference, HOME
    found = nearest_solutions(arm, *given, near)
    branches, valid = solve_views(arm, *given)
    lost = ~valid.any(axis=1)
    assert np.array_equal(np.isnan(found).all(axis=1), lost)
    assert np.array_equal(np.isnan(found).any(axis=1), lost) and 0 < (~lost).sum()
    frames = arm.forward_scanner(found[~lost])
    assert np.abs(frames[:, :3, 3] - views.positions[~lost]).max() < 1e-8
    assert np.abs(frames[:, :3, 0] - views.directions[~lost]).max() < 1e-8
    for view in np.flatnonzero(~lost):
        turns = 2.0 * np.pi * np.arange(-3, 4)
        options = branches[view][valid[view]][:, :, None] + turns  # each joint by itself
        gaps = np.abs(options - near[view][None, :, None]).min(axis=2).max(axis=1)
        gap = np.abs(found[view] - near[view]).max()
        assert gap == pytest.approx(gaps.min(), abs=1e-8)


def test_nearest_solutions_out_of_reach_are_nan_and_leave_the_others_alone():
    world, views = scene()
    far = views.positions.copy()
    far[4] += 9.0
    rolls, near = np.zeros(len(views)), np.tile(HOME, (len(views), 1))
    more = views.directions, rolls, views.reference, HOME, near
    found = nearest_solutions(world.arm, far, *more)
    assert np.isnan(found[4]).all()
    others = np.arange(len(views)) != 4
    whole = nearest_solutions(world.arm, views.positions, *more)
    assert np.array_equal(found[others], whole[others], equal_nan=True)
