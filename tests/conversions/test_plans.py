"""Round trips of scan path, stations and trajectories; each with its illegal twin."""

from dataclasses import fields, replace

import numpy as np
import pytest

from skinplan.errors import InputError, JointsInvalidError, ScanPathInvalidError
from skinplan.mesh.model import Finding
from skinplan.plan_record import scan_path_hash, station_hash, trajectory_hash
from skinplan.scan_path.model import LeftOut, ScanPath
from skinplan.scanner.model import CoverageFigures, RegionShares
from skinplan.stations.model import SkippedPoint, Station, StationPlan
from skinplan.trajectory.model import SCAN, TRANSIT, Segment, StationTrajectory
from skinplan.transforms import planar
from skinplan_nodes import conversions as c

NAN = float("nan")


def path_of(count):
    random = np.random.default_rng(count)
    directions = random.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return ScanPath(
        random.normal(size=(count, 3)),
        directions,
        random.normal(size=(count, 3)),
        np.arange(count, dtype=np.int64) % 2,
        np.arange(count, dtype=np.int64) // 2,
        "published",
        3,
    )


def segment_of(kind, count=4):
    random = np.random.default_rng(count)
    points = np.arange(2 if kind == SCAN else 0, dtype=np.int64)
    times = np.linspace(0.0, 1.0, count)
    point_s = np.linspace(0.25, 1.0, len(points))
    return Segment(kind, times, *random.normal(size=(2, count, 6)), points, 0.25, point_s)


def plan_of(count):
    stations = tuple(
        Station(i, planar(0.5 * i, -0.8, 0.1 * i), np.arange(i, dtype=np.int64))
        for i in range(count)
    )
    skipped = (SkippedPoint(7, "no inverse kinematics"),) if count else ()
    return StationPlan("rectangles", stations, 12, count, True, 0.995, skipped)


def assert_same(found, wanted):
    for field in fields(wanted):
        a, b = getattr(found, field.name), getattr(wanted, field.name)
        if isinstance(b, np.ndarray):
            np.testing.assert_allclose(a, b, atol=1e-9)
            assert a.shape == b.shape
        elif isinstance(b, tuple):
            assert len(a) == len(b)
            for x, y in zip(a, b, strict=True):
                assert_same(x, y)
        elif isinstance(b, float):
            assert a == b or (np.isnan(a) and np.isnan(b))
        elif field.compare:
            assert a == b


@pytest.mark.parametrize("count", [0, 1, 25])
def test_scan_path_round_trip(count):
    path = path_of(count)
    facts = c.PathFacts("scene4", "ab" * 32, 100, 2.5, CoverageFigures(0.99, 0.9, 0.95, NAN))
    msg = c.scan_path_to_msg(path, facts, 1.5)
    assert_same(c.scan_path_from_msg(msg), path)
    assert msg.plan_hash == scan_path_hash(path)
    found = c.path_facts_from_msg(msg)
    assert (found.part_id, found.triangles, found.area_m2) == ("scene4", 100, 2.5)
    assert found.coverage.area_ratio == 0.99
    assert np.isnan(found.coverage.rows_only_feature_area_ratio)


def test_bound_left_out_and_regions_survive_the_round_trip():
    region = RegionShares(
        "whole part", 2.5, 0.99, 0.9, 1.0, 0.98, 0.91, (0.1, 0.2, 0.3), (0.4, 0.5, 0.6), 0.97,
        tuple(float(number) for number in range(8)),
    )  # fmt: skip
    figures = CoverageFigures(0.99, 0.9, 0.95, NAN, 3, (region,))
    left = LeftOut(np.array([0.1, 0.2, 0.3]), "too near to the part")
    path = replace(path_of(3), lower_bound=2, left_out=(left,))
    msg = c.scan_path_to_msg(path, c.PathFacts(coverage=figures))
    assert c.path_facts_from_msg(msg).coverage.regions == (region,)
    assert c.path_facts_from_msg(msg).coverage.least_views == 3
    found = c.scan_path_from_msg(msg)
    assert found.lower_bound == 2
    assert found.left_out[0].reason == left.reason
    np.testing.assert_array_equal(found.left_out[0].target, left.target)


@pytest.mark.parametrize("where", [(), ((0.1, 0.2, 0.3), (1.0, 2.0, 3.0))])
def test_finding_round_trip(where):
    finding = Finding("cracks", 3, "repaired", "welded", where)
    assert c.finding_from_msg(c.finding_to_msg(finding)) == finding


@pytest.mark.parametrize("tracker", [None, planar(1.0, -3.0, 0.7)])
def test_the_tracker_of_a_station_plan_survives_the_round_trip(tracker):
    found = c.station_plan_from_msg(
        c.station_plan_to_msg(replace(plan_of(1), T_map_tracker=tracker))
    )
    if tracker is None:
        assert found.T_map_tracker is None
    else:
        np.testing.assert_allclose(found.T_map_tracker, tracker, atol=1e-12)


def test_scan_path_without_facts_has_unknown_coverage():
    msg = c.scan_path_to_msg(path_of(2))
    assert np.isnan(msg.coverage.area_ratio)


def test_scan_path_empty_has_no_points_to_plan_on():
    with pytest.raises(ScanPathInvalidError, match="0 points"):
        c.require_points(path_of(0))


