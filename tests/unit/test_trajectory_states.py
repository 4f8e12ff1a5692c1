"""The states of a station: each brings the scanner where it says; views without one say why."""

import dataclasses

import numpy as np
import pytest

from reach_scene import flat_panel, flat_path, in_arm_base, upright
from skinplan.robot.cell import CellConfig, Obstacle
from skinplan.robot.collision import CollisionWorld
from skinplan.robot.dexterity import ELBOW_LEAST, WRIST_LEAST, Dexterity
from skinplan.robot.reach import Views, solve_views
from skinplan.robot.tracker import TrackerSight
from skinplan.trajectory.states import find_states
from skinplan.transforms import inverse, planar, transform

CELL = CellConfig()
HOME = np.array(CELL.home_rad)
PATH = flat_path(0.8, 0.6, 0.2)
PANEL = flat_panel(0.8, 0.6)
STAND = planar(0.0, -0.9, 0.0)
T_MAP_PART = upright(0.6)
T = in_arm_base(CELL, STAND, T_MAP_PART)
T_MAP_ARM = STAND @ CELL.T_base_link_arm_base
WORLD = CollisionWorld(CELL, PANEL, T)
DEXTERITY = Dexterity(WORLD.arm)
TILT_RAD = np.radians(12.0)
MIDDLE = len(PATH) // 2


def views_at(positions, directions, standoff=0.3):
    positions, directions = np.atleast_2d(positions), np.atleast_2d(directions)
    return Views(positions, directions, positions + standoff * directions, directions[0])


VIEWS = Views.placed(PATH.positions, PATH.directions, PATH.targets, T)


@pytest.fixture(scope="module")
def leaned():
    return find_states(WORLD, DEXTERITY, VIEWS, TILT_RAD, HOME)


@pytest.fixture(scope="module")
def straight():
    return find_states(WORLD, DEXTERITY, VIEWS, 0.0, HOME)


def angle_between(a, b):
    return 2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(a - b, axis=1), 0.0, 1.0))


def require_right(states, views, world=WORLD, dexterity=DEXTERITY):
    """Every state is where it says, looks at its target, and can be."""
    arm, view = world.arm, states.view
    frames = arm.forward_scanner(states.q)
    assert np.abs(frames[:, :3, 3] - states.poses.positions).max() < 1e-8
    assert np.abs(frames[:, :3, 0] - states.poses.directions).max() < 1e-8
    standoff = np.linalg.norm(views.targets - views.positions, axis=1)[view, None]
    seen = frames[:, :3, 3] + standoff * frames[:, :3, 0]
    assert np.abs(seen - views.targets[view]).max() < 1e-8
    lean = angle_between(frames[:, :3, 0], views.directions[view])
    assert np.abs(lean - states.tilt_rad).max() < 1e-7
    assert np.all((states.q >= arm.lower) & (states.q <= arm.upper))
    assert dexterity.elbow(states.q).min() >= ELBOW_LEAST
    assert dexterity.wrist(states.q).min() >= WRIST_LEAST
    assert np.all(world.free(states.q))
    assert np.all(np.diff(view) >= 0)
    assert np.all(np.isfinite(states.cost_s)) and states.cost_s.min() >= 0.0
    has = set(view.tolist())
    assert has.isdisjoint(states.reasons) and has | set(states.reasons) == set(range(len(views)))
    assert all(states.reasons.values())


def test_every_state_is_a_view_of_its_target_at_the_angle_it_says(leaned, straight):
    require_right(straight, VIEWS)
    require_right(leaned, VIEWS)
    assert not straight.tilt_rad.any()
    assert sorted(set(np.round(leaned.tilt_rad, 12))) == pytest.approx([0, TILT_RAD / 2, TILT_RAD])
    assert len(leaned.view) > 10 * len(straight.view) > 0


def test_no_two_states_are_the_same(leaned):
    rows = np.column_stack([leaned.view, np.round(leaned.q, 7)])
    assert len(np.unique(rows, axis=0)) == len(rows)


def test_without_tilt_all_branches_are_found_and_nothing_else(straight):
    """By hand: solve, wind all joints by full turns, keep what may be."""
    arm = WORLD.arm
    branches, valid = solve_views(
        arm, VIEWS.positions, VIEWS.directions, np.zeros(len(VIEWS)), VIEWS.reference, HOME
    )
    for view in range(len(VIEWS)):
        mine = straight.q[straight.of(view)]
        expected = 0
        for q in branches[view][valid[view]]:
            near = q + 2 * np.pi * np.round((HOME - q) / (2 * np.pi))
            near[2] = q[2]  # the elbow has no other winding
            if DEXTERITY.clear(near[None])[0] and WORLD.free(near[None])[0]:
                expected += 1
                assert np.abs(mine - near).max(axis=1).min() < 1e-7
        assert len(np.unique(np.round(np.exp(1j * mine), 6), axis=0)) == expected


