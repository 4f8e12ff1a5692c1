"""An independent check of trajectories, written against what they promise, not how they are made.

Tolerances, and why:

- Samples carry positions and velocities; a controller may join them by lines or by cubics. By
  lines: the mean velocity of each interval keeps the limit. By cubics: of all motions through the
  samples of an interval of length h, whose mean acceleration is r and which differ from the
  trapezoid rule by d h^2, one with full acceleration and full braking has the smallest largest
  acceleration, 2 d + sqrt(4 d^2 + r^2): that keeps the limit A within 1 %. The cubic through such
  samples may exceed the velocity limit by 3/8 A h in between, and A itself by two thirds: it can't
  follow a jump of the acceleration.
- Collision is checked where no part of the arm has moved more than 10 mm since the place before, at
  half the planner's margin of 20 mm: what is between two such places is free.
- The scanner's speed is that of both interpolations at 1 ms: within 1 % by lines, within 3 % by
  cubics, for the same reason.
"""

import numpy as np

from checker_bodies import Surroundings, UrdfArm
from checker_views import scan_faults
from skinplan.trajectory.model import SCAN, TRANSIT
from skinplan.transforms import inverse

SAME = 1e-6
SPARE = 1.001
ACCELERATION_SPARE = 1.01
SPEED_SPARE = {"lines": 1.01, "cubics": 1.03}
STEP_S = 0.001
MOVE_M = 0.01
LEVERS_M = np.array([1.2, 1.2, 0.9, 0.6, 0.5, 0.4])  # of a UR5 with its scanner, rounded up
LONGEST_S = 0.2


def check_station(
    trajectory,
    path,
    T_arm_base_workpiece,
    mesh,
    settings,
    cell,
    start=None,
    T_arm_base_map=None,
    deviation_m=0.005,
):
    """Everything that is wrong with a station's trajectory, each as a sentence; [] = nothing.

    `deviation_m` bounds how far the scanner may be from the straight line between two points that
    it looks at one after another.
    """
    arm = UrdfArm(cell)
    world = Surroundings(cell, mesh, T_arm_base_workpiece, T_arm_base_map)
    found = []
    last = np.array(cell.home_rad if start is None else start)
    for number, segment in enumerate(trajectory.segments):
        faults = list(form_faults(segment, len(path)))
        if not faults:
            faults = [*_rest_faults(segment, last), *limit_faults(arm, cell, segment)]
            fine = _interpolated(segment.times, segment.positions)
            faults += collision_faults(arm, world, segment)
            faults += _length_faults(arm, segment)
            if segment.kind == SCAN:
                faults += _speed_faults(arm, segment, fine, settings.tcp_speed_m_s)
                faults += _branch_faults(arm, fine)
                faults += scan_faults(
                    arm, segment, path, T_arm_base_workpiece, mesh, settings, deviation_m
                )
        found += [f"segment {number}: {text}" for text in faults]
        if np.ndim(segment.positions) == 2 and len(segment.positions):
            last = segment.positions[-1]
    if trajectory.segments and not np.abs(last - np.array(cell.home_rad)).max() <= SAME:
        found.append("it does not end at home")
    found += _point_faults(trajectory)
    return found


def check_plan(plan, cell, deviation_m=0.005):
    """Everything that is wrong with the trajectories of a `pipeline.Plan`; [] = nothing."""
    found = []
    T_map_workpiece = plan.part.T_map_workpiece
    stations, trajectories = plan.station_plan.stations, plan.trajectories
    if [s.id for s in stations] != [t.station_id for t in trajectories]:
        return [f"{len(trajectories)} trajectories do not belong to {len(stations)} stations"]
    for station, trajectory in zip(stations, trajectories, strict=True):
        T_arm_base_map = inverse(station.T_map_base_link @ cell.T_base_link_arm_base)
        faults = check_station(
            trajectory,
            plan.path,
            T_arm_base_map @ T_map_workpiece,
            plan.prepared.mesh,
            plan.part.scan,
            cell,
            None,
            T_arm_base_map,
            deviation_m,
        )
        scanned = np.concatenate([np.zeros(0, int), *(s.points for s in trajectory.segments)])
        foreign = np.setdiff1d(scanned, station.points)
        if len(foreign):
            faults.append(f"points {foreign.tolist()} belong to other stations")
        found += [f"station {station.id}: {text}" for text in faults]
    return found + list(_whole_faults(plan)) + list(_cycle_faults(plan, cell))


