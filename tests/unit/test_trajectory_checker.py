"""Does the checker find what is wrong? A good trajectory is damaged in each way."""

import dataclasses
import types

import numpy as np
import pytest

from checker_bodies import Surroundings, UrdfArm
from reach_scene import flat_panel, flat_path, in_arm_base, upright
from skinplan.part.model import ScanSettings
from skinplan.robot.arm import ArmModel
from skinplan.robot.cell import CellConfig, Obstacle
from skinplan.robot.collision import CollisionWorld
from skinplan.stations.model import SkippedPoint, Station
from skinplan.trajectory.cycle import cycle_time
from skinplan.trajectory.model import SCAN, TRANSIT, Segment, StationTrajectory
from skinplan.trajectory.plan import plan_station_trajectory
from skinplan.transforms import inverse, planar, transform
from trajectory_checker import check_plan, check_station

CELL = CellConfig()
SETTINGS = ScanSettings()
PANEL = flat_panel(0.6, 0.4)
PATH = flat_path(0.6, 0.4, 0.1)
STAND = planar(0.0, -0.9, 0.0)
T_MAP_PART = upright(0.4)
T = in_arm_base(CELL, STAND, T_MAP_PART)
T_ARM_MAP = inverse(STAND @ CELL.T_base_link_arm_base)
ARM = UrdfArm(CELL)
HOME = np.array(CELL.home_rad)


@pytest.fixture(scope="module")
def good():
    return plan_station_trajectory(PATH, np.arange(len(PATH)), T, PANEL, SETTINGS, CELL)


def faults(trajectory, **more):
    given = {"mesh": PANEL, "settings": SETTINGS, "cell": CELL, "path": PATH} | more
    path, mesh, settings, cell = (given.pop(k) for k in ("path", "mesh", "settings", "cell"))
    return check_station(trajectory, path, T, mesh, settings, cell, **given)


def with_segment(trajectory, number, **changes):
    segments = list(trajectory.segments)
    segments[number] = dataclasses.replace(segments[number], **changes)
    return dataclasses.replace(trajectory, segments=tuple(segments))


def scan_number(trajectory):
    return next(n for n, s in enumerate(trajectory.segments) if s.kind == SCAN)


def named(found, *texts):
    """All texts stand in the faults, and no fault is empty."""
    return all(any(text in fault for fault in found) for text in texts) and all(found)


def moving(corners, seconds=6.0, count=400):
    """A transit through joint positions, smooth from rest to rest on each leg."""
    corners = np.asarray(corners, dtype=float)
    times, q, v = [np.zeros(1)], [corners[:1]], [np.zeros((1, 6))]
    for a, b in zip(corners, corners[1:], strict=False):
        u = np.linspace(0.0, 1.0, count)[1:, None]
        times.append(times[-1][-1] + seconds * u[:, 0])
        q.append(a + (10 * u**3 - 15 * u**4 + 6 * u**5) * (b - a))
        v.append((30 * u**2 - 60 * u**3 + 30 * u**4) * (b - a) / seconds)
    times, q, v = np.concatenate(times), np.vstack(q), np.vstack(v)
    places = ARM.scanner(q)[:, :3, 3]
    way = np.linalg.norm(np.diff(places, axis=0), axis=1).sum()
    return Segment(TRANSIT, times, q, v, np.zeros(0, dtype=int), way)


def test_nothing_is_wrong_with_the_good_one(good):
    assert faults(good) == []
    assert faults(good, T_arm_base_map=T_ARM_MAP) == []
    assert [s.kind for s in good.segments] == [TRANSIT, SCAN, TRANSIT]


def test_a_smooth_transit_alone_is_fine():
    away = HOME + [0.4, 0.1, -0.1, 0.1, 0.1, 0.3]
    assert faults(StationTrajectory(0, (moving([HOME, away, HOME]),), ())) == []


def test_a_jump_between_segments(good):
    later = good.segments[1].positions + [1e-5, 0, 0, 0, 0, 0]
    found = faults(with_segment(good, 1, positions=later))
    assert named(found, "segment 1: jumps by 1e-05 rad", "segment 2: jumps")


