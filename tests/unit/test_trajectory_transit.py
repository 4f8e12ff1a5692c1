"""Motion between scans: free, from stop to stop, led around what stands in the way."""

import dataclasses

import numpy as np
import pytest

from reach_scene import flat_panel, flat_path, in_arm_base, upright
from skinplan.robot.cell import CellConfig, Obstacle
from skinplan.robot.collision import CollisionWorld
from skinplan.robot.dexterity import Dexterity
from skinplan.robot.reach import Views, reach
from skinplan.trajectory.blend import blended
from skinplan.trajectory.durations import polyline_s, rest_to_rest
from skinplan.trajectory.graph import Problem, StationGraph
from skinplan.trajectory.states import find_states
from skinplan.trajectory.straight import Poses
from skinplan.trajectory.transit import Transit, TransitPlanner
from skinplan.trajectory.tree_search import connect, shortcut, shorten
from skinplan.transforms import inverse, planar, transform

CELL = CellConfig()
HOME = np.array(CELL.home_rad)
PATH = flat_path(1.0, 0.6, 0.1)
PANEL = flat_panel(1.0, 0.6)
STAND = planar(0.0, -0.9, 0.0)
T = in_arm_base(CELL, STAND, upright(0.6))
WORLD = CollisionWorld(CELL, PANEL, T)
ARM = WORLD.arm
DEXTERITY = Dexterity(ARM)
VIEWS = Views.placed(PATH.positions, PATH.directions, PATH.targets, T)
FOUND = reach(WORLD, VIEWS, 0.0, HOME)
VELOCITY, ACCELERATION = ARM.velocity, CELL.acceleration_max_rad_s2


def state(view, near=HOME):
    options = np.flatnonzero(FOUND.view == view)
    best = options[np.argmin(np.abs(FOUND.q[options] - near).max(axis=1))]
    return Poses(FOUND.q, FOUND.positions, FOUND.directions, FOUND.rolls).pick(np.array([best]))


def with_boxes(places, size):
    """A world without a part, but with cubes, centres in the arm base."""
    boxes = tuple(
        Obstacle(f"box {number}", transform(place), (size, size, size))
        for number, place in enumerate(places)
    )
    return CollisionWorld(dataclasses.replace(CELL, obstacles=boxes), None, None, np.eye(4))


def planner(world=WORLD, seed=0):
    return TransitPlanner(
        world, Dexterity(world.arm), VIEWS.reference, HOME, VELOCITY, ACCELERATION, seed
    )


# --- trees ------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_the_tree_search_finds_free_ways_and_always_the_same(seed):
    goal = state(5).q[0]
    ways = [connect(WORLD, HOME, goal, 200, seed) for _ in range(2)]
    assert ways[0] is not None and np.array_equal(np.array(ways[0]), np.array(ways[1]))
    assert np.array_equal(ways[0][0], HOME) and np.array_equal(ways[0][-1], goal)
    assert all(WORLD.free_motion(a, b) for a, b in zip(ways[0], ways[0][1:], strict=False))


# A wall on end between two arm positions that are a turn of the first joint apart.
AHEAD = np.array([1.4, -1.6, 1.3, 0.3, 1.4, HOME[5]])
LEFT, RIGHT = AHEAD + [0.8, 0, 0, 0, 0, 0], AHEAD - [0.8, 0, 0, 0, 0, 0]


def between_left_and_right():
    """A world with a wall where the scanner is half way from left to right."""
    world = with_boxes(ARM.forward_scanner(AHEAD[None])[:, :3, 3], 0.12)
    assert np.all(world.free(np.stack([LEFT, RIGHT, HOME]))) and not world.free_motion(LEFT, RIGHT)
    return world


def test_the_tree_search_goes_around_a_wall_and_each_seed_its_own_way():
    world = between_left_and_right()
    ways = {}
    for seed in range(4):
        way = connect(world, LEFT, RIGHT, 400, seed)
        assert way is not None and len(way) > 2
        assert np.array_equal(way[0], LEFT) and np.array_equal(way[-1], RIGHT)
        assert all(world.free_motion(a, b) for a, b in zip(way, way[1:], strict=False))
        assert np.array_equal(np.array(way), np.array(connect(world, LEFT, RIGHT, 400, seed)))
        ways[np.array(way).tobytes()] = way
    assert len(ways) >= 2