def form_faults(segment, points):
    """What keeps a segment from being looked at any closer."""
    t, q, v = segment.times, segment.positions, segment.velocities
    if t.ndim != 1 or len(t) < 2 or q.shape != (len(t), 6) or v.shape != q.shape:
        yield f"samples of shapes {t.shape}, {q.shape} and {v.shape} do not belong together"
    elif not (np.all(np.isfinite(t)) and np.all(np.isfinite(q)) and np.all(np.isfinite(v))):
        yield "samples that are not finite"
    elif t[0] != 0.0 or np.any(np.diff(t) <= 0.0):
        yield "times do not rise strictly from 0"
    elif np.diff(t).max() > LONGEST_S + 1e-9:
        yield f"samples {np.diff(t).max():.3f} s apart"
    if segment.kind not in (SCAN, TRANSIT):
        yield f"kind {segment.kind}"
    if segment.kind == TRANSIT and len(segment.points):
        yield "a transit lists points"
    if segment.kind == SCAN and not len(segment.points):
        yield "a scan without points"
    if np.any(segment.points < 0) or np.any(segment.points >= points):
        yield "points that are none of the path's"
    when = segment.point_s
    if when.shape != segment.points.shape:
        yield f"{len(when)} times for {len(segment.points)} points"
    elif len(when) and not (when[0] >= 0.0 and when[-1] <= t[-1] + 1e-9):
        yield "points are passed outside the segment"
    elif np.any(np.diff(when) < 0.0):
        yield "the times of the points fall"


def limit_faults(arm, cell, segment):
    """Joint limits, by lines and by cubics between the samples."""
    t, q, v = segment.times, segment.positions, segment.velocities
    most = cell.acceleration_max_rad_s2
    h = np.diff(t)[:, None]
    mean = np.diff(q, axis=0) / h
    rate = np.diff(v, axis=0) / h
    if np.any(q < arm.lower - SAME) or np.any(q > arm.upper + SAME):
        yield "leaves the joint limits"
    listed = (np.maximum(np.abs(v).max(axis=0), np.abs(mean).max(axis=0)) / arm.velocity).max()
    if listed > SPARE:
        yield f"joint speed {listed:.3f} times the limit"
    # The cubic's velocity: a parabola whose middle Bernstein coefficient is this.
    middle = 1.5 * mean - 0.25 * (v[1:] + v[:-1])
    if np.any(np.abs(middle) > SPARE * arm.velocity + 0.375 * most * h):
        yield "joint speed beyond the limit between samples"
    if np.abs(rate).max() > SPARE * most:
        yield f"joint acceleration {np.abs(rate).max():.3f} rad/s^2"
    # Positions of about 1 rad are rounded; over a very short interval that is seen.
    defect = np.maximum(np.abs(mean - 0.5 * (v[1:] + v[:-1])) / h - 1e-14 / h**2, 0.0)
    needed = (2.0 * defect + np.sqrt(4.0 * defect**2 + rate**2)).max()
    if needed > ACCELERATION_SPARE * most:
        yield f"velocities do not belong to positions: that needs {needed:.3f} rad/s^2"


def collision_faults(arm, world, segment):
    """Contacts on the lines between the samples."""
    q = segment.positions
    joints = arm.joints(q)
    way = np.abs(np.diff(q, axis=0)) @ LEVERS_M
    cumulative = np.concatenate([[0.0], np.cumsum(way)])
    count = max(2, int(np.ceil(cumulative[-1] / MOVE_M)) + 1)
    rising = np.append(True, way > 0.0)
    places = np.linspace(0.0, cumulative[-1], count)
    fine = _columns(places, cumulative[rising], q[rising]) if rising.sum() > 1 else q[:1]
    contact = world.first_contact(arm.joints(fine))
    if contact is None:  # the samples themselves, where a corner may have been cut
        contact = world.first_contact(joints)
    if contact is not None:
        yield f"collides: {contact[0]}"


def _rest_faults(segment, last):
    jump = np.abs(segment.positions[0] - last).max()
    if jump > SAME:
        yield f"jumps by {jump:.2g} rad at its start"
    if np.abs(segment.velocities[[0, -1]]).max() > SAME:
        yield "is not at rest at its ends"


