"""A flat panel with a scan path, standing upright, and an independent check of trajectories."""

import dataclasses

import numpy as np

from meshes import grid
from skinplan.robot.arm import ArmModel
from skinplan.robot.collision import CollisionWorld
from skinplan.scan_path.model import FEATURE, ROW, ScanPath
from skinplan.trajectory.model import SCAN
from skinplan.transforms import inverse, planar, transform

UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
STANDOFF_M = 0.3


def flat_panel(length=2.9, height=0.8):
    """A flat panel in the plane z = 0, outside +z."""
    return grid(length, height, 0.05)


def path_of(targets, directions, kinds, groups):
    targets, directions = np.asarray(targets, float), np.asarray(directions, float)
    return ScanPath(
        targets - STANDOFF_M * directions,
        directions,
        targets,
        np.asarray(kinds, dtype=np.int64),
        np.asarray(groups, dtype=np.int64),
        "published",
        int(np.max(np.where(np.asarray(kinds) == FEATURE, groups, 0), initial=0)),
    )


def flat_path(length=2.9, height=0.8, spacing=0.08):
    """Rows along x over a flat panel."""
    x = np.linspace(-0.5 * length, 0.5 * length, round(length / spacing) + 1)
    y = np.linspace(-0.5 * height, 0.5 * height, round(height / spacing) + 1)
    targets = np.array([(u, v, 0.0) for v in y for u in x])
    views = np.tile([0.0, 0.0, -1.0], (len(targets), 1))
    return path_of(targets, views, np.full(len(targets), ROW), np.repeat(np.arange(len(y)), len(x)))


def upright(height=0.8, turn=0.0):
    """Nominal T_map_workpiece of a panel, turned about the vertical."""
    return planar(0.0, 0.0, turn) @ transform((0.0, 0.0, max(1.05, 0.55 + 0.5 * height)), UPRIGHT)


def in_arm_base(cell, T_map_base_link, T_map_workpiece):
    return inverse(T_map_base_link @ cell.T_base_link_arm_base) @ T_map_workpiece


def problems(trajectory, path, T_arm_base_workpiece, mesh, settings, cell, start=None):
    """Checks a trajectory with means of its own; returns everything that is wrong with it."""
    arm = ArmModel.load(cell)
    # Half the margin: between checked places bodies come a little nearer than at them.
    world = CollisionWorld(
        dataclasses.replace(cell, collision_margin_m=0.5 * cell.collision_margin_m),
        mesh,
        T_arm_base_workpiece,
    )
    found = []
    last = np.array(cell.home_rad if start is None else start)
    for number, segment in enumerate(trajectory.segments):
        name = f"segment {number}"
        q, v, t = segment.positions, segment.velocities, segment.times
        if t[0] != 0.0 or np.any(np.diff(t) <= 0.0):
            found.append(f"{name}: times do not rise from 0")
        if np.abs(q[0] - last).max() > 1e-6:
            found.append(f"{name}: jumps by {np.abs(q[0] - last).max():.2g} rad at its start")
        if max(np.abs(v[0]).max(), np.abs(v[-1]).max()) > 1e-6:
            found.append(f"{name}: is not at rest at its ends")
        last = q[-1]
        found += [f"{name}: {text}" for text in _limit_problems(arm, cell, t, q, v)]
        fine = _interpolated(t, q, 0.005)
        if not np.all(world.free(fine[1])):
            found.append(f"{name}: collides: {world.pair(fine[1][~world.free(fine[1])][0])}")
        if segment.kind == SCAN:
            found += [f"{name}: {text}" for text in _scan_problems(
                arm, segment, path, T_arm_base_workpiece, settings, fine
            )]  # fmt: skip
    if np.abs(last - cell.home_rad).max() > 1e-6:
        found.append("does not end at home")
    return found


def _interpolated(times, positions, step):
    fine = np.linspace(0.0, times[-1], max(2, int(times[-1] / step) + 1))
    return fine, np.stack([np.interp(fine, times, positions[:, j]) for j in range(6)], axis=1)


def _limit_problems(arm, cell, t, q, v):
    step = np.diff(t)[:, None]
    if not np.all((q >= arm.lower) & (q <= arm.upper)):
        yield "leaves the joint limits"
    speed = max(np.abs(v).max(), np.abs(np.diff(q, axis=0) / step).max())
    if speed > cell.velocity_max_rad_s + 1e-6:
        yield f"joint speed {speed:.3f} rad/s"
    rate = np.abs(np.diff(v, axis=0) / step).max()
    if rate > cell.acceleration_max_rad_s2 * 1.001:
        yield f"joint acceleration {rate:.3f} rad/s^2"
    # Positions and velocities belong together: the trapezoid rule holds to the acceleration's size.
    drift = np.abs(np.diff(q, axis=0) - 0.5 * (v[1:] + v[:-1]) * step).max()
    if drift > 0.5 * cell.acceleration_max_rad_s2 * step.max() ** 2:
        yield f"velocities do not belong to positions ({drift:.2g} rad)"
    if step.max() > 0.201:
        yield f"samples {step.max():.3f} s apart"


def _scan_problems(arm, segment, path, T_arm_base_workpiece, settings, fine):
    times, q = fine
    T = inverse(T_arm_base_workpiece) @ arm.forward_scanner(q)
    speed = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1) / np.diff(times)
    if speed.max() > settings.tcp_speed_m_s * 1.01:
        yield f"scanner speed {speed.max():.4f} m/s"
    for point in segment.points:
        gap = path.targets[point] - T[:, :3, 3]
        depth = np.einsum("ni,ni->n", gap, T[:, :3, 0])
        beside = np.linalg.norm(gap - depth[:, None] * T[:, :3, 0], axis=1)
        lean = np.arccos(np.clip(T[:, :3, 0] @ path.directions[point], -1.0, 1.0))
        standoff = np.linalg.norm(path.targets[point] - path.positions[point])
        seen = (beside < 0.003) & (np.abs(depth - standoff) < 0.003)
        if not np.any(seen & (lean < settings.tilt_max_rad + 0.02)):
            yield f"point {point} is listed, but not looked at"
