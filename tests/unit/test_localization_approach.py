"""The approach-retry loop with a base that stops beside its goals."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from approach_cell import START_ROOM_M
from localization_scene import (
    CAMERA,
    CELL,
    T_MAP_WORKPIECE,
    T_OPTICAL,
    base_facing,
    camera_pose,
    observed,
    row_fixture,
)
from skinplan.errors import QualityNotReachedError
from skinplan.localization.approach import next_goal, stop_miss_m
from skinplan.localization.pose import locate
from skinplan.localization.way import SLANT_RAD, swept
from skinplan.mock.base import BaseConfig, MockBase
from skinplan.robot.cell import CellConfig
from skinplan.transforms import difference, heading, planar, transform

FIXTURE = row_fixture()
EXACT = replace(CELL, base_error_m=0.0, base_error_rad=0.0)


def located(T_map_base_link, fixture=FIXTURE, T_map_workpiece=T_MAP_WORKPIECE):
    truth = camera_pose(T_map_base_link, T_map_workpiece)
    return locate(observed(truth, fixture), CAMERA, fixture, CELL.quality)


def test_oblique_view_is_faced_at_the_same_distance():
    """The goal's optical axis is the normal through the centre of the markers seen."""
    start = base_facing(0.0, 2.0, 0.9)
    pose = located(start)
    goal = next_goal(start, pose, FIXTURE, CAMERA, EXACT)
    assert goal.phase == "turning"
    assert goal.distance_m == pytest.approx(pose.distance_m)
    centre = np.mean([FIXTURE.T_workpiece_marker(i)[0, 3] for i in pose.marker_ids])
    expected = base_facing(centre, 2.0 * np.cos(0.9), 0.0)
    np.testing.assert_allclose(goal.T_map_base_link, expected, atol=1e-6)


def test_faced_view_is_approached_by_half_the_way_to_d_min():
    start = base_facing(0.0, 2.2, 0.0)
    goal = next_goal(start, located(start), FIXTURE, CAMERA, EXACT)
    assert goal.phase == "advancing"
    assert goal.distance_m == pytest.approx(2.2 - 0.5 * (2.2 - CELL.quality.distance_min_m))
    expected = base_facing(0.0, goal.distance_m, 0.0)
    np.testing.assert_allclose(goal.T_map_base_link, expected, atol=1e-6)


def test_the_goal_moves_with_the_map():
    """A rigid motion of the floor changes nothing but the coordinates."""
    shift = planar(3.0, -1.0, 2.1)
    start = base_facing(0.3, 2.0, 0.5)
    goal = next_goal(start, located(start), FIXTURE, CAMERA, CELL)
    pose = located(shift @ start, T_map_workpiece=shift @ T_MAP_WORKPIECE)
    moved = next_goal(shift @ start, pose, FIXTURE, CAMERA, CELL)
    assert max(difference(moved.T_map_base_link, shift @ goal.T_map_base_link)) < 1e-6


def test_nothing_is_left_to_do_at_the_safe_distance():
    near = CELL.quality.distance_min_m + stop_miss_m(CELL, 0.4)
    start = base_facing(0.0, near, 0.0)
    assert next_goal(start, located(start), FIXTURE, CAMERA, CELL) is None


def test_high_markers_keep_the_camera_away():
    """A marker far above the axis would leave the image: the goal stays farther off."""
    high = replace(FIXTURE, T_workpiece_fixture=transform((0.0, -0.1, 0.0)))
    start = base_facing(0.0, 1.9, 0.0)
    goal = next_goal(start, located(start, high), high, CAMERA, CELL)
    assert goal.distance_m > 1.4
    seen = observed(camera_pose(goal.T_map_base_link), high)
    assert len(seen.markers) >= 2


