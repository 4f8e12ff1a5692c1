"""From above one point to above another around a curved surface.

The probe's direction turns evenly, its ball runs on the arc that both directions suggest: the
middle of an arc that turns by alpha over a chord c stands ``c/2 tan(alpha/4)`` off the chord.
"""

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from skinplan.contact.probing_arm import ProbingArm
from skinplan.robot.arm import ArmModel
from skinplan.transforms import Array

_STEP_RAD = 0.15
_STEP_M = 0.10
_LARGEST_JUMP_RAD = 0.6
_CHECK_M = 0.04  # no body moves farther between two places that are checked


def transfer(arm: ProbingArm, start: Array, end: Array) -> Array:
    """Returns joint positions between two, both included, shape (k, 6) [rad].

    Args:
        arm: Arm and tool.
        start: Joint positions, shape (6,) [rad].
        end: Same.

    Returns:
        Points of the arc, to be joined straight in joint space; only the two ends where the arm
        can't follow the arc in its branch.
    """
    T_tool0_probe = arm.settings.tool.T_tool0_probe
    poses = arm.arm.forward(np.stack([start, end])) @ T_tool0_probe
    turn = Rotation.from_matrix(poses[:, :3, :3])
    angle = float((turn[0].inv() * turn[1]).magnitude())
    way = poses[1, :3, 3] - poses[0, :3, 3]
    count = int(np.ceil(max(angle / _STEP_RAD, float(np.linalg.norm(way)) / _STEP_M)))
    if count < 2:
        return np.stack([start, end])
    share = np.arange(1, count) / count
    between = np.tile(np.eye(4), (count - 1, 1, 1))
    between[:, :3, :3] = Slerp([0.0, 1.0], turn)(share).as_matrix()
    bend = float(np.arccos(np.clip(poses[0, :3, 2] @ poses[1, :3, 2], -1.0, 1.0)))
    height = 0.5 * float(np.linalg.norm(way)) * np.tan(0.25 * bend) * 4.0 * share * (1.0 - share)
    line = poses[0, :3, 3] + share[:, None] * way
    between[:, :3, 3] = line - height[:, None] * between[:, :3, 2]
    return _followed(arm, start, end, between)


def _followed(arm: ProbingArm, start: Array, end: Array, T_arm_probe: Array) -> Array:
    branches, _, inside = arm.solve(T_arm_probe)
    way = [start]
    for candidates, usable in zip(branches, inside, strict=True):
        gaps = np.where(usable, np.abs(candidates - way[-1]).max(axis=1), np.inf)
        best = int(np.argmin(gaps))
        if not gaps[best] < _LARGEST_JUMP_RAD:
            return np.stack([start, end])
        way.append(candidates[best])
    if np.abs(way[-1] - end).max() >= _LARGEST_JUMP_RAD:
        return np.stack([start, end])
    return np.stack([*way, end])


def along(arm: ArmModel, corners: Array) -> Array:
    """Returns joint positions along a polyline in joint space that are to be checked.

    Args:
        arm: The arm.
        corners: Joint positions, shape (k, 6) [rad].

    Returns:
        shape (m, 6) [rad]; no body moves more than 40 mm from one to the next.
    """
    levers = arm.lever_arms()
    parts = []
    for a, b in zip(corners, corners[1:], strict=False):
        count = max(2, int(np.ceil(float(np.abs(b - a) @ levers) / _CHECK_M)))
        parts.append(a + np.linspace(0.0, 1.0, count + 1)[:, None] * (b - a))
    return np.concatenate(parts)
