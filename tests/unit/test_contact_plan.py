"""C 4: three stations, 150 points, one tracker. Measured figures are in the documentation."""

import numpy as np
import pytest

from skinplan.contact.axial_frame import axial_frame
from skinplan.contact.detour import detour
from skinplan.contact.plan import ContactPlanner, plan_contact
from skinplan.contact.settings import (
    AxialRadialSettings,
    ContactSettings,
    ProbeTool,
    TrackerLimits,
)
from skinplan.contact.transfer import along
from skinplan.errors import (
    CancelledError,
    InspectionPointsError,
    NothingReachedError,
    NoTrackerStationError,
)
from skinplan.part.engine import engine_mesh, engine_placement, engine_points
from skinplan.robot.dh import GCR14_1400
from skinplan.transforms import apply, inverse, planar, rotate, transform

PUBLISHED_Y = (-2.060877, -1.283429, -0.505981)
PUBLISHED_TRACKER = np.array([0.411241, -3.472634, 0.695565])


@pytest.fixture(scope="module")
def planner():
    points, normals, _ = engine_points()
    return ContactPlanner(points, normals, engine_mesh(30_000), engine_placement())


@pytest.fixture(scope="module")
def stations(planner):
    return planner.stations()


@pytest.fixture(scope="module")
def plan(planner):
    return planner.run(np.array([1.433, 1.350, 0.348]))


def test_the_result_has_the_published_shape(stations):
    """C Table 4: S_num = 3, y of step (3), k one of another, sum over 150, all covered."""
    assert stations.complete and len(stations.stations) == 3
    y = [station.y_m for station in stations.stations]
    assert np.abs(np.array(y) - PUBLISHED_Y).max() < 0.0005
    k = [station.k for station in stations.stations]
    assert max(k) - min(k) <= 1
    assert stations.reached_sum > 150 and stations.covered.all()
    assert [count for count, _, _ in stations.history] == [1, 2, 3]
    x = [station.x_m for station in stations.stations]
    # S1 and S2 as published; S3 one step of 0.2 m nearer (see the documentation).
    assert np.abs(np.array(x) - (1.087135, 1.098964, 1.347920 - 0.2)).max() < 0.002


def test_the_axial_frame_of_the_engine_is_its_own(planner):
    points, normals, _ = engine_points()
    assert np.allclose(planner.points, points) and np.allclose(planner.normals, normals)
    assert np.allclose(planner.T_map_axial, engine_placement())


def test_one_tracker_place_sees_the_tmac_at_all_points(planner, stations):
    points = planner.seen_from(np.array([1.433, 1.350, 0.348]), stations)
    assert points.sees.all()
    limits = ContactSettings().tracker
    assert points.emission_rad.max() <= limits.emission_max_rad
    assert points.incidence_rad.max() <= limits.incidence_max_rad
    assert points.range_m.min() >= limits.range_min_m


def test_the_published_tracker_sees_all_points_but_for_the_shortest_range(planner, stations):
    """It stands 0.9 m from the nearest mirrors: below the 1.5 m assumed here."""
    near = TrackerLimits(range_min_m=0.5)
    settings = ContactSettings(tracker=near)
    points, normals, _ = engine_points()
    other = ContactPlanner(points, normals, engine_mesh(30_000), engine_placement(), settings)
    assert other.seen_from(PUBLISHED_TRACKER, stations).sees.all()
    assert not planner.seen_from(PUBLISHED_TRACKER, stations).sees.all()


def test_every_point_is_measured_from_where_the_plan_says(planner, plan):
    """Forward kinematics by the table, fresh collision and beam checks."""
    points, normals, _ = engine_points()
    assert plan.complete and not plan.missed and np.all(plan.station_of >= 0)
    visited = np.concatenate([station.points for station in plan.stations])
    assert sorted(visited.tolist()) == list(range(150))
    for number, station in enumerate(plan.stations):
        assert np.all(plan.station_of[station.points] == number)
        assert station.reached[station.points].all()
        q = plan.q[station.points]
        flange = station.T_axial_arm @ GCR14_1400.forward(q)[:, -1]
        assert np.abs(flange - plan.T_axial_flange[station.points]).max() < 1e-9
        tip = flange[:, :3, 3] + 0.35 * flange[:, :3, 2]
        touch = tip - 0.003 * normals[station.points]
        assert np.abs(touch - points[station.points]).max() < 1e-9
        assert planner.arm.free(q, station.T_axial_arm).all()
        assert set(planner.sight.holds(plan.tracker.position, q, station.T_axial_arm)) == {""}
        mirror = station.T_axial_arm @ planner.arm.forward_mirror(q)
        assert np.abs(mirror - plan.T_axial_mirror[station.points]).max() < 1e-9


def test_every_motion_holds_all_the_way(planner, plan):
    """Dynamic check, changes of posture included; asked again at four times as many places."""
    assert len(plan.motions) == 150 - 3
    assert {motion.problem for motion in plan.motions} == {""}
    levers = planner.arm.arm.lever_arms()
    for number, station in enumerate(plan.stations):
        mine = [motion for motion in plan.motions if motion.station == number]
        assert [m.start for m in mine] == station.points[:-1].tolist()
        assert [m.end for m in mine] == station.points[1:].tolist()
        places = []
        for motion in mine:
            assert np.array_equal(motion.corners[0], plan.q[motion.start])
            assert np.array_equal(motion.corners[-1], plan.q[motion.end])
            for a, b in zip(motion.corners, motion.corners[1:], strict=False):
                count = 1 + int(np.abs(b - a) @ levers / 0.01)
                places.append(a + np.linspace(0.0, 1.0, count + 1)[:, None] * (b - a))
        q = np.concatenate(places)
        assert set(planner.sight.holds(plan.tracker.position, q, station.T_axial_arm)) == {""}
        assert planner.arm.free(q, station.T_axial_arm).all()
        assert np.all((q >= planner.arm.arm.lower) & (q <= planner.arm.arm.upper))


