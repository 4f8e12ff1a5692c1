"""Strategy `reach`: its grid, its robustness, its proof, and what it says when it fails."""

import dataclasses
import itertools

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from reach_scene import flat_panel, flat_path, in_arm_base, upright
from skinplan.cover.minimum import minimum_cover
from skinplan.errors import (
    LimitsExcludeError,
    NoCandidatesError,
    NothingReachedError,
    TrackerBlindError,
)
from skinplan.part.model import ScanSettings
from skinplan.robot.arm import ArmModel
from skinplan.robot.cell import CellConfig, Obstacle
from skinplan.robot.collision import CollisionWorld
from skinplan.stations.floor_grid import floor_grid
from skinplan.stations.least_travel import least_travel
from skinplan.stations.plan import plan_stations
from skinplan.stations.problem import StationProblem
from skinplan.stations.reach_strategy import engine_for
from skinplan.stations.robust import eroded, grid_step, widened
from skinplan.stations.standing import standing
from skinplan.transforms import apply, heading, planar, rotate, transform

CELL = CellConfig()
SCAN = ScanSettings(station_strategy="reach")
PATH, PANEL = flat_path(1.2, 0.6, 0.3), flat_panel(1.2, 0.6)


def plan(path=PATH, T=None, mesh=PANEL, settings=SCAN, cell=CELL, **more):
    return plan_stations(path, upright(0.6) if T is None else T, mesh, settings, cell, **more)


@pytest.fixture(scope="module")
def found():
    return plan()


def grid_of(path=PATH, T=None, step=0.05, reach=1.2):
    T = upright(0.6) if T is None else T
    views = apply(T, path.positions), rotate(T, path.directions)
    return floor_grid(*views, np.zeros(2), reach, step)


# The grid and where the base can stand.


def test_the_grid_lies_before_the_part_parallel_to_it_and_moves_with_it():
    grid = grid_of()
    places = grid.poses[:, :2, 3]
    assert np.all(places[:, 1] < -0.29) and np.all(np.abs(places[:, 0]) < 0.6 + 0.31)
    assert all(abs(heading(pose)) < 1e-9 for pose in grid.poses)
    assert np.allclose(np.diff(np.unique(np.round(places[:, 0], 6))), 0.05)
    shift = planar(3.0, -1.0, 0.7)
    moved = grid_of(T=shift @ upright(0.6))
    assert np.array_equal(moved.cells, grid.cells)
    assert np.allclose(moved.poses, shift @ grid.poses, atol=1e-9)


def test_around_a_corner_the_base_turns():
    path = flat_path(1.2, 0.6, 0.3)
    side = planar(0.0, 0.0, np.pi / 2)
    T = upright(0.6)
    two = np.concatenate(
        [apply(T, path.positions), apply(side @ T, path.positions) + [2.0, 1.0, 0]]
    )
    looks = np.concatenate([rotate(T, path.directions), rotate(side @ T, path.directions)])
    grid = floor_grid(two, looks, np.zeros(2), 1.0, 0.2)
    headings = {round(float(np.degrees(heading(pose)))) for pose in grid.poses}
    assert len(headings) > 1 and all((h - 45) % 45 == 0 for h in headings)


def test_an_arm_beside_the_middle_of_the_base_stands_on_the_grid():
    T = upright(0.6)
    views = apply(T, PATH.positions), rotate(T, PATH.directions)
    offset = np.array([0.2, 0.05])
    shifted, centred = (floor_grid(*views, o, 1.2, 0.1) for o in (offset, np.zeros(2)))
    arms = shifted.poses[:, :2, 3] + np.einsum("nij,j->ni", shifted.poses[:, :2, :2], offset)
    assert np.allclose(arms, centred.poses[:, :2, 3])


def test_standing_agrees_with_the_check_at_one_place():
    T = transform((0.0, 0.0, -0.6)) @ upright(0.6)  # its lower edge is as low as the base
    poses = np.array([planar(0.1, -y, a) for y in np.arange(0.2, 0.6, 0.04) for a in (0.0, 0.6)])
    found = standing(CELL, PANEL, T, poses)
    free, what = found.free, found.blocked
    assert 0 < free.sum() < len(free) and what == "base with part"
    for pose, ok in zip(poses, free, strict=True):
        problem = CollisionWorld(CELL, PANEL, in_arm_base(CELL, pose, T)).base_problem()
        assert not (ok and problem)  # the check at the vertices is the weaker one