def test_the_tree_search_gives_up_on_a_goal_in_collision():
    stretched = np.array([np.pi / 2, 0.0, 0.0, 0.0, 0.0, HOME[5]])
    assert not WORLD.free(stretched[None])[0]
    assert connect(WORLD, HOME, stretched, 30) is None


def test_a_last_joint_that_neither_end_moves_is_left_alone():
    way = connect(between_left_and_right(), LEFT, RIGHT, 400, 1)
    assert np.ptp(np.array(way)[:, 5]) == 0.0


def test_shortening_leaves_out_needless_corners():
    corners = [HOME, HOME + 0.02, HOME - 0.02, HOME + 0.03]
    assert np.array_equal(np.array(shorten(WORLD, corners)), np.array([corners[0], corners[-1]]))


def test_shortening_keeps_a_corner_that_is_needed():
    world = between_left_and_right()
    way = connect(world, LEFT, RIGHT, 400, 0)
    result = shorten(world, way)
    assert 2 < len(result) <= len(way)
    assert all(world.free_motion(a, b) for a, b in zip(result, result[1:], strict=False))


def length(corners):
    return np.linalg.norm(np.diff(np.array(corners), axis=0), axis=1).sum()


@pytest.mark.parametrize("seed", range(4))
def test_a_shortcut_keeps_ends_and_freedom_and_is_no_longer(seed):
    world = between_left_and_right()
    way = connect(world, LEFT, RIGHT, 400, seed)
    # Needless corners on top: their lines are free, too.
    fuller = [way[0], *(c for a, b in zip(way, way[1:], strict=False) for c in (0.5 * (a + b), b))]
    result = shortcut(world, fuller, seed)
    assert np.array_equal(result[0], LEFT) and np.array_equal(result[-1], RIGHT)
    assert length(result) <= length(way) + 1e-9
    assert length(result) > np.linalg.norm(RIGHT - LEFT)  # the straight line is not free
    assert all(world.free_motion(a, b) for a, b in zip(result, result[1:], strict=False))
    assert np.array_equal(np.array(result), np.array(shortcut(world, fuller, seed)))


def test_a_shortcut_of_a_free_way_is_the_straight_line():
    away = [HOME, HOME + 0.1, HOME + [0.1, -0.1, 0.1, 0.0, 0.2, 0.0], HOME + 0.05]
    result = np.array(shortcut(WORLD, away))
    assert np.array_equal(result, np.stack([HOME, HOME + 0.05]))


# --- rounded corners --------------------------------------------------------------------------


def test_blended_corners_keep_the_ends_and_need_no_stops():
    corners = [HOME, HOME + [0.5, 0, 0, 0, 0, 0], HOME + [0.5, 0, 0, 0.6, 0, 0]]
    legs = [np.stack(pair) for pair in zip(corners, corners[1:], strict=False)]
    result = blended(WORLD, legs)
    assert len(result) == 1 < len(legs)
    path = result[0]
    assert np.array_equal(path[0], corners[0]) and np.array_equal(path[-1], corners[-1])
    assert np.all(WORLD.free(WORLD.dense(path)[0]))
    assert np.abs(np.diff(path, axis=0)).max() <= 0.2 + 1e-9  # knots are so near to each other
    assert np.abs(np.diff(path, axis=0)).max(axis=1).min() > 1e-6
    # No sharp corner is left: neighbouring steps turn by less than a third of a right angle.
    step = np.diff(path, axis=0)
    unit = step / np.linalg.norm(step, axis=1, keepdims=True)
    assert np.einsum("ni,ni->n", unit[1:], unit[:-1]).min() > np.cos(np.radians(30.0))
    # By hand: the parabola takes a quarter radian of the first leg (half of it), 0.3 of the second.
    apex = corners[1] + [-0.25 * 0.25, 0, 0, 0.25 * 0.3, 0, 0]
    assert np.abs(path - apex).max(axis=1).min() < 1e-9


