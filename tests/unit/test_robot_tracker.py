"""Line of sight from the tracker to the scanner."""

import dataclasses

import numpy as np
import pytest

from reach_scene import flat_panel, upright
from skinplan.errors import InputError, TrackerBlindError
from skinplan.robot.arm import ArmModel
from skinplan.robot.bodies import Bodies
from skinplan.robot.cell import CellConfig, Obstacle, TrackerSettings
from skinplan.robot.tracker import TrackerSight
from skinplan.robot.tracker_place import Postures, check_tracker, propose_tracker
from skinplan.transforms import apply, inverse, planar, transform

CELL = CellConfig()
BODIES = Bodies(ArmModel.load(CELL), CELL)
HOME = np.array(CELL.home_rad)


def postures(count=40, seed=0, places=((0.0, -0.9),)):
    """The arm anywhere, standing before a panel."""
    rng = np.random.default_rng(seed)
    q = HOME + rng.uniform(-0.8, 0.8, (count, 6))
    arms = [planar(*places[k % len(places)], 0.0) @ CELL.T_base_link_arm_base for k in range(count)]
    return Postures(q, np.array(arms))


def looking(place, at):
    """A tracker pose at a place, +x to a point."""
    x = np.subtract(at, place) / np.linalg.norm(np.subtract(at, place))
    y = np.cross([0.0, 0.0, 1.0], x)
    y /= np.linalg.norm(y)
    return transform(place, np.stack([x, y, np.cross(x, y)], axis=1))


def codes(sight, given):
    segments, T_arm_scanner = BODIES.placed(given.q)
    return sight.codes(BODIES, segments, T_arm_scanner, given.T_map_arm)


def visible_targets(sight, given, number, cell, mesh=None, T_map_workpiece=None):
    """Counts targets by sampling each line of sight every 2 mm: brute force."""
    segments, T_arm_scanner = BODIES.placed(given.q[number][None])
    T_map_arm = given.T_map_arm[number]
    origin = sight.T_map_tracker[:3, 3]
    seen = 0
    for target in sight.targets((T_map_arm @ T_arm_scanner[0])[None])[0]:
        way = target - origin
        length = np.linalg.norm(way)
        inside = cell.tracker.range_min_m <= length <= cell.tracker.range_max_m
        inside &= way @ sight.T_map_tracker[:3, 0] >= length * np.cos(cell.tracker.cone_rad)
        line = origin + np.linspace(0.0, 1.0, int(length / 0.002))[:, None] * way
        in_arm = apply(inverse(T_map_arm), line)
        for (start, end), radius, link in zip(segments[0], BODIES.radii, BODIES.names, strict=True):
            if link == "scanner":
                continue
            axis = end - start
            share = np.clip((in_arm - start) @ axis / max(axis @ axis, 1e-12), 0.0, 1.0)
            inside &= np.linalg.norm(in_arm - start - share[:, None] * axis, axis=1).min() > radius
        in_base = apply(inverse(T_map_arm @ inverse(CELL.T_base_link_arm_base)), line)
        half = 0.5 * np.array(CELL.base_size_m)
        inside &= not np.any(np.all(np.abs(in_base - [0.0, 0.0, half[2]]) <= half, axis=1))
        post = np.linalg.norm(in_base[:, :2], axis=1)
        inside &= not np.any((post < 0.08) & (in_base[:, 2] > 0.352) & (in_base[:, 2] < 0.92))
        if mesh is not None:  # the panel is the plane z = 0 inside its box
            in_part = apply(inverse(T_map_workpiece), line)
            low, high = mesh.bounds
            cross = np.diff(np.sign(in_part[:, 2])) != 0
            at = in_part[:-1][cross][:, :2]
            inside &= not np.any(np.all((at > low[:2]) & (at < high[:2]), axis=1))
        seen += inside
    return seen


@pytest.mark.parametrize(
    "place", [(0.0, -3.5, 2.2), (2.5, -1.5, 0.6), (0.0, -4.0, 0.3), (1.0, 2.5, 1.6)]
)
def test_it_agrees_with_sampled_lines_of_sight(place):
    panel, T = flat_panel(1.5, 0.8), upright()
    sight = TrackerSight(CELL, panel, T, looking(place, (0.0, -0.5, 1.2)))
    given = postures()
    found = codes(sight, given) == 0
    for number in range(len(found)):
        count = visible_targets(sight, given, number, CELL, panel, T)
        if count == CELL.tracker.targets_least or count == CELL.tracker.targets_least - 1:
            continue  # a line that grazes something may go either way
        assert found[number] == (count > CELL.tracker.targets_least), number