def test_a_jump_inside_a_segment(good):
    q = good.segments[1].positions.copy()
    q[len(q) // 2 :] += [0.0, 0.0, 0.0, 0.0, 0.0, 0.3]
    assert named(faults(with_segment(good, 1, positions=q)), "segment 1: joint speed")


def test_too_fast(good):
    segment = good.segments[0]
    top = np.abs(segment.velocities).max()
    factor = 1.01 * np.pi / top
    quick = {"times": segment.times / factor, "velocities": segment.velocities * factor}
    assert named(faults(with_segment(good, 0, **quick)), "segment 0: joint speed", "acceleration")


def test_too_much_acceleration(good):
    segment = good.segments[0]
    quick = {"times": segment.times / 1.05, "velocities": segment.velocities * 1.05}
    assert named(faults(with_segment(good, 0, **quick)), "segment 0: joint acceleration")


def test_velocities_of_another_motion(good):
    segment = good.segments[0]
    v = segment.velocities * np.linspace(1.0, 0.8, len(segment.times))[:, None]
    found = faults(with_segment(good, 0, velocities=v))
    assert named(found, "velocities do not belong to positions: that needs")


@pytest.mark.parametrize(("size", "fine"), [(1.0, True), (1.009, True), (1.02, False)])
def test_full_acceleration_and_full_braking_within_one_interval_is_allowed(size, fine):
    """From rest to rest in 0.1 s with 5 rad/s^2 a joint goes 5 * 0.05^2, and no farther."""
    away = HOME + [0.0, 0.0, 0.0, 0.0, 0.0, size * 5.0 * 0.05**2]
    corners = np.stack([HOME, away, HOME])
    none = np.zeros(0, dtype=int)
    segment = Segment(TRANSIT, np.array([0.0, 0.1, 0.2]), corners, np.zeros((3, 6)), none, 0.0)
    found = faults(StationTrajectory(0, (segment,), ()))
    assert found == [] if fine else named(found, f"that needs {5 * size:.3f} rad/s^2")


def test_a_speed_that_only_cubics_have():
    """Rests listed at both ends of a step that is driven fast."""
    away = HOME + [0.0, 0.0, 0.0, 0.0, 0.0, 0.6]
    segment = Segment(
        TRANSIT,
        np.array([0.0, 0.2, 0.4]),
        np.stack([HOME, away, HOME]),
        np.zeros((3, 6)),
        np.zeros(0, dtype=int),
        0.0,
    )
    found = faults(StationTrajectory(0, (segment,), ()))
    assert named(found, "joint speed beyond the limit between samples", "that needs")


def test_the_scanner_too_fast(good):
    number = scan_number(good)
    segment = good.segments[number]
    quick = {
        "times": segment.times / 1.05,
        "velocities": segment.velocities * 1.05,
        "point_s": segment.point_s / 1.05,
    }
    found = faults(with_segment(good, number, **quick))
    assert named(found, "scanner speed 0.2", "by lines", "by cubics")


def test_out_of_the_joint_limits():
    around = HOME + [0.0, 0.0, 0.0, 0.0, 0.0, 8.0]
    found = faults(StationTrajectory(0, (moving([HOME, around, HOME], 20.0),), ()))
    assert named(found, "leaves the joint limits")


def test_through_the_part():
    """Stretched out toward the panel, and through it."""
    into = np.array([np.pi / 2, -0.3, 0.3, 0.0, np.pi / 2, 0.0])
    aim = ARM.scanner(into[None])[0]
    depth = (inverse(T) @ aim)[2, 3]
    assert depth < 0.1
    found = faults(StationTrajectory(0, (moving([HOME, into, HOME], 12.0, 800),), ()))
    assert any("collides" in f and ("part" in f or "fixture" in f) for f in found)


@pytest.mark.parametrize(
    ("change", "pair"),
    [
        ([0.0, -2.5, 0.0, 0.0, 0.0, 0.0], "upper_arm_link with the pedestal"),
        ([0.0, 0.0, 0.75, 0.0, 0.0, 0.0], "shoulder_link with forearm_link"),
        ([0.0, 0.0, 0.0, 2.0, 0.0, 0.0], "upper_arm_link with scanner"),
        ([0.0, 0.0, 0.0, 0.0, 2.25, 0.0], "forearm_link with wrist_3_link"),
        ([-1.4, 3.3, -1.8, -0.3, -1.4, 0.0], "forearm_link with the base"),
    ],
)
def test_each_kind_of_contact_is_named(change, pair):
    contact = Surroundings(CELL, PANEL, T, None).first_contact(ARM.joints(HOME[None] + change))
    assert contact == (pair, 0)
    assert CollisionWorld(CELL, PANEL, T).pair(HOME + change) is not None


@pytest.mark.parametrize("seed", range(4))
def test_contacts_agree_with_the_librarys_check(seed):
    """Random postures: free with the whole margin is free with half of it, and the other way."""
    rng = np.random.default_rng(seed)
    q = HOME + rng.uniform(-1.2, 1.2, size=(150, 6))
    ours = Surroundings(CELL, PANEL, T, T_ARM_MAP)
    joints = ARM.joints(q)
    meets = np.array([ours.first_contact(joints[n : n + 1]) is not None for n in range(len(q))])
    half = dataclasses.replace(CELL, collision_margin_m=0.5 * CELL.collision_margin_m)
    theirs = ~CollisionWorld(half, PANEL, T, T_ARM_MAP).free(q)
    assert 20 < np.count_nonzero(meets) < 130
    assert np.array_equal(meets, theirs)
    assert not np.any(meets & CollisionWorld(CELL, PANEL, T, T_ARM_MAP).free(q))


def test_through_the_arm_itself():
    found = faults(StationTrajectory(0, (moving([HOME, HOME + [0, 0, 0.75, 0, 0, 0], HOME]),), ()))
    assert named(found, "collides: shoulder_link with forearm_link")
    found = faults(StationTrajectory(0, (moving([HOME, HOME + [0, 0, 0, 2.0, 0, 0], HOME]),), ()))
    assert named(found, "collides: upper_arm_link with scanner")


def test_through_the_floor():
    tall = dataclasses.replace(CELL, T_base_link_arm_base=transform((0.9, 0.0, 0.6)))
    down = np.array([0.0, 0.7, 0.2, 0.3, 1.4, 0.0])
    way = (moving([HOME, [0.0, -1.5, 0.2, 0.3, 1.4, 0.0], down], 8.0, 800),)
    found = faults(StationTrajectory(0, way, ()), cell=tall)
    assert named(found, "with the floor", "does not end at home")


def test_through_an_obstacle(good):
    """A box where the scanner passes between home and its first point."""
    q = good.segments[0].positions[len(good.segments[0].positions) // 2]
    place = inverse(T_ARM_MAP) @ ARM.scanner(q[None])[0]
    box = Obstacle("a crate", transform(place[:3, 3]), (0.05, 0.05, 0.05))
    cell = dataclasses.replace(CELL, obstacles=(box,))
    assert named(faults(good, cell=cell, T_arm_base_map=T_ARM_MAP), "scanner with a crate")
    assert faults(good, cell=cell) == []  # nobody said where it is


def test_a_point_that_is_not_looked_at(good):
    number = scan_number(good)
    segment = good.segments[number]
    points = segment.points.copy()
    points[[2, 5]] = points[[5, 2]]
    found = faults(with_segment(good, number, points=points))
    assert named(found, f"point {points[2]} is not looked at", f"point {points[5]} is not looked")


def test_points_at_the_wrong_time(good):
    number = scan_number(good)
    late = np.minimum(good.segments[number].point_s + 0.1, good.segments[number].times[-1])
    found = faults(with_segment(good, number, point_s=late))
    assert named(found, "is not looked at at its time")
    falling = good.segments[number].point_s[::-1]
    assert named(faults(with_segment(good, number, point_s=falling)), "times of the points fall")
    few = good.segments[number].point_s[:-1]
    assert named(faults(with_segment(good, number, point_s=few)), "times for")


def test_a_view_under_too_large_an_angle(good):
    settings = dataclasses.replace(SETTINGS, tilt_max_rad=0.0)
    aside = [0.0, np.sin(0.05), 1.0 - np.cos(0.05)]
    turned = dataclasses.replace(PATH, directions=PATH.directions + aside)
    found = faults(good, path=turned, settings=settings)
    assert named(found, "is looked at under 2.9 degrees")


def test_beside_the_straight_way(good):
    """Half a wave of 8 mm between two points, slow enough for every limit."""
    number = scan_number(good)
    segment = good.segments[number]
    begin, end = segment.point_s[2:4]
    inside = (segment.times > begin) & (segment.times < end)
    share = np.where(inside, (segment.times - begin) / (end - begin), 0.0)
    wave = 0.012 * np.sin(np.pi * share) ** 2
    q = segment.positions + wave[:, None] * np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    found = faults(with_segment(good, number, positions=q))
    assert named(found, f"straight way from point {segment.points[2]} to point {segment.points[3]}")


def test_out_of_range_and_too_oblique(good):
    """The same way, with a scanner that is asked for more: only where the straight way is fine."""
    number = scan_number(good)
    segment = good.segments[number]
    begin, end = segment.point_s[2:4]
    inside = (segment.times > begin) & (segment.times < end)
    share = np.where(inside, (segment.times - begin) / (end - begin), 0.0)
    wave = np.sin(np.pi * share) ** 2
    q = segment.positions + wave[:, None] * np.array([0.0, 0.15, 0.0, 0.6, 0.0, 0.0])
    settings = dataclasses.replace(SETTINGS, range_min_m=0.28, range_max_m=0.32)
    narrow = dataclasses.replace(settings, incidence_max_rad=0.3)
    found = faults(with_segment(good, number, positions=q), settings=narrow)
    assert named(found, "m outside the range", "rad beyond the limit")


def test_another_branch_inside_a_scan(good):
    """A scan that goes on through the stretched wrist: q5 changes its sign."""
    number = scan_number(good)
    segment = good.segments[number]
    q = segment.positions.copy()
    middle = len(q) // 2
    q[middle:, 4] = q[middle:, 4] - 2.0 * q[middle, 4]
    found = faults(with_segment(good, number, positions=q))
    assert named(found, "the branch of the wrist changes")


@pytest.mark.parametrize("seed", range(3))
def test_the_branch_is_told_by_its_signs(seed):
    """All eight solutions of one pose have eight different signs; a small motion keeps them."""
    rng = np.random.default_rng(seed)
    arm = ArmModel.load(CELL)
    q = HOME + rng.uniform(-0.3, 0.3, 6)
    branches, valid = arm.inverse(arm.forward(q[None]))
    signs = np.sign(ARM.branch(branches[0][valid[0]]))
    assert len({tuple(s) for s in signs.tolist()}) == np.count_nonzero(valid) >= 4
    nearby = np.sign(ARM.branch(q + rng.uniform(-0.01, 0.01, size=(50, 6))))
    assert np.all(nearby == np.sign(ARM.branch(q[None])))


def test_times_that_do_not_rise(good):
    times = good.segments[1].times.copy()
    times[5] = times[4]
    assert named(faults(with_segment(good, 1, times=times)), "segment 1: times do not rise")
    later = good.segments[1].times + 0.5
    assert named(faults(with_segment(good, 1, times=later)), "segment 1: times do not rise")


def test_a_wrong_start_and_a_wrong_end(good):
    assert named(faults(good, start=HOME + 0.01), "segment 0: jumps by 0.01 rad")
    short = dataclasses.replace(good, segments=good.segments[:-1])
    assert named(faults(short), "does not end at home")


def test_no_rest_at_the_ends(good):
    v = good.segments[1].velocities.copy()
    v[-1] = 1e-3
    assert named(faults(with_segment(good, 1, velocities=v)), "is not at rest")


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"positions": np.full((3, 6), np.nan)}, "do not belong together"),
        ({"points": np.array([0, 99])}, "none of the path's"),
        ({"points": np.zeros(0, dtype=int), "point_s": np.zeros(0)}, "a scan without points"),
        ({"kind": TRANSIT}, "a transit lists points"),
        ({"kind": 7}, "kind 7"),
        ({"tcp_path_m": 0.5}, "the scanner's way is"),
    ],
)
def test_what_is_no_segment(good, changes, text):
    assert named(faults(with_segment(good, 1, **changes)), text)