def test_a_single_leg_is_kept_as_it_is():
    leg = np.stack([HOME, HOME + 0.3])
    result = blended(WORLD, [leg])
    assert len(result) == 1 and np.array_equal(result[0], leg)
    assert blended(WORLD, []) == []


def test_a_corner_that_no_curve_gets_around_stays_a_stop():
    """Something stands in the inside of the corner, nearer than the smallest curve."""
    a, corner = LEFT, AHEAD
    b = corner + [0.0, -0.7, 0.0, 0.0, 0.0, 0.0]
    legs = [np.stack([a, corner]), np.stack([corner, b])]
    free = blended(CollisionWorld(CELL, None), legs)
    assert len(free) == 1

    class Narrow(CollisionWorld):
        """Free on the two legs only, within a thousandth of a radian."""

        def codes(self, q, *more):
            off = np.minimum(gap(q, a, corner), gap(q, corner, b))
            return np.asarray(off > 1e-3, dtype=np.int64)

    result = blended(Narrow(CELL, None), legs)
    assert len(result) == 2
    assert np.array_equal(result[0], legs[0]) and np.array_equal(result[1], legs[1])


def gap(q, start, end):
    """Distances of joint positions from a line in joint space."""
    way = end - start
    share = np.clip((q - start) @ way / (way @ way), 0.0, 1.0)
    return np.linalg.norm(q - start - share[:, None] * way, axis=1)


@pytest.mark.parametrize("seed", range(3))
def test_blended_ways_around_a_wall_are_free_and_have_no_more_legs(seed):
    world = between_left_and_right()
    corners = shortcut(world, connect(world, LEFT, RIGHT, 400, seed), seed)
    legs = [np.stack(pair) for pair in zip(corners, corners[1:], strict=False)]
    result = blended(world, legs)
    assert len(result) <= len(legs)
    assert np.array_equal(result[0][0], LEFT) and np.array_equal(result[-1][-1], RIGHT)
    for leg in result:
        assert np.all(world.free(world.dense(leg)[0]))


# --- transits ---------------------------------------------------------------------------------


def require_transit(world, transit, start, end):
    assert transit is not None
    legs = transit.legs
    assert np.array_equal(legs[0][0], start) and np.array_equal(legs[-1][-1], end)
    for leg, following in zip(legs, legs[1:], strict=False):
        assert np.array_equal(leg[-1], following[0])
    for leg in legs:
        assert np.all(world.arm.within_limits(leg)) and np.all(world.free(world.dense(leg)[0]))
    seconds = sum(polyline_s(leg, VELOCITY, ACCELERATION) for leg in legs)
    assert transit.seconds == pytest.approx(seconds)
    direct = rest_to_rest(np.abs(end - start), VELOCITY, ACCELERATION)
    assert transit.detour_s == pytest.approx(max(0.0, seconds - direct)) and transit.detour_s >= 0.0


@pytest.mark.parametrize("pair", [(0, 76), (5, 71), (10, 66), (38, 0), (33, 43)])
def test_stops_at_the_part_are_joined_freely(pair):
    made = planner()
    first, second = (state(view) for view in pair)
    transit = made.plan(made.stop(first), made.stop(second))
    require_transit(WORLD, transit, first.q[0], second.q[0])


def test_where_the_straight_joint_motion_is_free_it_is_taken_without_detour():
    made = planner()
    away = HOME + [0.3, 0.1, 0.0, 0.0, 0.0, 0.0]
    transit = made.plan(made.resting(HOME), made.resting(away))
    assert len(transit.legs) == 1 and np.array_equal(transit.legs[0], np.stack([HOME, away]))
    assert transit.detour_s == 0.0
    # One joint leads: 2 sqrt(0.3 / a), or beyond the speed limit's ramp the trapezoid.
    a, v = ACCELERATION, VELOCITY[0]
    expected = 2 * np.sqrt(0.3 / a) if 0.3 < v * v / a else 0.3 / v + v / a
    assert transit.seconds == pytest.approx(expected)