def test_the_states_of_a_view_are_a_slice(leaned):
    parts = [leaned.of(view) for view in range(len(VIEWS))]
    assert np.array_equal(np.concatenate(parts), np.arange(len(leaned.view)))
    for view, part in enumerate(parts):
        assert np.all(leaned.view[part] == view)
    assert leaned.of(len(VIEWS) + 3).size == 0


def test_tilt_costs_by_its_share_and_so_does_the_edge_of_the_singular(leaned, straight):
    """A full tilt costs what no joint position alone does; planned views away from it nothing."""
    assert straight.cost_s.max() < 0.5
    for states in (leaned, straight):
        most = np.clip(1.0 - DEXTERITY.measure(states.q) / 0.4, 0.0, 1.0)
        own = states.cost_s - 0.15 * most
        assert np.abs(own - states.tilt_rad / TILT_RAD).max() < 1e-12


def test_joints_about_half_a_turn_from_home_get_their_other_winding():
    """A view behind the arm is reached by turning the first joint either way."""
    world = CollisionWorld(CELL, None)
    for side in (-1.0, 1.0):
        angle = HOME[0] + side * (np.pi - 0.1)
        q = HOME.copy()
        q[0] = angle
        frame = world.arm.forward_scanner(q[None])[0]
        states = find_states(world, DEXTERITY, views_at(frame[:3, 3], frame[:3, 0]), 0.0, HOME)
        require_right(states, views_at(frame[:3, 3], frame[:3, 0]), world)
        gaps = np.abs(states.q - q)
        other = np.abs(states.q - (q - [side * 2 * np.pi, 0, 0, 0, 0, 0]))
        assert gaps.max(axis=1).min() < 1e-7 and other.max(axis=1).min() < 1e-7


def test_a_joint_near_home_is_not_wound():
    states = find_states(CollisionWorld(CELL, None), DEXTERITY, VIEWS, 0.0, HOME)
    off = np.abs(states.q - HOME)[:, [0, 1, 3, 4]]
    assert off.max() <= np.pi + 0.5 + 1e-9
    twins = 0
    for view in range(len(VIEWS)):
        q = states.q[states.of(view)]
        same = np.abs(np.exp(1j * q[:, None]) - np.exp(1j * q[None])).max(axis=2) < 1e-6
        for a, b in zip(*np.nonzero(np.triu(same, 1)), strict=True):
            turned = np.abs(q[a] - q[b]) > 1.0
            assert np.abs(q[[a, b]][:, turned] - HOME[turned]).min() >= np.pi - 0.5 - 1e-9
            twins += 1
    assert twins > 0


def test_a_view_out_of_reach_says_so_and_its_neighbour_is_found():
    views = Views(
        VIEWS.positions + np.where(np.arange(len(VIEWS)) == 3, 5.0, 0.0)[:, None],
        VIEWS.directions,
        VIEWS.targets + np.where(np.arange(len(VIEWS)) == 3, 5.0, 0.0)[:, None],
        VIEWS.reference,
    )
    states = find_states(WORLD, DEXTERITY, views, TILT_RAD, HOME)
    require_right(states, views)
    assert set(states.reasons) == {3} and "out of the arm's reach" in states.reasons[3]


def test_nothing_reached_at_all_is_no_error():
    far = views_at([[9.0, 0.0, 0.0], [0.0, -9.0, 1.0]], [[1.0, 0.0, 0.0]] * 2)
    states = find_states(WORLD, DEXTERITY, far, TILT_RAD, HOME)
    assert len(states.view) == 0 and states.q.shape == (0, 6) and states.least_tilted.size == 0
    assert set(states.reasons) == {0, 1} and all("reach" in t for t in states.reasons.values())


def stretched():
    """A view that the arm only takes nearly stretched: the measure of its elbow is below 0.15."""
    world = CollisionWorld(CELL, None)
    q = np.array([1.4, -1.1, 0.1, -0.6, 1.4, HOME[5]])
    frame = world.arm.forward_scanner(q[None])[0]
    assert world.free(q[None])[0] and DEXTERITY.elbow(q[None])[0] < ELBOW_LEAST
    return world, views_at(frame[:3, 3], frame[:3, 0])


def test_a_view_that_only_a_stretched_arm_takes_is_named_singular():
    world, views = stretched()
    states = find_states(world, DEXTERITY, views, 0.0, HOME)
    assert len(states.view) == 0
    assert states.reasons == {0: "too close to a singular position of elbow or wrist"}


def test_a_view_in_the_part_is_named_by_what_collides():
    behind = VIEWS.positions[[MIDDLE]] + 0.29 * VIEWS.directions[[MIDDLE]]
    views = Views(behind, VIEWS.directions[[MIDDLE]], behind + 0.3 * VIEWS.directions[[MIDDLE]],
                  VIEWS.reference)  # fmt: skip
    states = find_states(WORLD, DEXTERITY, views, 0.0, HOME)
    assert states.reasons.keys() == {0} and states.reasons[0].startswith("collision of ")