def test_nothing_stands_in_an_obstacle():
    pillar = Obstacle("pillar", transform((0.0, -0.9, 1.0)), (0.2, 0.2, 2.0))
    cell = dataclasses.replace(CELL, obstacles=(pillar,))
    poses = np.array([planar(x, -0.9, 0.0) for x in (0.0, 0.3, 0.52, 0.6)])
    found = standing(cell, PANEL, upright(0.6), poses)
    free, what = found.free, found.blocked
    assert free.tolist() == [False, False, False, True] and what == "base with pillar"


# Robustness.


def test_erosion_agrees_with_its_definition():
    rng = np.random.default_rng(3)
    cells = np.array([c for c in np.ndindex(6, 5) if rng.random() < 0.85])
    reached = rng.random((len(cells), 30)) < 0.9
    where = {tuple(cell): row for cell, row in zip(cells.tolist(), reached, strict=True)}
    result = eroded(reached, cells)
    for number, (u, v) in enumerate(cells.tolist()):
        around = [(u + i, v + j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        expected = np.all([where.get(c, np.zeros(30, dtype=bool)) for c in around], axis=0)
        assert np.array_equal(result[number], expected)
    assert eroded(reached[:0], cells[:0]).shape == (0, 30)


def test_the_step_of_the_grid_and_the_base_grow_with_the_error():
    assert grid_step(CELL) == pytest.approx(0.05)
    aside = dataclasses.replace(CELL, T_base_link_arm_base=transform((0.2, 0.0, 1.0)))
    assert grid_step(aside) == pytest.approx(0.05 + 0.2 * CELL.base_error_rad)
    assert grid_step(dataclasses.replace(CELL, base_error_m=0.0)) == pytest.approx(0.05)
    # A corner of the turned base never leaves the widened one.
    turned = planar(0.0, 0.0, CELL.base_error_rad)
    half = 0.5 * np.array(CELL.base_size_m)
    corners = apply(
        turned, np.array([[s * half[0], t * half[1], 0.0] for s in (-1, 1) for t in (-1, 1)])
    )
    assert np.all(np.abs(corners[:, :2]) <= 0.5 * np.array(widened(CELL).base_size_m[:2]))


def test_points_are_reached_wherever_the_base_stops(found):
    """At random places inside the error, not only at those that were tried."""
    assert found.robust_ratio == 1.0
    rng = np.random.default_rng(11)
    problem = StationProblem(PATH, upright(0.6), PANEL, SCAN, CELL)
    engine = engine_for(problem, (1.0,), False)
    for station in found.stations:
        shift = rng.uniform(-1.0, 1.0, (20, 3)) * [0.035, 0.035, CELL.base_error_rad]
        poses = np.array([station.T_map_base_link @ planar(*s) for s in shift])
        assert engine.table(poses).reached[:, station.points].mean() > 0.999


# The choice.


def test_least_travel_agrees_with_all_subsets():
    rng = np.random.default_rng(7)
    seen = set()
    for _ in range(60):
        size = int(rng.integers(3, 11))
        places, margins = np.sort(rng.uniform(0.0, 3.0, size)), rng.random(size)
        points = np.linspace(0.0, 3.0, 15)
        wide = rng.uniform(0.3, rng.choice([1.0, 3.5]), size)
        covers = np.abs(points[None] - places[:, None]) <= wide[:, None]
        chosen = minimum_cover(csr_matrix(covers.T)).chosen
        wanted = covers.any(axis=0)
        count = len(chosen)
        seen.add(count)

        def cost(subset, places=places, margins=margins):
            return np.ptp(places[list(subset)]) + np.sum(1.0 - margins[list(subset)])

        best = min(
            cost(s)
            for s in itertools.combinations(range(size), count)
            if np.array_equal(covers[list(s)].any(axis=0), wanted)
        )
        result = least_travel(covers, chosen, places, margins)
        assert len(result) == count and np.all(np.diff(places[result]) >= 0.0)
        assert np.array_equal(covers[result].any(axis=0), wanted)
        assert cost(result) == pytest.approx(best) or (count > 3 and cost(result) <= cost(chosen))
    assert {1, 2, 3} <= seen


def test_no_smaller_set_of_the_candidates_does_it():
    """The plan's own claim, by looking at every single candidate and every pair."""
    long_path, panel = flat_path(2.4, 0.8, 0.4), flat_panel(2.4, 0.8)
    nominal = dataclasses.replace(CELL, base_error_m=0.0)
    plan_ = plan(long_path, upright(), panel, cell=nominal)
    assert len(plan_.stations) == 2 and plan_.lower_bound == 2 and plan_.proven_optimal
    grid = floor_grid(
        apply(upright(), long_path.positions),
        rotate(upright(), long_path.directions),
        np.zeros(2),
        1.2,
        0.1,
    )
    free = standing(nominal, panel, upright(), grid.poses).free
    problem = StationProblem(long_path, upright(), panel, SCAN, nominal)
    reached = engine_for(problem, (1.0,), False).table(grid.poses[free]).reached
    assert not np.any(reached.all(axis=1))


def test_every_point_is_at_a_station_that_reaches_it(found):
    given = np.concatenate([s.points for s in found.stations])
    assert sorted(given.tolist()) == list(range(len(PATH))) and found.reached_ratio == 1.0
    table = found.records
    assert table is not None and table.reached.shape == (len(found.stations), len(PATH))
    arm = ArmModel.load(CELL)
    for row, station in enumerate(found.stations):
        place = in_arm_base(CELL, station.T_map_base_link, upright(0.6))
        world = CollisionWorld(CELL, PANEL, place)
        for point in station.points:
            record = table.record(row, int(point))
            assert record.reached and record.visible and world.pair(record.q) is None
            T = arm.forward_scanner(record.q[None])[0]
            target = apply(place, PATH.targets[point][None])[0]
            assert np.linalg.norm(T[:3, 3] + 0.3 * T[:3, 0] - target) < 1e-8


def test_the_plan_turns_with_the_shop(found):
    shift = planar(2.0, -3.0, 1.1)
    cell = dataclasses.replace(CELL, T_map_tracker=shift @ CELL.T_map_tracker)
    there = plan(T=shift @ upright(0.6), cell=cell)
    for a, b in zip(found.stations, there.stations, strict=True):
        assert np.allclose(shift @ a.T_map_base_link, b.T_map_base_link, atol=1e-6)
        assert np.array_equal(a.points, b.points)


def test_the_same_question_has_the_same_answer(found):
    again = plan()
    for a, b in zip(found.stations, again.stations, strict=True):
        assert np.array_equal(a.T_map_base_link, b.T_map_base_link)
        assert np.array_equal(a.points, b.points)


# What can not be done, and why.


def test_what_is_too_high_is_skipped_with_the_reason_at_the_best_station():
    path, panel = flat_path(0.6, 1.8, 0.2), flat_panel(0.6, 1.8)
    result = plan(path, upright(1.8), panel)
    assert 0.3 < result.reached_ratio < 1.0
    assert len(result.skipped) == round((1.0 - result.reached_ratio) * len(path))
    words = ("inverse kinematics", "singular", "collision", "tracker", "exactly on its goal")
    for skipped in result.skipped:
        assert any(word in skipped.reason for word in words), skipped.reason
        assert "at best, from" in skipped.reason


def test_a_part_three_metres_up_or_behind_a_wall_is_not_reached():
    with pytest.raises(NothingReachedError, match="inverse kinematics"):
        plan(T=transform((0.0, 0.0, 3.0)) @ upright(0.6))
    wall = Obstacle("the wall", transform((0.0, -0.42, 1.5)), (6.0, 0.06, 3.0))
    with pytest.raises((NothingReachedError, NoCandidatesError), match=r"wall|none of"):
        plan(cell=dataclasses.replace(CELL, obstacles=(wall,)))


def test_half_a_part_behind_a_wall_gives_a_plan_and_reasons():
    wall = Obstacle("the wall", transform((1.0, -0.45, 1.5)), (1.8, 0.04, 3.0))
    result = plan(cell=dataclasses.replace(CELL, obstacles=(wall,)))
    assert 0.1 < result.reached_ratio < 1.0
    assert any("the wall" in s.reason or "reach" in s.reason for s in result.skipped)


def test_no_place_for_the_base():
    wide = dataclasses.replace(CELL, base_size_m=(6.0, 6.0, 0.9))
    with pytest.raises(NoCandidatesError, match="none of the"):
        plan(cell=wide)


def test_a_tracker_that_sees_nothing_is_named():
    behind = dataclasses.replace(CELL, T_map_tracker=transform((0.0, 3.0, 1.5)))
    with pytest.raises(TrackerBlindError, match="tracker"):
        plan(cell=behind)


@pytest.mark.parametrize("strategy", ["reach", "rectangles"])
def test_without_a_place_for_the_tracker_one_is_proposed_that_sees_the_whole_plan(strategy):
    settings = dataclasses.replace(SCAN, station_strategy=strategy)
    # Where the cell's tracker stands it sees nothing; that it is not given must not matter.
    nowhere = dataclasses.replace(CELL, T_map_tracker=transform((0.0, 50.0, 2.0)))
    proposed = plan(cell=dataclasses.replace(nowhere, propose_tracker=True), settings=settings)
    assert proposed.reached_ratio == 1.0
    given = dataclasses.replace(CELL, T_map_tracker=proposed.T_map_tracker)
    again = plan(cell=given, settings=settings)
    assert again.reached_ratio == 1.0
    for one, other in zip(proposed.stations, again.stations, strict=True):
        np.testing.assert_array_equal(one.points, other.points)
        np.testing.assert_array_equal(one.T_map_base_link, other.T_map_base_link)
    with pytest.raises((TrackerBlindError, NothingReachedError)):
        plan(cell=nowhere, settings=settings)


def test_limits_that_exclude_everything_are_named(tmp_path):
    from skinplan.robot.arm import _MODELS

    urdf = (_MODELS / "ur5.urdf").read_text(encoding="utf-8")
    tight = urdf.replace(
        'lower="-6.283185307179586" upper="6.283185307179586"', 'lower="2.9" upper="3.0"'
    )
    file = tmp_path / "ur5_tight.urdf"
    file.write_text(tight, encoding="utf-8")
    (tmp_path / "ur5_tight.srdf").write_text(
        (_MODELS / "ur5.srdf").read_text(encoding="utf-8"), encoding="utf-8"
    )
    with pytest.raises(LimitsExcludeError, match="joint limits"):
        plan(cell=dataclasses.replace(CELL, robot=str(file)))


def test_without_base_error_nothing_is_asked_of_the_neighbours():
    exact = plan(cell=dataclasses.replace(CELL, base_error_m=0.0))
    assert exact.reached_ratio == 1.0 and len(exact.stations) <= 1


@pytest.mark.parametrize(
    ("strategy", "name", "most"),
    [
        pytest.param(strategy, f"scene{number}", most, marks=marks)
        for strategy, counts, marked in (
            ("published", (2, 1, 2, 3), (pytest.mark.long,) * 4),
            ("coverage", (2, 1, 2, 2), (pytest.mark.long, (), pytest.mark.long, ())),
        )
        for number, (most, marks) in enumerate(zip(counts, marked, strict=True), start=1)
    ],
)
def test_the_paper_scenes_need_no_more_stations_than_table_1(scene_plan, strategy, name, most):
    plan = scene_plan(name, strategy=strategy, station_strategy="reach")
    part, path, mesh, result = plan.part, plan.path, plan.prepared.mesh, plan.station_plan
    assert len(result.stations) <= most
    assert result.proven_optimal and result.lower_bound == len(result.stations)
    least = 1.0 if strategy == "coverage" else 0.995
    assert result.reached_ratio >= least and result.robust_ratio >= least
    # A sample of the records, by a fresh world at each station.
    for row, station in enumerate(result.stations):
        place = in_arm_base(CELL, station.T_map_base_link, part.T_map_workpiece)
        q = result.records.q[row, station.points[::7]]
        assert np.all(CollisionWorld(CELL, mesh, place).free(q))
        T = ArmModel.load(CELL).forward_scanner(q)
        gap = apply(place, path.targets[station.points[::7]]) - T[:, :3, 3]
        depth = np.einsum("ni,ni->n", gap, T[:, :3, 0])
        assert np.abs(gap - depth[:, None] * T[:, :3, 0]).max() < 1e-8