def test_a_stop_where_the_arm_is_already_needs_no_motion():
    made = planner()
    transit = made.plan(made.resting(HOME), made.resting(HOME.copy()))
    assert transit.legs == () and transit.seconds == transit.detour_s == 0.0


def test_a_stop_retreats_along_its_view_axis():
    pose = state(38)
    stop = planner().stop(pose)
    assert np.array_equal(stop.q, pose.q[0]) and len(stop.ways_out) == 3
    assert np.array_equal(stop.ways_out[0], pose.q)
    for way, retreat in zip(stop.ways_out[1:], (0.06, 0.15), strict=True):
        frames = ARM.forward_scanner(way)
        gone = (pose.positions[0] - frames[:, :3, 3]) @ pose.directions[0]
        assert gone[0] == pytest.approx(0.0, abs=1e-9) and gone[-1] == pytest.approx(retreat)
        beside = frames[:, :3, 3] - pose.positions[0] + gone[:, None] * pose.directions[0]
        assert np.abs(beside).max() < 1e-8 and np.all(np.diff(gone) > 0)
        assert np.abs(frames[:, :3, 0] - pose.directions[0]).max() < 1e-8
        assert np.all(WORLD.free(WORLD.dense(way)[0]))
    assert len(planner().resting(HOME).ways_out) == 1


def test_a_transit_back_is_the_same_in_reverse():
    legs = (np.stack([HOME, HOME + 0.1, HOME + 0.2]), np.stack([HOME + 0.2, HOME - 0.1]))
    transit = Transit(legs, 3.0, 1.0)
    back = transit.reversed()
    assert (back.seconds, back.detour_s) == (3.0, 1.0) and len(back.legs) == 2
    assert np.array_equal(back.legs[0], legs[1][::-1])
    assert np.array_equal(back.legs[1], legs[0][::-1])
    twice = back.reversed()
    assert all(np.array_equal(a, b) for a, b in zip(twice.legs, legs, strict=True))
    assert Transit((), 0.0, 0.0).reversed().legs == ()


def test_a_planned_transit_back_is_free_too():
    made = planner()
    first, second = state(0), state(76)
    back = made.plan(made.stop(first), made.stop(second)).reversed()
    require_transit(WORLD, back, second.q[0], first.q[0])


@pytest.mark.parametrize("seed", range(3))
def test_a_wall_between_two_stops_is_led_around(seed):
    world = between_left_and_right()
    made = planner(world, seed)
    transit = made.plan(made.resting(LEFT), made.resting(RIGHT))
    require_transit(world, transit, LEFT, RIGHT)
    assert sum(length(leg) for leg in transit.legs) > 1.01 * np.linalg.norm(RIGHT - LEFT)
    again = planner(world, seed)
    same = again.plan(again.resting(LEFT), again.resting(RIGHT))
    assert all(np.array_equal(a, b) for a, b in zip(transit.legs, same.legs, strict=True))
    # Without the wall it is the straight line.
    freely = planner(CollisionWorld(CELL, None))
    direct = freely.plan(freely.resting(LEFT), freely.resting(RIGHT))
    assert direct.detour_s == 0.0 and len(direct.legs) == 1


def test_a_wall_before_home_too_is_led_around_by_a_tree():
    """Neither the straight motion nor the way by home is free: a way home has to be searched."""
    places = ARM.forward_scanner(np.stack([HOME + 0.5 * (q - HOME) for q in (LEFT, RIGHT)]))
    world = with_boxes(places[:, :3, 3], 0.08)
    assert np.all(world.free(np.stack([LEFT, RIGHT, HOME])))
    for q in (LEFT, RIGHT):
        assert not world.free_motion(q, HOME)
    made = planner(world)
    transit = made.plan(made.resting(LEFT), made.resting(RIGHT))
    require_transit(world, transit, LEFT, RIGHT)
    assert made.leads_home(made.resting(LEFT)) and made.leads_home(made.resting(RIGHT))


def shut_in():
    """A world where the arm can stand left, but a finger's breadth of motion is all it has."""

    class Closed(CollisionWorld):
        def codes(self, q, *more):
            inside = np.abs(q - LEFT).max(axis=1)
            return np.asarray((inside > 0.05) & (inside < 0.3), dtype=np.int64)

    return Closed(CELL, None)