def test_values_that_are_not_finite(good):
    q = good.segments[1].positions.copy()
    q[3, 3] = np.nan
    assert named(faults(with_segment(good, 1, positions=q)), "samples that are not finite")


def test_points_twice_or_skipped_as_well(good):
    number = scan_number(good)
    points = good.segments[number].points.copy()
    points[1] = points[0]
    found = faults(with_segment(good, number, points=points))
    assert named(found, f"points [{points[0]}] are scanned more than once")
    skipped = (SkippedPoint(int(points[0]), "too far"), SkippedPoint(3, ""))
    found = faults(dataclasses.replace(good, skipped=skipped))
    assert named(found, "are scanned and skipped", "skipped without a reason")


def whole(trajectory, **changes):
    """As much of a plan as the checker looks at."""
    station = Station(0, STAND, np.arange(len(PATH)))
    stations = types.SimpleNamespace(stations=(station,), skipped=())
    cycle = cycle_time(stations, [trajectory], CELL, SETTINGS, PATH)
    part = types.SimpleNamespace(T_map_workpiece=T_MAP_PART, scan=SETTINGS)
    prepared = types.SimpleNamespace(mesh=PANEL)
    plan = types.SimpleNamespace(
        part=part,
        prepared=prepared,
        path=PATH,
        station_plan=stations,
        trajectories=(trajectory,),
        cycle=cycle,
    )
    for name, value in changes.items():
        setattr(plan, name, value)
    return plan


