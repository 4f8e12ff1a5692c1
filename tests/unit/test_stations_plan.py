import dataclasses

import numpy as np
import pytest

from reach_scene import flat_panel, flat_path, in_arm_base, upright
from skinplan.errors import (
    CancelledError,
    InputError,
    NoCandidatesError,
    NothingReachedError,
    ScanPathInvalidError,
    StrategyUnknownError,
)
from skinplan.mesh.check import check_mesh
from skinplan.mesh.load import load_mesh
from skinplan.mesh.segment import segment_mesh
from skinplan.part.model import ScanSettings
from skinplan.part.samples import write_sample
from skinplan.robot.cell import CellConfig
from skinplan.robot.collision import CollisionWorld
from skinplan.robot.reach import Views, reach
from skinplan.scan_path.plan import plan_scan_path
from skinplan.stations.plan import plan_stations
from skinplan.transforms import heading, planar, transform

CELL = CellConfig()
SCAN = ScanSettings(strategy="published", station_strategy="rectangles")


def plan(path=None, T=None, mesh=None, settings=SCAN, cell=CELL, **more):
    path = flat_path() if path is None else path
    T = upright() if T is None else T
    mesh = flat_panel() if mesh is None else mesh
    return plan_stations(path, T, mesh, settings, cell, **more)


@pytest.mark.parametrize(
    ("name", "stations"), [("scene1", 2), ("scene2", 1), ("scene3", 3), ("scene4", 3)]
)
def test_the_paper_scenes_have_the_stations_of_table_1(tmp_path, name, stations):
    part = write_sample(name, tmp_path)
    mesh, _ = check_mesh(load_mesh(part.mesh_path, part.unit))
    path = plan_scan_path(mesh, segment_mesh(mesh), SCAN)
    found = plan_stations(path, part.T_map_workpiece, mesh, SCAN, CELL)
    assert len(found.stations) == stations
    assert found.proven_optimal and found.lower_bound == stations
    assert found.reached_ratio >= 0.99


def test_every_point_is_at_one_station_or_skipped():
    found = plan()
    given = [s.points for s in found.stations] + [[s.point for s in found.skipped]]
    assert sorted(np.concatenate(given).astype(int)) == list(range(len(flat_path())))
    assert [s.id for s in found.stations] == list(range(len(found.stations)))
    assert found.reached_ratio == pytest.approx(1.0 - len(found.skipped) / len(flat_path()))
    assert found.strategy == "rectangles" and found.candidates >= len(found.stations)


def test_stations_follow_along_the_part_parallel_to_it_and_on_its_free_side():
    found = plan()
    poses = [s.T_map_base_link for s in found.stations]
    x = [pose[0, 3] for pose in poses]
    assert x == sorted(x)
    assert all(abs(heading(pose)) < 1e-6 for pose in poses)
    # Rectangle 0.6 m beside the arm axis, scanner 0.3 m in front of the panel.
    assert all(-1.2 < pose[1, 3] < -0.75 for pose in poses)


def test_points_of_a_station_are_really_reached_from_it():
    path, mesh = flat_path(), flat_panel()
    for station in plan().stations:
        T = in_arm_base(CELL, station.T_map_base_link, upright())
        p = station.points
        views = Views.placed(path.positions[p], path.directions[p], path.targets[p], T)
        world = CollisionWorld(CELL, mesh, T)
        assert not reach(world, views, SCAN.tilt_max_rad, np.array(CELL.home_rad)).reasons


@pytest.mark.parametrize("turn", [0.5, -2.5])
def test_the_plan_turns_with_the_part(turn):
    shift = planar(4.0, -3.0, turn)
    moved = dataclasses.replace(CELL, T_map_tracker=shift @ CELL.T_map_tracker)
    here, there = plan(), plan(T=shift @ upright(), cell=moved)
    for a, b in zip(here.stations, there.stations, strict=True):
        assert np.allclose(shift @ a.T_map_base_link, b.T_map_base_link, atol=1e-4)
        assert np.array_equal(a.points, b.points)


def test_the_same_question_has_the_same_answer():
    a, b = plan(), plan()
    for first, second in zip(a.stations, b.stations, strict=True):
        assert np.array_equal(first.T_map_base_link, second.T_map_base_link)
        assert np.array_equal(first.points, second.points)


def test_longer_parts_have_more_stations():
    counts = [
        len(plan(flat_path(n, 0.6, 0.1), upright(0.6), flat_panel(n, 0.6)).stations)
        for n in (0.4, 1.5, 5.0)
    ]
    assert counts == [1, 2, 5]


def test_what_is_too_high_is_skipped_with_its_reason():
    path, mesh = flat_path(0.6, 1.8, 0.1), flat_panel(0.6, 1.8)
    found = plan(path, upright(1.8), mesh)
    assert 0.3 < found.reached_ratio < 0.95
    assert all("reach" in s.reason or "collision" in s.reason for s in found.skipped)
    top = path.positions[:, 1] > 0.85
    assert np.all(np.isin(np.flatnonzero(top), [s.point for s in found.skipped]))


def test_a_part_three_metres_up_is_not_reached():
    high = transform((0.0, 0.0, 3.0)) @ upright()
    with pytest.raises(NothingReachedError, match="none of the"):
        plan(T=high)


def test_a_part_that_lies_on_a_table_gives_a_plan_or_a_named_error():
    lying = transform((0.0, 0.0, 1.0))
    try:
        assert plan(flat_path(1.0, 0.3, 0.1), lying, flat_panel(1.0, 0.3)).stations
    except (NothingReachedError, NoCandidatesError) as error:
        assert str(error)


def test_an_empty_path_an_unknown_strategy_and_a_bad_pose_are_refused():
    path = flat_path()
    arrays = ("positions", "directions", "targets", "kinds", "groups")
    none = dataclasses.replace(path, **{name: getattr(path, name)[:0] for name in arrays})
    with pytest.raises(ScanPathInvalidError, match="without points"):
        plan(none)
    broken = dataclasses.replace(path, positions=path.positions * np.nan)
    with pytest.raises(ScanPathInvalidError, match="positions"):
        plan(broken)
    with pytest.raises(StrategyUnknownError, match="rectangles"):
        plan(settings=dataclasses.replace(SCAN, station_strategy="circles"))
    with pytest.raises(InputError, match="T_map_workpiece"):
        plan(T=np.full((4, 4), np.nan))


def test_a_base_that_is_wider_than_the_arm_is_long_has_no_place():
    wide = dataclasses.replace(CELL, base_size_m=(3.0, 2.6, 0.9))
    with pytest.raises(NoCandidatesError):
        plan(cell=wide)


def test_it_tells_how_far_it_is_and_stops_when_asked():
    told = []
    plan(progress=lambda share, text: told.append((share, text)))
    shares = [share for share, _ in told]
    assert shares == sorted(shares) and shares[0] == 0.0 and shares[-1] == 1.0
    with pytest.raises(CancelledError):
        plan(is_cancelled=lambda: True)