def test_a_stop_that_is_shut_in_has_no_way_out():
    world = shut_in()
    assert np.all(world.free(np.stack([LEFT, HOME, RIGHT])))
    made = planner(world)
    shut, other = made.resting(LEFT), made.resting(RIGHT)
    assert made.plan(shut, other) is None and made.plan(other, shut) is None
    assert not made.leads_home(shut) and made.leads_home(other)
    # The others are still joined.
    require_transit(world, made.plan(other, made.resting(HOME)), RIGHT, HOME)
    # And where it can move without leaving its cage, it does.
    near = LEFT + 0.03
    assert made.plan(shut, made.resting(near)) is not None


# --- families of states -----------------------------------------------------------------------


def graph_of(world):
    few = np.array([0, 5, 10, 38, 66, 71])
    views = Views(VIEWS.positions[few], VIEWS.directions[few], VIEWS.targets[few], VIEWS.reference)
    states = find_states(world, DEXTERITY, views, 0.0, HOME)
    problem = Problem(
        world=world,
        dexterity=DEXTERITY,
        reference=VIEWS.reference,
        home=HOME,
        start=HOME,
        tcp_speed=0.2,
        velocity=VELOCITY,
        acceleration=ACCELERATION,
        seed=0,
        progress=lambda share: None,
        is_cancelled=lambda: False,
    )
    return StationGraph(problem, states)


def test_three_stops_in_vain_close_a_branch_and_only_that_one():
    graph = graph_of(WORLD)
    branch = DEXTERITY.branches(graph.states.q)
    turns = np.floor((graph.states.q + np.pi) / (2 * np.pi))
    family = np.unique(np.column_stack([branch, turns]), axis=0, return_inverse=True)[1].ravel()
    biggest = int(np.argmax(np.bincount(family)))
    nodes = np.flatnonzero(family == biggest)
    assert len(nodes) >= 3
    inside = {graph.q(int(node)).tobytes() for node in nodes}
    graph._transits.leads_home = lambda stop: stop.q.tobytes() not in inside
    every = np.arange(len(graph.states.q))
    before = graph.break_s(np.array([graph.start]), every)[0]
    assert np.all(np.isfinite(before))
    pairs = [(graph.start, int(node)) for node in nodes[:3]]
    assert [graph.close_vain_families(pair) for pair in pairs] == [False, False, True]
    after = graph.break_s(np.array([graph.start]), every)[0]
    assert np.all(np.isinf(after[nodes]))
    others = np.setdiff1d(every, nodes)
    assert len(others) and np.array_equal(after[others], before[others])
    # Straight edges within it stay: the scan may pass, it only does not stop there.
    assert np.array_equal(graph.straight_s(nodes, nodes), graph_of(WORLD).straight_s(nodes, nodes))
    layers = graph.layer_costs([0])
    view = graph.layer(0)
    assert np.array_equal(np.isinf(layers[2][0][0]), np.isin(view, nodes))


def test_stops_that_lead_home_close_nothing():
    graph = graph_of(WORLD)
    every = np.arange(len(graph.states.q))
    before = graph.break_s(every, every)
    for node in every[:6]:
        assert not graph.close_vain_families((graph.start, int(node)))
        assert not graph.close_vain_families((int(node), graph.home))
    assert np.array_equal(graph.break_s(every, every), before)


def test_obstacles_of_the_shop_stand_where_the_arm_base_sees_them():
    """And nowhere, when the arm's place is not known."""
    T_arm_map = inverse(STAND @ CELL.T_base_link_arm_base)
    place = ARM.forward_scanner(HOME[None])[0, :3, 3]
    box = Obstacle("wall", inverse(T_arm_map) @ transform(place), (0.1, 0.1, 0.1))
    cell = dataclasses.replace(CELL, obstacles=(box,))
    assert CollisionWorld(cell, None, None, T_arm_map).pair(HOME).endswith("wall")
    assert CollisionWorld(cell, None).pair(HOME) is None