@pytest.mark.parametrize(
    "change, text",
    [
        (lambda m: setattr(m.header, "frame_id", "map"), "frame 'workpiece' is accepted"),
        (lambda m: setattr(m.points[1].position, "x", NAN), "finite positions.*number 1"),
        (lambda m: setattr(m.points[1].target, "z", NAN), "finite targets.*number 1"),
        (lambda m: setattr(m.points[2].direction, "x", 3.0), "unit directions.*number 2"),
        (lambda m: setattr(m.points[0], "kind", 7), "kinds 0 and 1"),
        (lambda m: setattr(m.points[0].position, "x", 9.0), "stated hash"),
    ],
)
def test_scan_path_refuses(change, text):
    msg = c.scan_path_to_msg(path_of(4))
    change(msg)
    with pytest.raises(ScanPathInvalidError, match=text):
        c.scan_path_from_msg(msg)


@pytest.mark.parametrize("count", [0, 3])
def test_station_plan_round_trip(count):
    plan = replace(plan_of(count), marker_quality=0.865 if count else NAN)
    msg = c.station_plan_to_msg(plan, 2.0)
    assert_same(c.station_plan_from_msg(msg), plan)
    assert msg.plan_hash == station_hash(plan)


def test_station_plan_refuses():
    msg = c.station_plan_to_msg(plan_of(2))
    msg.stations[1].pose.position.x = NAN
    with pytest.raises(InputError, match="finite"):
        c.station_plan_from_msg(msg)
    msg.header.frame_id = ""
    with pytest.raises(InputError, match="frame 'map'"):
        c.station_plan_from_msg(msg)


@pytest.mark.parametrize("rated", [(), ("published",), ("tour", 12.5, 11.0)])
@pytest.mark.parametrize("kinds", [(), (TRANSIT, SCAN, TRANSIT, SCAN, TRANSIT)])
def test_trajectories_round_trip(kinds, rated):
    trajectory = StationTrajectory(
        4, tuple(segment_of(kind) for kind in kinds), (SkippedPoint(3, "collision"),), *rated
    )
    msg = c.station_trajectory_to_msg(trajectory)
    assert_same(c.station_trajectory_from_msg(msg), trajectory)
    assert msg.breaks == trajectory.breaks
    assert msg.scan_duration == pytest.approx(trajectory.scan_s)
    plan = c.trajectory_plan_to_msg([trajectory], c.PlanTimes(3.0, 2.0))
    (found,) = c.trajectory_plan_from_msg(plan)
    assert_same(found, trajectory)
    assert plan.plan_hash == trajectory_hash([trajectory])
    assert (plan.base_duration, plan.lower_bound) == (3.0, 2.0)


def test_the_receiver_of_a_trajectory_finds_the_sender_s_hash():
    # Messages carry whole nanoseconds: some of so many times round to another microsecond then.
    segment = segment_of(SCAN, 20_000)
    times = np.sort(np.random.default_rng(0).uniform(0.0, 1.0, 20_000))
    sent = StationTrajectory(0, (replace(segment, times=times, point_s=times[-2:]),), ())
    msg = c.trajectory_plan_to_msg([sent])
    assert trajectory_hash(c.trajectory_plan_from_msg(msg)) == msg.plan_hash
    found = c.segment_from_msg(msg.stations[0].segments[0])
    assert (np.rint(found.times * 1e6) != np.rint(times * 1e6)).any()


def test_trajectory_plan_empty():
    assert c.trajectory_plan_from_msg(c.trajectory_plan_to_msg([])) == ()


def test_trajectory_refuses():
    msg = c.station_trajectory_to_msg(StationTrajectory(0, (segment_of(SCAN),), ()))
    msg.segments[0].kind = 9
    with pytest.raises(InputError, match="found 9"):
        c.station_trajectory_from_msg(msg)
    msg.segments[0].kind = SCAN
    msg.segments[0].trajectory.joint_names[0] = "base_joint"
    with pytest.raises(JointsInvalidError, match="base_joint|missing"):
        c.station_trajectory_from_msg(msg)


@pytest.mark.parametrize(
    "kind, times, text",
    [
        (SCAN, [], "found 0 for 2 points"),
        (SCAN, [0.5], "found 1 for 2 points"),
        (SCAN, [0.1, 0.2, 0.3], "found 3 for 2 points"),
        (TRANSIT, [0.5], "found 1 for 0 points"),
        (SCAN, [0.5, NAN], "number 1 is nan"),
        (SCAN, [-0.1, 0.5], "number 0 is -0.1"),
        (SCAN, [0.5, 1.1], "0 to its 1 s.*number 1 is 1.1"),
        (SCAN, [0.5, 0.4], "do not fall.*number 1 is 0.4"),
    ],
)
def test_segment_refuses_times_that_are_none_of_its_points(kind, times, text):
    msg = c.segment_to_msg(segment_of(kind))
    msg.point_times = times
    with pytest.raises(InputError, match=text):
        c.segment_from_msg(msg)


def test_segment_of_earlier_messages_without_points_needs_no_times():
    msg = c.segment_to_msg(segment_of(TRANSIT))
    msg.point_times = []
    assert len(c.segment_from_msg(msg).point_s) == 0


def test_trajectory_plan_refuses():
    plan = c.trajectory_plan_to_msg([])
    plan.header.frame_id = "map"
    with pytest.raises(InputError, match="frame 'arm_base'"):
        c.trajectory_plan_from_msg(plan)