def test_markers_that_lie_flat_are_refused():
    flat = T_MAP_WORKPIECE @ transform(rotation=[[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    pose = replace(
        located(base_facing(0, 1.5, 0)),
        T_camera_workpiece=camera_pose(base_facing(0, 1.5, 0), flat),
    )
    with pytest.raises(QualityNotReachedError, match="lie flat"):
        next_goal(base_facing(0, 1.5, 0), pose, FIXTURE, CAMERA, CELL)


def test_the_camera_keeps_its_distance_and_looks_at_the_part_while_driving():
    """Of a way without errors: d_min holds, and drives are slanted by no more than the bound."""
    for seed in range(40):
        base, _ = random_start(seed)
        here = base.believed
        goal = next_goal(here, located(here), FIXTURE, CAMERA, CELL)
        if goal is None:
            continue
        nearest = np.inf
        for start, stop in pairwise([here, *goal.stops]):
            poses = swept(start, stop)
            nearest = min(nearest, *(-(pose @ T_OPTICAL)[1, 3] for pose in poses))
            moved = np.linalg.norm(np.diff(poses[:, :2, 3], axis=0), axis=1) > 1e-9
            slants = [abs(heading(pose)) for pose, on in zip(poses[1:], moved, strict=True) if on]
            assert max(slants, default=0.0) <= SLANT_RAD + 1e-6, seed
        assert nearest == pytest.approx(goal.clearance_m, abs=1e-6)
        assert nearest >= CELL.quality.distance_min_m + 2.0 * CELL.base_error_m


def test_the_swept_way_is_the_one_of_the_base():
    """Turn, drive forward or backward, turn: as the mock base does it."""
    random = np.random.default_rng(6)
    for seed in range(30):
        start, stop = (planar(*random.uniform(-2, 2, 2), random.uniform(-3, 3)) for _ in range(2))
        base = MockBase(BaseConfig(), EXACT, seed, start)
        base.goal(stop)
        way = swept(start, stop)
        for now in np.linspace(0.0, base.remaining_s, 25):
            base.step(now)
            apart = np.abs(way[:, :2] - base.true[:2]).max(axis=(1, 2))
            assert apart.min() < 0.03, seed


def random_start(seed):
    """A stand from which at least two markers are seen: up to 3 m away and 60 degrees aside."""
    random = np.random.default_rng(seed)
    while True:
        low, high = [-1.0, 0.9, -np.pi / 3, -0.2], [1.0, 3.0, np.pi / 3, 0.2]
        x, distance, angle, turn = random.uniform(low, high)
        if distance * np.cos(angle) < CELL.quality.distance_min_m + START_ROOM_M:
            continue
        base = MockBase(BaseConfig(), CELL, seed, base_facing(x, distance, angle, turn))
        if len(observed(camera_pose(base.true), FIXTURE).markers) >= 2:
            return base, random


def approach(seed, cell: CellConfig):
    """Runs the loop; returns E of every estimate and how near the camera came on its ways."""
    base, random = random_start(seed)
    reached, nearest, now = [], np.inf, 0.0
    for _ in range(cell.quality.max_attempts):
        seen = observed(camera_pose(base.true), FIXTURE, random, 0.05)
        pose = locate(seen, CAMERA, FIXTURE, cell.quality)
        reached.append(pose.quality)
        if pose.quality >= cell.quality.threshold:
            break
        goal = next_goal(base.believed, pose, FIXTURE, CAMERA, cell)
        if goal is None:
            break
        for stop in goal.stops:
            base.goal(stop, now)
            begin, now = now, now + base.remaining_s
            for at in np.linspace(begin, now, 40):
                base.step(at)
                nearest = min(nearest, -(base.true @ T_OPTICAL)[1, 3])
    return reached, nearest


def test_a_hundred_approaches_reach_the_quality_and_keep_the_distance():
    for seed in range(100):
        reached, nearest = approach(seed, CELL)
        assert reached[-1] >= CELL.quality.threshold, seed
        assert len(reached) <= 5, seed
        assert nearest >= CELL.quality.distance_min_m, seed


def test_an_unreachable_quality_ends_at_the_safe_distance():
    cell = replace(CELL, quality=replace(CELL.quality, threshold=1.0, max_attempts=30))
    for seed in range(10):
        reached, nearest = approach(seed, cell)
        assert max(reached) < 1.0
        assert len(reached) < 30, "the loop has to end by itself"
        assert nearest >= cell.quality.distance_min_m