def test_range_and_cone():
    given = postures()
    near = looking((0.0, -1.3, 1.6), (0.0, -0.6, 1.4))
    words = TrackerSight(CELL, None, T_map_tracker=near)
    assert "range" in words.names[int(np.bincount(codes(words, given)).argmax())]
    far = TrackerSight(CELL, None, T_map_tracker=looking((0.0, -9.0, 2.0), (0.0, 0.0, 1.0)))
    assert np.all(codes(far, given) == 1)
    away = TrackerSight(CELL, None, T_map_tracker=looking((0.0, -3.5, 2.0), (0.0, -9.0, 2.0)))
    assert np.all(codes(away, given) == 2)
    assert not away.in_view(np.tile(transform((0.0, -0.5, 1.2)), (2, 1, 1))).any()


def test_part_arm_and_obstacle_hide():
    given = postures()
    behind = TrackerSight(CELL, flat_panel(), upright(), looking((0.0, 3.0, 1.2), (0.0, -0.4, 1.2)))
    assert "part" in behind.names[int(np.bincount(codes(behind, given)).argmax())]
    board = Obstacle("board", transform((0.0, -2.0, 1.5)), (4.0, 0.02, 3.0))
    cell = dataclasses.replace(CELL, obstacles=(board,))
    sight = TrackerSight(cell, None)
    found = codes(sight, given)
    assert {sight.names[int(code)] for code in np.unique(found)} >= {sight.names[-1]}
    assert "board" in sight.names[-1] and not np.any(found == 0)
    middle = np.array([0.0, -0.9, 1.3])
    turns = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    around = middle + 2.5 * np.stack([np.cos(turns), np.sin(turns), 0.0 * turns], axis=1)
    arm = [TrackerSight(CELL, None, T_map_tracker=looking(place, middle)) for place in around]
    assert any("arm" in s.names[int(c)] for s in arm for c in np.unique(codes(s, given)))


def test_fewer_targets_asked_for_never_hide_a_pose():
    given = postures(80, 1)
    hidden = []
    for least in (1, 3, 5, 8):
        cell = dataclasses.replace(CELL, tracker=TrackerSettings(targets_least=least))
        hidden.append(codes(TrackerSight(cell, None), given) > 0)
    assert all(not np.any(a & ~b) for a, b in zip(hidden, hidden[1:], strict=False))
    assert hidden[-1].sum() > hidden[0].sum()


def test_where_the_shop_has_its_origin_does_not_matter():
    given, shift = postures(), planar(3.0, 1.0, 2.0)
    panel = flat_panel()
    here = codes(TrackerSight(CELL, panel, upright()), given)
    moved = TrackerSight(CELL, panel, shift @ upright(), shift @ CELL.T_map_tracker)
    assert np.array_equal(codes(moved, Postures(given.q, shift @ given.T_map_arm)), here)


def test_a_position_is_checked_for_a_whole_plan_and_a_better_one_proposed():
    panel, T = flat_panel(), upright()
    given = postures(60, 2, ((-0.8, -0.9), (0.8, -0.9)))
    behind = looking((0.0, 3.0, 1.2), (0.0, 0.0, 1.2))
    check = check_tracker(CELL, panel, T, given, behind)
    assert not check.seen.all() and len(check.reasons) == np.sum(~check.seen)
    assert all("tracker" in reason for reason in check.reasons.values())
    place = propose_tracker(CELL, panel, T, given)
    found = check_tracker(CELL, panel, T, given, place)
    assert found.seen.mean() >= check_tracker(CELL, panel, T, given).seen.mean()
    assert np.array_equal(place, propose_tracker(CELL, panel, T, given))


def test_a_tracker_that_can_not_work_is_named():
    panel, given = flat_panel(), postures(5)
    tiny = TrackerSettings(range_min_m=0.01, range_max_m=0.1)
    cell = dataclasses.replace(CELL, tracker=tiny)
    with pytest.raises(TrackerBlindError, match="no place for the tracker"):
        propose_tracker(cell, panel, upright(), given)
    with pytest.raises(InputError, match="posture"):
        Postures(np.zeros((0, 6)), np.zeros((0, 4, 4)))
    with pytest.raises(InputError, match="T_map_tracker"):
        TrackerSight(CELL, None, T_map_tracker=np.zeros((4, 4)))
    with pytest.raises(InputError, match="T_map_workpiece"):
        TrackerSight(CELL, panel)
