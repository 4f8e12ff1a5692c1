"""Hashes, plan files and the summary's document."""

import json
from dataclasses import replace

import numpy as np
import pytest

from skinplan import plan_record
from skinplan.part.model import ScanSettings
from skinplan.robot.cell import CellConfig
from skinplan.scan_path.model import FEATURE, ROW, ScanPath
from skinplan.stations.model import SkippedPoint, Station, StationPlan
from skinplan.trajectory.cycle import cycle_time
from skinplan.trajectory.model import SCAN, Segment, StationTrajectory
from skinplan.transforms import planar

ORDER_FIELDS = ("order", "order_cost", "order_bound")


def make_path(shift: float = 0.0) -> ScanPath:
    positions = np.array([[0.0, 0.0, 0.3], [0.1 + shift, 0.0, 0.3], [0.2, 0.0, 0.3]])
    targets = positions - [0.0, 0.0, 0.3]
    directions = np.tile([0.0, 0.0, -1.0], (3, 1))
    kinds, groups = np.array([ROW, ROW, FEATURE]), np.array([0, 0, 1])
    return ScanPath(positions, directions, targets, kinds, groups, "published", 1)


def make_stations() -> StationPlan:
    station = Station(0, planar(1.0, -0.8, 0.1), np.array([0, 1]))
    return StationPlan("rectangles", (station,), 7, 1, True, 2 / 3, (SkippedPoint(2, "too far"),))


def make_trajectory() -> StationTrajectory:
    times, positions = np.array([0.0, 0.5]), np.zeros((2, 6))
    return StationTrajectory(
        0, (Segment(SCAN, times, positions, positions, np.array([0, 1]), 0.1),), ()
    )


def test_hash_sees_a_micrometre_and_not_a_picometre():
    assert plan_record.scan_path_hash(make_path()) == plan_record.scan_path_hash(make_path(1e-12))
    assert plan_record.scan_path_hash(make_path()) != plan_record.scan_path_hash(make_path(2e-6))


def test_hashes_differ_by_content():
    stations = make_stations()
    moved = StationPlan(
        "rectangles", (Station(0, planar(1.0, -0.7, 0.1), np.array([0, 1])),), 7, 1, True, 1.0, ()
    )
    assert plan_record.station_hash(stations) != plan_record.station_hash(moved)
    assert plan_record.trajectory_hash([make_trajectory()]) != plan_record.trajectory_hash([])


def test_plan_files_are_plain_json(tmp_path):
    plan_record.write_plan_files(
        tmp_path / "plan",
        make_path(),
        make_stations(),
        [make_trajectory()],
        T_map_workpiece=planar(1.0, 2.0, 0.0),
    )
    names = sorted(p.name for p in (tmp_path / "plan").iterdir())
    assert names == ["scan_path.json", "stations.json", "trajectories.json"]
    stations = json.loads((tmp_path / "plan" / "stations.json").read_text())
    assert stations["stations"][0]["pose"] == pytest.approx(
        {"x_m": 1.0, "y_m": -0.8, "heading_rad": 0.1}
    )
    assert stations["workpiece"]["position_m"] == [1.0, 2.0, 0.0]
    assert stations["skipped"] == [{"point": 2, "reason": "too far"}]
    path = json.loads((tmp_path / "plan" / "scan_path.json").read_text())
    assert [point["kind"] for point in path["points"]] == ["row", "row", "feature"]
    trajectories = json.loads((tmp_path / "plan" / "trajectories.json").read_text())
    assert trajectories["stations"][0]["segments"][0]["kind"] == "scan"


def summary_of(trajectories):
    stations, path = make_stations(), make_path()
    cycle = cycle_time(stations, trajectories, CellConfig(), ScanSettings(), path)
    return plan_record.planning_summary(
        triangles=1,
        area_m2=1.0,
        mesh_sha256="",
        path=path,
        coverage=None,
        station_plan=stations,
        trajectories=trajectories,
        cycle=cycle,
        planning_s={},
    )["trajectory"]["order"]


def rated(*values):
    return replace(make_trajectory(), **dict(zip(ORDER_FIELDS, values, strict=False)))


def test_rating_of_the_order_is_summed_over_stations_where_it_is_known():
    found = summary_of([rated("tour", 12.0, 10.0), rated("tour", 6.0, 5.0)])
    assert found == {"strategy": "tour", "cost": 18.0, "bound": 15.0, "gap": pytest.approx(0.2)}
    # A station without any motion and one without a bound: no part of the gap.
    found = summary_of([rated("tour", 12.0, 10.0), rated(), rated("ants", 6.0)])
    assert found["strategy"] == "tour, ants"
    assert (found["cost"], found["bound"]) == (18.0, 10.0)
    assert found["gap"] == pytest.approx(0.2)


def test_rating_that_nobody_knows_is_none():
    unknown = {"cost": None, "bound": None, "gap": None}
    assert summary_of([rated("published")]) == {"strategy": "published", **unknown}
    assert summary_of([]) == {"strategy": None, **unknown}
    assert summary_of([rated("tour", 0.0, 0.0)])["gap"] is None


def test_rating_of_the_order_is_in_the_trajectories_file(tmp_path):
    stations = [rated("tour", 12.0, 10.0), rated()]
    plan_record.write_plan_files(tmp_path, trajectories=stations)
    written = json.loads((tmp_path / "trajectories.json").read_text())["stations"]
    assert written[0]["order"] == {
        "strategy": "tour",
        "cost": 12.0,
        "bound": 10.0,
        "gap": pytest.approx(0.2),
    }
    assert set(written[1]["order"].values()) == {None}


def test_only_what_is_given_is_written(tmp_path):
    plan_record.write_plan_files(tmp_path, path=make_path())
    assert [p.name for p in tmp_path.iterdir()] == ["scan_path.json"]


def test_plain_turns_nan_into_none():
    document = {"a": float("nan"), "b": np.float64(2.0), "c": np.array([1, 2]), "d": (np.inf, True)}
    assert plan_record.plain(document) == {"a": None, "b": 2.0, "c": [1, 2], "d": [None, True]}


def test_an_interrupted_write_leaves_the_old_file(tmp_path):
    target = tmp_path / "summary.json"
    plan_record.write_json(target, {"state": "old"})
    with pytest.raises(TypeError):
        plan_record.write_json(target, {"state": object()})
    assert json.loads(target.read_text()) == {"state": "old"}
    assert [p.name for p in tmp_path.iterdir()] == ["summary.json"]
