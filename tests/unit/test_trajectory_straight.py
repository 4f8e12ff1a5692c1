"""Straight moves: what can be driven stays on its line; what can't is refused by name."""

import dataclasses
from functools import cache

import numpy as np
import pytest

from reach_scene import flat_panel, flat_path, in_arm_base, upright
from skinplan.robot.cell import CellConfig
from skinplan.robot.collision import CollisionWorld
from skinplan.robot.dexterity import Dexterity
from skinplan.robot.reach import Views, nearest_winding, reach
from skinplan.robot.scanner_pose import interpolate_directions
from skinplan.trajectory.straight import (
    DEVIATION_M,
    DEVIATION_RAD,
    LIMITS,
    NO_IK,
    SINGULAR,
    STEP_M,
    STEP_RAD,
    Poses,
    follow,
    nearest_ends,
    same_joints,
    steps_needed,
)
from skinplan.transforms import planar, rotate

CELL = CellConfig()
HOME = np.array(CELL.home_rad)
PATH = flat_path(1.0, 0.6, 0.1)
STAND = planar(0.0, -0.9, 0.0)
T = in_arm_base(CELL, STAND, upright(0.6))
WORLD = CollisionWorld(CELL, flat_panel(1.0, 0.6), T)
EMPTY = CollisionWorld(CELL, None)
DEXTERITY = Dexterity(WORLD.arm)
VIEWS = Views.placed(PATH.positions, PATH.directions, PATH.targets, T)
REFERENCE = VIEWS.reference
TILT_RAD = np.radians(15.0)


@cache
def states(tilt_rad=0.0):
    """All joint positions for all views, or for all views tilted to eight sides."""
    views = VIEWS.tilted(np.arange(len(VIEWS)), tilt_rad, 8) if tilt_rad else VIEWS
    found = reach(WORLD, views, 0.0, HOME)
    good = np.flatnonzero(DEXTERITY.clear(found.q))
    poses = Poses(found.q, found.positions, found.directions, found.rolls).pick(good)
    return poses, found.view[good] // (8 if tilt_rad else 1)


def one(view, near=HOME):
    poses, of = states()
    options = np.flatnonzero(of == view)
    return poses.pick(options[[np.argmin(np.abs(poses.q[options] - near).max(axis=1))]])


def chosen(poses, which):
    return poses.pick(np.atleast_1d(which))


def driven(start, end, world=WORLD, reference=REFERENCE, dexterity=DEXTERITY, home=HOME):
    return follow(world, dexterity, start, end, reference, home)


def shifted(pose, way):
    """A start moved by a way, its joints the nearest ones there."""
    end = Poses(pose.q, pose.positions + way, pose.directions, pose.rolls)
    return nearest_ends(EMPTY, pose, end, REFERENCE, HOME)


