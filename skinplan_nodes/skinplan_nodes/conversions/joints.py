"""Joints: always mapped by name, never by place."""

from collections.abc import Sequence

import numpy as np
from control_msgs.msg import JointTolerance
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from skinplan.errors import JointsInvalidError
from skinplan.robot.arm import JOINT_NAMES
from skinplan.transforms import Array
from skinplan_nodes.conversions.geometry import (
    duration_from_msg,
    duration_to_msg,
    header_to_msg,
)


def joint_state_to_msg(
    positions: Array, velocities: Array | None = None, stamp_s: float = 0.0
) -> JointState:
    """Converts joint positions, shape (6,) [rad], and velocities, shape (6,) [rad/s]."""
    return JointState(
        header=header_to_msg("", stamp_s),
        name=list(JOINT_NAMES),
        position=np.asarray(positions, dtype=float).tolist(),
        velocity=[] if velocities is None else np.asarray(velocities, dtype=float).tolist(),
    )


def joint_state_from_msg(
    msg: JointState, names: Sequence[str] = JOINT_NAMES
) -> tuple[Array, Array]:
    """Returns positions [rad] and velocities [rad/s] in the order of the names, shape (n,) each.

    A state may have joints of other devices, too; velocities that it does not have are NaN.

    Raises:
        JointsInvalidError: A joint is missing or named twice, there are not as many positions as
            names, or a position is not finite.
    """
    order = _order(msg.name, names, "joint state")
    if len(msg.position) != len(msg.name) or len(msg.velocity) not in (0, len(msg.name)):
        raise JointsInvalidError(
            f"joint state: {len(msg.name)} positions and as many velocities or none are "
            f"accepted, found {len(msg.position)} and {len(msg.velocity)}"
        )
    positions = np.array(msg.position, dtype=float)[order]
    if not np.isfinite(positions).all():
        raise JointsInvalidError(
            f"joint state: finite positions are accepted, found {positions.tolist()}"
        )
    if len(msg.velocity) == 0:
        return positions, np.full(len(order), np.nan)
    return positions, np.array(msg.velocity, dtype=float)[order]


def joint_trajectory_to_msg(
    times: Array, positions: Array, velocities: Array | None = None, stamp_s: float = 0.0
) -> JointTrajectory:
    """Converts a joint trajectory.

    Args:
        times: From the start, shape (t,) [s].
        positions: shape (t, 6) [rad].
        velocities: shape (t, 6) [rad/s]; None = left out.
        stamp_s: When to start [s]; 0 = at once.
    """
    points = [
        JointTrajectoryPoint(
            positions=np.asarray(position, dtype=float).tolist(),
            time_from_start=duration_to_msg(float(time)),
        )
        for time, position in zip(times, positions, strict=True)
    ]
    if velocities is not None:
        for point, velocity in zip(points, velocities, strict=True):
            point.velocities = np.asarray(velocity, dtype=float).tolist()
    return JointTrajectory(
        header=header_to_msg("", stamp_s), joint_names=list(JOINT_NAMES), points=points
    )


def joint_trajectory_from_msg(
    msg: JointTrajectory, names: Sequence[str] = JOINT_NAMES
) -> tuple[Array, Array, Array]:
    """Returns times [s], positions [rad] and velocities [rad/s] in the order of the names.

    Velocities are zero where the trajectory has none. An empty trajectory gives empty arrays.

    Returns:
        shape (t,), (t, n), (t, n).

    Raises:
        JointsInvalidError: A joint is missing, unknown or named twice, a point has another number
            of values, or a value is not finite.
    """
    if not msg.joint_names and not msg.points:
        return np.zeros(0), np.zeros((0, len(names))), np.zeros((0, len(names)))
    order = _order(msg.joint_names, names, "joint trajectory")
    unknown = [name for name in msg.joint_names if name not in names]
    if unknown:
        raise JointsInvalidError(
            f"joint trajectory: the joints {list(names)} are accepted, found also {unknown}"
        )
    for number, point in enumerate(msg.points):
        if len(point.positions) != len(names) or len(point.velocities) not in (0, len(names)):
            raise JointsInvalidError(
                f"joint trajectory: point {number} has {len(point.positions)} positions and "
                f"{len(point.velocities)} velocities; {len(names)} and {len(names)} or 0 are "
                f"accepted"
            )
    shape = (-1, len(names))
    times = np.array(
        [duration_from_msg(point.time_from_start) for point in msg.points], dtype=float
    )
    positions = np.array([point.positions for point in msg.points], dtype=float).reshape(shape)
    none = [0.0] * len(names)
    velocities = np.array([list(p.velocities) or none for p in msg.points], dtype=float).reshape(
        shape
    )
    if not (np.isfinite(positions).all() and np.isfinite(velocities).all()):
        raise JointsInvalidError(
            "joint trajectory: finite positions and velocities are accepted, found others"
        )
    return times, positions[:, order], velocities[:, order]


def joint_tolerances_from_msg(
    msgs: Sequence[JointTolerance], defaults: Array, names: Sequence[str] = JOINT_NAMES
) -> tuple[Array, Array]:
    """Returns how far joints may be off, positions [rad] and velocities [rad/s], shape (n,) each.

    Args:
        msgs: Tolerances by joint; 0 = the default, negative = no limit.
        defaults: Of the positions, shape (n,) [rad]; velocities have no limit by default.
        names: Joints in the order of the result.

    Raises:
        JointsInvalidError: A joint that is unknown or named twice, or a value that is NaN.
    """
    found = np.array([defaults, np.full(len(names), np.inf)], dtype=float)
    seen: set[str] = set()
    for msg in msgs:
        values = (msg.position, msg.velocity)
        if msg.name not in names or msg.name in seen or np.isnan(values).any():
            raise JointsInvalidError(
                f"joint tolerances: numbers for each of {list(names)} at most once are accepted, "
                f"found {msg.name!r} with {values}"
            )
        seen.add(msg.name)
        for kind, value in enumerate(values):
            if value != 0.0:
                found[kind, list(names).index(msg.name)] = value if value > 0.0 else np.inf
    return found[0], found[1]


def start_from_msg(msg: JointState) -> Array | None:
    """Returns the positions to start from, shape (6,) [rad]; None = home: the message is empty.

    Raises:
        JointsInvalidError: As `joint_state_from_msg`.
    """
    if not msg.name and not msg.position:
        return None
    return joint_state_from_msg(msg)[0]


def _order(found: Sequence[str], names: Sequence[str], what: str) -> list[int]:
    places = {name: place for place, name in enumerate(found)}
    if len(places) != len(found):
        raise JointsInvalidError(f"{what}: every joint once is accepted, found {list(found)}")
    missing = [name for name in names if name not in places]
    if missing:
        raise JointsInvalidError(
            f"{what}: the joints {list(names)} are accepted, {missing} are missing"
        )
    return [places[name] for name in names]
