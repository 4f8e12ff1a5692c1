"""Two stations before a flat panel, with trajectories made by hand: where the arm is when is known.

The joint positions come from the arm's own inverse kinematics, the times are made up.
"""

import numpy as np

from reach_scene import UPRIGHT, flat_panel, flat_path
from skinplan.mesh.model import Segmentation
from skinplan.part.model import ScanSettings
from skinplan.robot.arm import ArmModel
from skinplan.robot.cell import CellConfig
from skinplan.robot.scanner_pose import tool_poses
from skinplan.scanner.model import ScannerModel
from skinplan.stations.model import SkippedPoint, Station, StationPlan
from skinplan.trajectory.cycle import cycle_time
from skinplan.trajectory.model import SCAN, TRANSIT, Segment, StationTrajectory
from skinplan.transforms import apply, inverse, planar, rotate, transform
from skinplan.view.subject import Subject

CELL = CellConfig()
ARM = ArmModel.load(CELL)
HOME = np.array(CELL.home_rad)
PANEL = flat_panel(1.2, 0.6)
PATH = flat_path(1.0, 0.4, 0.1)  # 5 rows of 11 points
HIGH = transform((0.0, 0.0, 1.25), UPRIGHT)
POSES = (planar(-0.25, -0.9, 0.0), planar(0.35, -0.9, 0.0))
SKIPPED = SkippedPoint(21, "collision of wrist with part")
SCAN_SETTINGS = ScanSettings()


def joints_at(station, points):
    """Joint positions in which the scanner stands at points, in one branch, shape (p, 6)."""
    T = inverse(POSES[station] @ CELL.T_base_link_arm_base) @ HIGH
    looks = rotate(T, PATH.directions[points])
    places = apply(T, PATH.positions[points])
    poses = tool_poses(places, looks, 0.0, ARM.T_tool0_scanner, looks[0])
    branches, found = ARM.inverse(poses)
    result, last = [], HOME
    for own, valid in zip(branches, found, strict=True):
        usable = own[valid & ARM.within_limits(own)]
        last = usable[np.argmin(np.abs(usable - last).sum(axis=1))]
        result.append(last)
    return np.array(result)


def segment(kind, times, positions, points=()):
    """A segment through joint positions at times; at rest at its ends."""
    times, positions = np.asarray(times, float), np.asarray(positions, float)
    velocities = np.zeros_like(positions)
    if len(times) > 2:
        velocities[1:-1] = (positions[2:] - positions[:-2]) / (times[2:] - times[:-2])[:, None]
    passed = np.asarray(points, dtype=np.int64)
    point_s = times[: len(passed)] if kind == SCAN else np.zeros(0)
    return Segment(kind, times, positions, velocities, passed, 0.0, point_s)


def first_station():
    """Home, 2 s to row 2, scan 5 points in 4 s, break of 3 s, scan 4 points in 3 s, 2 s home."""
    row, other = np.arange(22, 27), np.arange(11, 15)
    a, b = joints_at(0, row), joints_at(0, other)
    return (
        segment(TRANSIT, [0, 2], [HOME, a[0]]),
        segment(SCAN, np.arange(5), a, row),
        segment(TRANSIT, [0, 3], [a[-1], b[0]]),
        segment(SCAN, np.arange(4), b, other),
        segment(TRANSIT, [0, 2], [b[-1], HOME]),
    )


def second_station():
    """Home, 1 s to row 2, scan 6 points in 5 s, 1 s home."""
    row = np.arange(27, 33)
    a = joints_at(1, row)
    return (
        segment(TRANSIT, [0, 1], [HOME, a[0]]),
        segment(SCAN, np.arange(6), a, row),
        segment(TRANSIT, [0, 1], [a[-1], HOME]),
    )


def subject_of(segments, part_id="hand made", skipped=((SKIPPED,), ()), of_stations=()):
    """A subject with these segments at its stations, (first, second); None = no trajectory."""
    owned = (np.array([*range(22, 27), *range(11, 15), SKIPPED.point]), np.arange(27, 33))
    stations = tuple(Station(n, POSES[n], owned[n]) for n in range(2))
    plan = StationPlan("reach", stations, 9, 2, True, 1.0, tuple(of_stations))
    trajectories = tuple(
        StationTrajectory(n, own, skipped[n]) for n, own in enumerate(segments) if own is not None
    )
    return Subject(
        part_id,
        PANEL,
        Segmentation(np.zeros(len(PANEL.faces), dtype=np.int64), PANEL),
        path=PATH,
        scanner=ScannerModel.from_settings(SCAN_SETTINGS),
        station_plan=plan,
        skipped=(*of_stations, *(entry for t in trajectories for entry in t.skipped)),
        T_map_workpiece=HIGH,
        cell=CELL,
        trajectories=trajectories,
        cycle=cycle_time(plan, trajectories, CELL, SCAN_SETTINGS, PATH) if trajectories else None,
        tcp_speed_m_s=SCAN_SETTINGS.tcp_speed_m_s,
        order_strategy="published",
    )