def random_pairs(seed, count, tilt_rad=0.0):
    """Pairs of states: neighbours and others, half of them of one branch."""
    poses, view = states(tilt_rad)
    rng = np.random.default_rng(seed)
    first = rng.integers(0, len(view), 40 * count)
    second = rng.integers(0, len(view), 40 * count)
    branch = DEXTERITY.branches(poses.q)
    same = (branch[first] == branch[second]) & (first != second)
    other = branch[first] != branch[second]
    which = np.concatenate([np.flatnonzero(same)[:count], np.flatnonzero(other)[: count // 4]])
    return poses.pick(first[which]), poses.pick(second[which])


def off_the_line(arm, q, start, end):
    """How far joint positions are from a straight move: place [m], direction [rad], and shares."""
    frames = arm.forward_scanner(q)
    way = end.positions[0] - start.positions[0]
    gone = frames[:, :3, 3] - start.positions[0]
    directions = frames[:, :3, 0]
    turn = np.arccos(np.clip(start.directions[0] @ end.directions[0], -1.0, 1.0))
    if way @ way > 1e-12:
        share = gone @ way / (way @ way)
    else:
        share = np.arccos(np.clip(directions @ start.directions[0], -1.0, 1.0)) / turn
    there = interpolate_directions(
        np.tile(start.directions, (len(q), 1)), np.tile(end.directions, (len(q), 1)), share
    )
    place = np.linalg.norm(gone - share[:, None] * way, axis=1).max()
    return place, np.linalg.norm(directions - there, axis=1).max(), share


@pytest.mark.parametrize("tilt_rad", [0.0, TILT_RAD])
def test_a_good_move_stays_on_its_line_in_place_and_direction(tilt_rad):
    starts, ends = random_pairs(0, 150, tilt_rad)
    moves = driven(starts, ends)
    good = [i for i, move in enumerate(moves) if not move.problem]
    assert len(good) > 40
    for i in good:
        start, end, q = chosen(starts, i), chosen(ends, i), moves[i].q
        assert np.array_equal(q[0], start.q[0]) and np.array_equal(q[-1], end.q[0])
        place, turned, share = off_the_line(WORLD.arm, q, start, end)
        assert place < 1e-8 and turned < 1e-7
        assert share[[0, -1]] == pytest.approx((0.0, 1.0), abs=1e-7)
        assert np.all(np.diff(share) > 0.0)
        assert len(q) - 1 >= steps_needed(start, end)[0]
        size = np.linalg.norm(end.positions - start.positions)
        assert np.diff(share).max() * size <= STEP_M + 1e-9
        # Between the positions joints move in proportion: the line is left by less than the bound.
        for part in np.linspace(0.0, 1.0, 11)[1:-1]:
            place, turned, _ = off_the_line(
                WORLD.arm, q[:-1] + part * np.diff(q, axis=0), start, end
            )
            assert place <= DEVIATION_M and turned <= DEVIATION_RAD


def test_a_good_move_is_free_clear_and_of_one_branch_all_the_way():
    starts, ends = random_pairs(1, 120, TILT_RAD)
    moves = [move for move in driven(starts, ends) if not move.problem]
    assert len(moves) > 30
    for move in moves:
        fine = np.vstack([
            a + np.linspace(0.0, 1.0, 9)[:, None] * (b - a)
            for a, b in zip(move.q, move.q[1:], strict=False)
        ])  # fmt: skip
        assert np.all(WORLD.arm.within_limits(fine)) and np.all(WORLD.free(WORLD.dense(move.q)[0]))
        assert np.all(DEXTERITY.clear(move.q)) and len(np.unique(DEXTERITY.branches(fine))) == 1


def test_every_neighbour_is_reached_in_at_least_one_branch():
    poses, view = states()
    for row in range(0, len(PATH), 11):
        for here in range(row, row + 10):
            a, b = np.flatnonzero(view == here), np.flatnonzero(view == here + 1)
            pairs = poses.pick(np.repeat(a, len(b))), poses.pick(np.tile(b, len(a)))
            assert any(not move.problem for move in driven(*pairs))


def test_a_turn_on_the_spot_is_a_move():
    start = one(38)
    turned = rotate(planar(0.0, 0.0, np.radians(20.0)), start.directions)
    end = nearest_ends(
        WORLD, start, Poses(start.q, start.positions, turned, start.rolls), REFERENCE, HOME
    )
    move = driven(start, end)[0]
    assert move.problem == "" and len(move.q) - 1 >= np.radians(20.0) / STEP_RAD
    place, turn, share = off_the_line(WORLD.arm, move.q, start, end)
    assert place < 1e-8 and turn < 1e-7 and share[[0, -1]] == pytest.approx((0.0, 1.0), abs=1e-6)


def test_no_motion_at_all_is_a_move():
    start = one(38)
    move = driven(start, start)[0]
    assert move.problem == "" and np.abs(move.q - start.q).max() < 1e-9


@pytest.mark.parametrize("joint", [0, 1, 2, 3, 4])
@pytest.mark.parametrize("turn", [-1, 1])
def test_an_end_wound_by_a_full_turn_is_refused(joint, turn):
    start = one(37)
    end = shifted(start, [0.1, 0.0, 0.0])
    assert driven(start, end)[0].problem == ""
    wound = end.q.copy()
    wound[0, joint] += turn * 2.0 * np.pi
    inside = bool(WORLD.arm.within_limits(wound)[0])
    refused = driven(start, dataclasses.replace(end, q=wound))[0]
    assert refused.problem == NO_IK or (not inside and refused.problem == LIMITS)
    assert np.array_equal(refused.q, start.q)


def test_an_end_in_another_branch_is_refused():
    poses, view = states()
    branch = DEXTERITY.branches(poses.q)
    starts, ends = np.flatnonzero(view == 49), np.flatnonzero(view == 50)
    pairs = [(a, b) for a in starts for b in ends if branch[a] != branch[b]]
    assert len(pairs) >= 24
    first, second = np.array(pairs).T
    moves = driven(poses.pick(first), poses.pick(second))
    assert {move.problem for move in moves} <= {NO_IK, SINGULAR}
    assert {move.problem for move in moves} >= {NO_IK}


def test_joints_that_do_not_belong_to_their_pose_are_refused():
    start = one(37)
    end = shifted(start, [0.1, 0.0, 0.0])
    for wrong in (start.q, end.q + 0.02, one(70).q):
        assert driven(start, dataclasses.replace(end, q=wrong))[0].problem == NO_IK
        assert driven(dataclasses.replace(end, q=wrong), start)[0].problem == NO_IK


def test_a_move_through_the_part_is_refused_and_the_pair_named():
    start = one(30)
    through = shifted(start, [0.0, 0.28, 0.0])
    refused = driven(start, through)[0]
    assert refused.problem in (
        "collision of scanner with part",
        "collision of scanner with fixture",
    )
    assert driven(start, through, EMPTY)[0].problem == ""  # nothing but the part is in the way
    assert np.array_equal(refused.q, start.q)


@pytest.mark.parametrize("way", [(3.0, 0.0, 0.0), (0.0, 0.0, 1.5), (-1e3, 0.0, 0.0)])
def test_a_move_out_of_reach_is_refused_and_nothing_is_nan(way):
    start = one(30)
    out = shifted(start, np.array(way))
    assert np.array_equal(out.q, start.q)  # no solution: the start's stay
    for first, second in ((start, out), (out, start)):
        refused = driven(first, second)[0]
        assert refused.problem == NO_IK and np.all(np.isfinite(refused.q))


def test_a_move_that_leaves_the_reach_in_its_middle_only_is_refused():
    """Past the first axis, where the wrist comes nearer to it than its offset allows."""
    first = one(38)
    wrist = EMPTY.arm.links(first.q)[0, 5, :3, 3]
    across = np.array([0.0, -wrist[1], 0.0])  # the wrist's line crosses the first axis
    ends = []
    for side in (-0.45, 0.45):
        place = first.positions + across + [side - wrist[0], 0.0, 0.0]
        views = Views(place, first.directions, place, REFERENCE)
        found = reach(EMPTY, views, 0.0, HOME)
        assert len(found.q)
        ends.append(Poses(found.q, found.positions, found.directions, found.rolls))
    a, b = (len(side.q) for side in ends)
    pairs = ends[0].pick(np.repeat(np.arange(a), b)), ends[1].pick(np.tile(np.arange(b), a))
    assert {move.problem for move in driven(*pairs, EMPTY)} == {NO_IK}


def across_the_wrist():
    """A start and an end on a level line, both clear, the wrist turned to either side of zero."""
    rng = np.random.default_rng(5)
    for _ in range(3000):
        q = np.array(
            [rng.uniform(-1, 1), rng.uniform(-2, 0), rng.uniform(0.5, 2.5), 0.0, 0.25, HOME[5]]
        )
        # Forearm angles such that the view is level: it turns with the first axis only.
        q[3] = -np.pi - q[1] - q[2] if rng.random() < 0.5 else -q[1] - q[2]
        frame = EMPTY.arm.forward_scanner(q[None])
        yield q, frame


def test_a_move_across_a_singular_wrist_is_refused():
    arm = EMPTY.arm
    found = 0
    for q, frame in across_the_wrist():
        start = Poses(q[None], frame[:, :3, 3], frame[:, :3, 0], np.zeros(1))
        reference = np.array([0.0, 0.0, 1.0])
        over = q[None] + [0.0, 0.0, 0.0, 0.0, -0.5, 0.0]
        # The end with the same direction: the first axis turns as the wrist does.
        over[0, 0] += 0.5 if abs(frame[0, 2, 0]) < 0.2 else 0.0
        there = arm.forward_scanner(over)
        end = Poses(over, there[:, :3, 3], there[:, :3, 0], np.zeros(1))
        if not (np.all(EMPTY.free(np.vstack([q, over]))) and np.all(DEXTERITY.clear(over))):
            continue
        assert DEXTERITY.branches(q[None])[0] != DEXTERITY.branches(over)[0]
        problem = driven(start, end, EMPTY, reference)[0].problem
        assert problem in (SINGULAR, NO_IK)
        found += problem == SINGULAR
        if found >= 3:
            return
    pytest.fail(f"only {found} moves were refused for a singular position")


@pytest.mark.parametrize("joint", [2, 4])
def test_a_move_into_a_singular_position_is_refused(joint):
    start = one(38)
    q = start.q.copy()
    q[0, joint] = 0.12 if joint == 2 else 0.07
    frame = EMPTY.arm.forward_scanner(q)
    near = Poses(q, frame[:, :3, 3], frame[:, :3, 0], start.rolls)
    away = np.array([[0.0, 0.0, -0.01]])
    end = nearest_ends(
        EMPTY, near, dataclasses.replace(near, positions=near.positions + away), REFERENCE, HOME
    )
    assert driven(near, end, EMPTY)[0].problem == SINGULAR
    assert driven(end, near, EMPTY)[0].problem == SINGULAR
    # The same move far from there is none: the bound is what refuses it.
    assert driven(start, shifted(start, away), EMPTY)[0].problem == ""


def turned_about_the_first_axis(poses, angle):
    turn = planar(0.0, 0.0, angle)
    q = poses.q + [angle, 0, 0, 0, 0, 0]
    return Poses(q, rotate(turn, poses.positions), rotate(turn, poses.directions), poses.rolls)


def test_a_move_beyond_a_joint_limit_is_refused():
    """The first axis goes on across its limit; so short of it the same move is fine."""
    start = one(40)
    end = shifted(start, [-0.2, 0.0, 0.0])
    least, most = np.sort([start.q[0, 0], end.q[0, 0]])
    assert most - least > 0.05
    limit = WORLD.arm.upper[0]
    for stop, expected in ((limit - 0.01, ""), (limit + 0.01, LIMITS)):
        angle = stop - most
        reference = rotate(planar(0.0, 0.0, angle), REFERENCE[None])[0]
        pair = [turned_about_the_first_axis(p, angle) for p in (start, end)]
        assert driven(*pair, EMPTY, reference)[0].problem == expected
        assert driven(*pair[::-1], EMPTY, reference)[0].problem == expected


@pytest.mark.parametrize("tilt_rad", [0.0, TILT_RAD])
def test_a_move_and_its_reverse_agree(tilt_rad):
    starts, ends = random_pairs(2, 150, tilt_rad)
    there, back = driven(starts, ends), driven(ends, starts)
    assert sum(not move.problem for move in there) > 40
    for a, b in zip(there, back, strict=True):
        if a.problem.startswith("collision"):  # the first one on the way is named
            assert b.problem.startswith("collision")
        else:
            assert a.problem == b.problem
        if not a.problem:
            assert a.q.shape == b.q.shape and np.abs(a.q - b.q[::-1]).max() < 1e-9


def test_many_moves_at_once_are_the_same_as_one_by_one():
    starts, ends = random_pairs(3, 60, TILT_RAD)
    together = driven(starts, ends)
    assert {bool(move.problem) for move in together} == {True, False}
    for i, move in enumerate(together):
        alone = driven(chosen(starts, i), chosen(ends, i))[0]
        assert alone.problem == move.problem and alone.q.shape == move.q.shape
        assert np.abs(alone.q - move.q).max() < 1e-12


def test_no_moves_at_all():
    none = np.zeros(0, dtype=np.int64)
    assert driven(states()[0].pick(none), states()[0].pick(none)) == []


@pytest.mark.parametrize("seed", range(3))
def test_moving_part_and_arm_together_changes_nothing(seed):
    rng = np.random.default_rng(seed)
    shop = planar(*rng.uniform(-3, 3, 2), rng.uniform(-np.pi, np.pi))
    T_moved = in_arm_base(CELL, shop @ STAND, shop @ upright(0.6))
    world = CollisionWorld(CELL, flat_panel(1.0, 0.6), T_moved)
    views = Views.placed(PATH.positions, PATH.directions, PATH.targets, T_moved)
    starts, ends = random_pairs(seed, 60)
    moved = driven(starts, ends, world, views.reference)
    for a, b in zip(driven(starts, ends), moved, strict=True):
        assert a.problem == b.problem and a.q.shape == b.q.shape
        assert np.abs(a.q - b.q).max() < 1e-9


@pytest.mark.parametrize("angle", [-2.0, -0.7, 1.1, 2.5])
def test_turning_everything_about_the_first_axis_turns_the_first_joint(angle):
    """Without a part: base and pedestal, which don't turn along, are not met by these moves."""
    starts, ends = random_pairs(4, 80)
    reference = rotate(planar(0.0, 0.0, angle), REFERENCE[None])[0]
    still = driven(starts, ends, EMPTY)
    moved = driven(
        turned_about_the_first_axis(starts, angle),
        turned_about_the_first_axis(ends, angle),
        EMPTY,
        reference,
    )
    compared = 0
    for a, b in zip(still, moved, strict=True):
        if {a.problem, b.problem} <= {"", NO_IK, SINGULAR}:
            compared += not a.problem
            assert a.problem == b.problem
            assert np.abs(a.q + [angle, 0, 0, 0, 0, 0] - b.q).max() < 1e-9
    assert compared > 20


def test_rolls_are_followed_where_the_scanner_is_beside_the_tool_axis():
    aside = CELL.T_tool0_scanner.copy()
    aside[:3, 3] += (0.05, 0.0, 0.0)
    cell = dataclasses.replace(CELL, T_tool0_scanner=aside)
    world = CollisionWorld(cell, flat_panel(1.0, 0.6), T)
    dexterity = Dexterity(world.arm)
    found = reach(world, VIEWS, 0.0, HOME)
    poses = Poses(found.q, found.positions, found.directions, found.rolls)
    rng = np.random.default_rng(0)
    first = rng.permutation(np.flatnonzero(found.view == 38))[:12]
    second = np.flatnonzero(found.view == 39)
    pairs = poses.pick(np.repeat(first, len(second))), poses.pick(np.tile(second, len(first)))
    moves = follow(world, dexterity, *pairs, VIEWS.reference, HOME)
    turned = 0
    for i, move in enumerate(moves):
        if move.problem:
            continue
        start, end = (chosen(side, i) for side in pairs)
        middle = move.q[:-1] + 0.5 * np.diff(move.q, axis=0)
        for q, bound in ((move.q, 1e-8), (middle, DEVIATION_M)):
            place, _, share = off_the_line(world.arm, q, start, end)
            assert place <= bound
            sideways = world.arm.forward_scanner(q)[:, :3, 1]
            rolls = (start.rolls + share * (end.rolls - start.rolls))[:, None]
            plumb = world.arm.forward_scanner(start.q)[0, :3, :3]
            # Roll turns the scanner's own y axis about the view; directions are all the same here.
            turn = rolls - start.rolls
            expected = np.cos(turn) * plumb[:, 1] + np.sin(turn) * plumb[:, 2]
            assert np.abs(sideways - expected).max() < max(bound, 0.02)
        turned += abs(end.rolls[0] - start.rolls[0]) > 0.1
    assert turned >= 5


@pytest.mark.parametrize("seed", range(3))
def test_nearest_ends_are_the_nearest_of_all_solutions(seed):
    poses, view = states()
    rng = np.random.default_rng(seed)
    near = poses.pick(rng.integers(0, len(view), 40))
    goals = poses.pick(rng.integers(0, len(view), 40))
    found = nearest_ends(WORLD, near, goals, REFERENCE, HOME)
    arm = WORLD.arm
    frames = arm.forward_scanner(found.q)
    assert np.abs(frames[:, :3, 3] - goals.positions).max() < 1e-8
    assert np.abs(frames[:, :3, 0] - goals.directions).max() < 1e-8
    assert np.array_equal(found.positions, goals.positions)
    for i in range(40):
        every = reach(
            EMPTY,
            Views(goals.positions[[i]], goals.directions[[i]], goals.positions[[i]], REFERENCE),
            0.0,
            HOME,
        ).q
        gaps = np.abs(nearest_winding(every, near.q[i]) - near.q[i]).max(axis=1)
        gap = np.abs(found.q[i] - near.q[i]).max()
        assert gap <= gaps.min() + 1e-9 and gap <= np.pi + 1e-9


def test_steps_by_hand():
    poses = one(38)
    far = Poses(poses.q, poses.positions + [0.1, 0.0, 0.0], poses.directions, poses.rolls)
    assert steps_needed(poses, far).tolist() == [3]  # 0.1 m by at most 0.04 m
    assert steps_needed(poses, poses).tolist() == [1]
    exact = Poses(poses.q, poses.positions + [0.08, 0.0, 0.0], poses.directions, poses.rolls)
    assert steps_needed(poses, exact).tolist() == [2]
    turned = rotate(planar(0.0, 0.0, np.radians(13.0)), poses.directions)
    leaned = Poses(poses.q, poses.positions, turned, poses.rolls)
    assert steps_needed(poses, leaned).tolist() == [3]  # 13 degrees by at most 6
    rolled = Poses(poses.q, poses.positions, poses.directions, poses.rolls + np.radians(31.0))
    assert steps_needed(poses, rolled).tolist() == [6]


def test_same_joints_knows_windings():
    assert same_joints(HOME, HOME + 1e-9)
    assert not same_joints(HOME, HOME + 1e-5)
    assert not same_joints(HOME, HOME + [2 * np.pi, 0, 0, 0, 0, 0])