def _speed_faults(arm, segment, fine, limit):
    by_cubics = _cubic(segment, fine[0])
    for name, q in (("lines", fine[1]), ("cubics", by_cubics)):
        places = arm.scanner(q)[:, :3, 3]
        speed = np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(fine[0])
        if speed.max() > SPEED_SPARE[name] * limit:
            yield f"scanner speed {speed.max():.4f} m/s by {name} between samples"


def _branch_faults(arm, fine):
    signs = arm.branch(fine[1])
    changed = (signs.min(axis=0) < -SAME) & (signs.max(axis=0) > SAME)
    for name, change in zip(("shoulder", "elbow", "wrist"), changed, strict=True):
        if change:
            yield f"the branch of the {name} changes"


def _length_faults(arm, segment):
    places = arm.scanner(segment.positions)[:, :3, 3]
    length = np.linalg.norm(np.diff(places, axis=0), axis=1).sum()
    if abs(length - segment.tcp_path_m) > 0.01 * length + 1e-4:
        yield f"the scanner's way is {length:.3f} m long, not {segment.tcp_path_m:.3f} m"


def _point_faults(trajectory):
    scanned = [int(p) for s in trajectory.segments for p in s.points]
    twice = sorted({p for p in scanned if scanned.count(p) > 1})
    if twice:
        yield f"points {twice} are scanned more than once"
    both = sorted({s.point for s in trajectory.skipped} & set(scanned))
    if both:
        yield f"points {both} are scanned and skipped"
    if not all(s.reason for s in trajectory.skipped):
        yield "points are skipped without a reason"


def _whole_faults(plan):
    trajectories = plan.trajectories
    scanned = [int(p) for t in trajectories for s in t.segments for p in s.points]
    skipped = {s.point for t in trajectories for s in t.skipped}
    skipped |= {s.point for s in plan.station_plan.skipped}
    twice = sorted({p for p in scanned if scanned.count(p) > 1})
    if twice:
        yield f"points {twice} are scanned more than once"
    lost = sorted(set(range(len(plan.path))) - set(scanned) - skipped)
    if lost:
        yield f"points {lost} are neither scanned nor skipped with a reason"


def _cycle_faults(plan, cell):
    segments = [s for t in plan.trajectories for s in t.segments]
    poses = [s.T_map_base_link[:3, 3] for s in plan.station_plan.stations]
    drive = np.linalg.norm(np.diff(poses, axis=0), axis=1).sum()
    scans = [sum(s.kind == SCAN for s in t.segments) for t in plan.trajectories]
    expected = {
        "scan_s": sum(float(s.times[-1]) for s in segments if s.kind == SCAN),
        "transit_s": sum(float(s.times[-1]) for s in segments if s.kind == TRANSIT),
        "base_s": drive / cell.base_speed_m_s + cell.settle_s * len(poses),
        "breaks": sum(max(0, count - 1) for count in scans),
        "tcp_path_m": sum(s.tcp_path_m for s in segments if s.kind == SCAN),
    }
    expected["cycle_s"] = expected["scan_s"] + expected["transit_s"] + expected["base_s"]
    for name, value in expected.items():
        said = getattr(plan.cycle, name)
        if abs(said - value) > 1e-6:
            yield f"the cycle's {name} is {value:.6g}, not {said:.6g}"


def _interpolated(times, positions):
    fine = np.linspace(0.0, times[-1], max(2, int(times[-1] / STEP_S) + 1))
    return fine, _columns(fine, times, positions)


def _columns(places, at, values):
    return np.stack([np.interp(places, at, column) for column in values.T], axis=1)


def _cubic(segment, times):
    """The cubic Hermite motion through the samples at some times."""
    t, q, v = segment.times, segment.positions, segment.velocities
    cell = np.clip(np.searchsorted(t, times, side="right") - 1, 0, len(t) - 2)
    h = (t[cell + 1] - t[cell])[:, None]
    u = (times - t[cell])[:, None] / h
    step = q[cell + 1] - q[cell]
    start, end = v[cell] * h, v[cell + 1] * h
    return q[cell] + start * u * (1 - u) ** 2 + step * u**2 * (3 - 2 * u) - end * u**2 * (1 - u)