def with_sight(cell=CELL, mesh=PANEL):
    return TrackerSight(cell, mesh, T_MAP_PART)


def test_with_a_tracker_every_state_is_seen_by_it_and_no_seen_one_is_lost(leaned):
    sight = with_sight()
    seen = find_states(WORLD, DEXTERITY, VIEWS, TILT_RAD, HOME, sight, T_MAP_ARM)
    require_right(seen, VIEWS)
    bodies = WORLD.bodies

    def codes(q):
        segments, T_arm_scanner = bodies.placed(q)
        return sight.codes(bodies, segments, T_arm_scanner, np.tile(T_MAP_ARM, (len(q), 1, 1)))

    assert not codes(seen.q).any()
    expected = leaned.q[codes(leaned.q) == 0]
    assert np.array_equal(seen.q, expected)
    assert 0 < len(seen.view)


def test_a_view_hidden_from_the_tracker_is_named_by_what_hides_it():
    """A wall right before the tracker: then nothing is seen."""
    place = CELL.T_map_tracker[:3, 3]
    toward = T_MAP_PART[:3, 3] - place
    middle = place + 0.5 * toward
    turn = planar(0.0, 0.0, np.arctan2(toward[1], toward[0]))
    wall = Obstacle("wall", transform(middle, turn[:3, :3]), (0.1, 6.0, 6.0))
    cell = dataclasses.replace(CELL, obstacles=(wall,))
    states = find_states(
        WORLD, DEXTERITY, VIEWS, 0.0, HOME, TrackerSight(cell, PANEL, T_MAP_PART), T_MAP_ARM
    )
    assert len(states.view) == 0 and set(states.reasons) == set(range(len(VIEWS)))
    by = {text.removeprefix("the scanner is hidden from the tracker by ") for text in
          states.reasons.values()}  # fmt: skip
    assert by <= {"wall", "the arm"} and "wall" in by  # the arm may hide it besides
    open_sky = find_states(WORLD, DEXTERITY, VIEWS, 0.0, HOME, with_sight(), T_MAP_ARM)
    assert len(open_sky.view) > 0


def test_the_tracker_is_not_asked_without_its_place(straight):
    unasked = find_states(WORLD, DEXTERITY, VIEWS, 0.0, HOME, with_sight(), None)
    assert np.array_equal(unasked.q, straight.q)


def test_the_least_tilted_of_each_view(leaned):
    least = leaned.least_tilted
    for view in range(len(VIEWS)):
        tilt = leaned.tilt_rad[leaned.of(view)]
        assert np.array_equal(least[leaned.of(view)], tilt <= tilt.min() + 1e-9)
        assert least[leaned.of(view)].any()
    assert np.array_equal(leaned.tilt_rad[least] > 0, np.zeros(least.sum(), dtype=bool))


def test_where_the_straight_view_is_closed_the_least_tilt_counts():
    """Views at the very end of the reach: only some of their tilts are reached."""
    edge = None
    for away in np.linspace(0.3, 1.2, 91):
        shift = np.array([away, 0.0, 0.0])
        views = Views(VIEWS.positions[[MIDDLE]] + shift, VIEWS.directions[[MIDDLE]],
                      VIEWS.targets[[MIDDLE]] + shift, VIEWS.reference)  # fmt: skip
        world = CollisionWorld(CELL, None)
        states = find_states(world, DEXTERITY, views, TILT_RAD, HOME)
        if len(states.view) and states.tilt_rad.min() > 0.0:
            edge = states
            break
    assert edge is not None
    require_right(edge, views, world)
    assert np.array_equal(edge.least_tilted, edge.tilt_rad <= edge.tilt_rad.min() + 1e-9)


@pytest.mark.parametrize("seed", range(2))
def test_moving_part_and_arm_together_changes_nothing(seed, straight):
    rng = np.random.default_rng(seed)
    shop = planar(*rng.uniform(-3, 3, 2), rng.uniform(-np.pi, np.pi))
    moved = inverse(shop @ STAND @ CELL.T_base_link_arm_base) @ (shop @ T_MAP_PART)
    views = Views.placed(PATH.positions, PATH.directions, PATH.targets, moved)
    world = CollisionWorld(CELL, PANEL, moved)
    states = find_states(world, Dexterity(world.arm), views, 0.0, HOME)
    assert np.array_equal(states.view, straight.view)
    assert np.abs(states.q - straight.q).max() < 1e-8


def test_a_scanner_beside_the_tool_axis_has_states_of_several_rolls():
    aside = CELL.T_tool0_scanner.copy()
    aside[:3, 3] += (0.05, 0.0, 0.0)
    world = CollisionWorld(dataclasses.replace(CELL, T_tool0_scanner=aside), PANEL, T)
    dexterity = Dexterity(world.arm)
    states = find_states(world, dexterity, VIEWS, 0.0, HOME)
    require_right(states, VIEWS, world, dexterity)
    assert len(np.unique(np.round(states.poses.rolls, 6))) > 1