def inside_a_straight_run(points):
    """The first place in an order of visit where the scanner goes straight on."""
    step = np.diff(PATH.positions[points], axis=0)
    unit = step / np.linalg.norm(step, axis=1, keepdims=True)
    straight = np.einsum("ni,ni->n", unit[1:], unit[:-1]) > 1.0 - 1e-9
    assert straight.any()
    return int(np.argmax(straight)) + 1


def test_a_whole_plan_is_fine_or_named(good):
    assert check_plan(whole(good), CELL) == []
    number = scan_number(good)
    segment = good.segments[number]
    at = inside_a_straight_run(segment.points)
    kept = np.arange(len(segment.points)) != at
    fewer = {"points": segment.points[kept], "point_s": segment.point_s[kept]}
    fewer = with_segment(good, number, **fewer)
    lost = int(segment.points[at])
    assert named(check_plan(whole(fewer), CELL), f"points [{lost}] are neither scanned nor skipped")
    skipped = dataclasses.replace(fewer, skipped=(SkippedPoint(lost, "out of reach"),))
    assert check_plan(whole(skipped), CELL) == []
    other = dataclasses.replace(good, station_id=3)
    assert named(check_plan(whole(other), CELL), "do not belong to")


def test_the_figures_of_the_cycle_add_up(good):
    cycle = whole(good).cycle
    names = ("scan_s", "transit_s", "base_s", "cycle_s", "tcp_path_m", "breaks")
    wrong = dataclasses.replace(cycle, **{name: getattr(cycle, name) + 1 for name in names})
    found = check_plan(whole(good, cycle=wrong), CELL)
    assert len(found) == len(names)
    assert named(found, *(f"the cycle's {name} is" for name in names))


def test_points_of_another_station(good):
    plan = whole(good)
    few = Station(0, STAND, np.arange(5))
    plan.station_plan = types.SimpleNamespace(stations=(few,), skipped=())
    assert named(check_plan(plan, CELL), "belong to other stations")