def test_a_way_that_nothing_leads_around_is_not_found(planner):
    arm = planner.arm.arm
    start, end = np.zeros(6), np.full(6, 0.4)

    def wall(q):
        return ["wall" if 0.1 < row[1] < 0.3 else "" for row in q]

    assert detour(arm, start, end, wall) is None
    way = detour(arm, start, end, lambda q: [""] * len(q))
    assert np.array_equal(way[0], start) and np.array_equal(way[-1], end)


def test_a_way_around_is_free_all_along(planner):
    """A wall with a gap at the fourth joint."""
    arm = planner.arm.arm
    start, end = np.full(6, -0.2), np.full(6, 0.2)

    def wall(q):
        return ["wall" if abs(row[0]) < 0.05 and row[3] < 0.4 else "" for row in q]

    way = detour(arm, start, end, wall)
    assert way is not None and len(way) > 2
    assert not any(wall(along(arm, way)))


def test_turning_the_shop_turns_the_plan():
    points, normals, _ = engine_points()
    T = planar(4.0, -3.0, 2.1)
    here = ContactPlanner(points, normals, None, engine_placement()).stations()
    there = ContactPlanner(points, normals, None, T @ engine_placement())
    found = there.stations()
    assert found.history == here.history
    for a, b in zip(here.stations, found.stations, strict=True):
        assert (a.x_m, a.y_m, a.k) == pytest.approx((b.x_m, b.y_m, b.k), abs=1e-9)
    place = there.T_map_axial @ there.place(found.stations[0].x_m, found.stations[0].y_m)
    expected = T @ engine_placement() @ planar(here.stations[0].x_m, here.stations[0].y_m, 0.0)
    assert np.allclose(place, expected, atol=1e-9)


def test_the_workpiece_frame_may_be_anywhere_in_the_part():
    points, normals, _ = engine_points()
    shift = transform((0.2, 0.3, 0.25))
    back = inverse(shift)
    here = ContactPlanner(points, normals, None, engine_placement())
    moved = ContactPlanner(
        apply(back, points), rotate(back, normals), None, engine_placement() @ shift
    )
    assert np.allclose(
        apply(here.T_map_axial, here.points), apply(moved.T_map_axial, moved.points), atol=1e-12
    )
    assert moved.points[:, 2] == pytest.approx(here.points[:, 2])


def test_points_out_of_reach_are_named_with_the_reason():
    points, normals, _ = engine_points()
    far = np.concatenate([points[::10], [[0.05, -1.2, 3.0]]])
    views = np.concatenate([normals[::10], [[1.0, 0.0, 0.0]]])
    few = AxialRadialSettings(stations_max=3)
    open_air = ContactSettings(tracker=TrackerLimits(range_max_m=30.0), stations=few)
    plan = plan_contact(far, views, None, engine_placement(), open_air)
    assert not plan.complete
    assert plan.station_of[-1] == -1 and np.isnan(plan.q[-1]).all()
    missed = {entry.point: entry.reason for entry in plan.missed}
    assert "inverse kinematics" in missed[len(far) - 1]


def test_nothing_in_reach_is_an_error():
    points, normals, _ = engine_points()
    with pytest.raises(NothingReachedError, match="none of 150 points"):
        plan_contact(points + (0.0, 0.0, 4.0), normals, None, engine_placement())


def test_a_tracker_with_impossible_limits_is_an_error():
    points, normals, _ = engine_points()
    blind = ContactSettings(tracker=TrackerLimits(range_min_m=40.0, range_max_m=50.0))
    with pytest.raises(NoTrackerStationError, match="sees the T-Mac at all of"):
        plan_contact(points[::10], normals[::10], None, engine_placement(), blind)


def test_a_longer_probe_moves_the_flange_only(planner):
    points, normals, _ = engine_points()
    tool = ProbeTool(probe_length_m=0.45)
    other = ContactPlanner(points, normals, None, engine_placement(), ContactSettings(tool=tool))
    probe = np.tile(np.eye(4), (3, 1, 1))
    gap = other.arm.flange_poses(probe) - planner.arm.flange_poses(probe)
    assert np.allclose(gap[:, :3, 3], (0.0, 0.0, -0.1))


@pytest.mark.parametrize(
    ("points", "normals", "words"),
    [
        (np.zeros((0, 3)), np.zeros((0, 3)), "none were found"),
        (np.full((2, 3), np.nan), np.eye(3)[:2], "finite"),
        (engine_points()[0] * 1000.0, engine_points()[1], "millimetres"),
        (engine_points()[0], engine_points()[1] * 2.0, "unit length"),
        (engine_points()[0], engine_points()[1][:10], r"shape \(150, 3\)"),
    ],
)
def test_bad_points_are_refused(points, normals, words):
    with pytest.raises(InspectionPointsError, match=words):
        plan_contact(points, normals, None, engine_placement())


def test_an_axis_that_is_not_level_is_refused():
    upright = transform((0.0, 0.0, 1.0), np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]))
    with pytest.raises(InspectionPointsError, match="rises by 90"):
        axial_frame(upright, 0.752)


def test_cancelling_ends_it():
    points, normals, _ = engine_points()
    with pytest.raises(CancelledError):
        plan_contact(points, normals, None, engine_placement(), is_cancelled=lambda: True)
