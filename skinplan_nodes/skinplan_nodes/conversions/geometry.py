"""Times, headers, points and rigid transforms."""

import math
import struct
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import (
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    Transform,
    TransformStamped,
    Vector3,
)
from numpy.typing import ArrayLike
from std_msgs.msg import Header

from skinplan.errors import InputError
from skinplan.transforms import Array, quaternion, transform

_SECOND_NS = 1_000_000_000
_LENGTH_TOLERANCE = 1e-3


def stamp_to_msg(time_s: float) -> Time:
    """Converts seconds; the nearest nanosecond."""
    seconds, nanoseconds = divmod(_nanoseconds(time_s), _SECOND_NS)
    return Time(sec=seconds, nanosec=nanoseconds)


def stamp_from_msg(msg: Time) -> float:
    """Returns seconds."""
    return msg.sec + msg.nanosec * 1e-9


def raw_stamp_s(data: bytes) -> float:
    """Returns the stamp of a serialised message that begins with a header [s].

    Args:
        data: CDR: 4 bytes that tell the order of bytes, then seconds and nanoseconds.
    """
    order = "<" if data[1] & 1 else ">"
    seconds, nanoseconds = struct.unpack_from(order + "iI", data, 4)
    return float(seconds + nanoseconds * 1e-9)


def duration_to_msg(duration_s: float) -> Duration:
    """Converts seconds; the nearest nanosecond."""
    seconds, nanoseconds = divmod(_nanoseconds(duration_s), _SECOND_NS)
    return Duration(sec=seconds, nanosec=nanoseconds)


def duration_from_msg(msg: Duration) -> float:
    """Returns seconds."""
    return msg.sec + msg.nanosec * 1e-9


def header_to_msg(frame: str, stamp_s: float = 0.0) -> Header:
    """Makes a header."""
    return Header(frame_id=frame, stamp=stamp_to_msg(stamp_s))


def require_frame(header: Header, frame: str, what: str) -> None:
    """Checks the frame of what was received.

    Args:
        header: Its header.
        frame: The only frame that is accepted.
        what: Name of it, for the message.

    Raises:
        InputError: It is in another frame.
    """
    if header.frame_id != frame:
        raise InputError(f"{what}: frame {frame!r} is accepted, found {header.frame_id!r}")


def point_to_msg(point: ArrayLike) -> Point:
    """Converts a point, shape (3,) [m]."""
    x, y, z = np.asarray(point, dtype=float).tolist()
    return Point(x=x, y=y, z=z)


def vector_to_msg(vector: ArrayLike) -> Vector3:
    """Converts a vector, shape (3,)."""
    x, y, z = np.asarray(vector, dtype=float).tolist()
    return Vector3(x=x, y=y, z=z)


def xyz_from_msg(msg: Point | Vector3) -> Array:
    """Returns a point or a vector, shape (3,)."""
    return np.array([msg.x, msg.y, msg.z])


def pose_to_msg(T_a_b: Array) -> Pose:
    """Converts a rigid transform, shape (4, 4): the pose of b in a."""
    return Pose(position=point_to_msg(T_a_b[:3, 3]), orientation=_quaternion_to_msg(T_a_b))


def pose_from_msg(msg: Pose) -> Array:
    """Returns a pose as transform, shape (4, 4).

    Raises:
        InputError: A number is not finite, or the quaternion has not the length 1.
    """
    return _rigid(msg.position, msg.orientation, "pose")


def pose_stamped_to_msg(T_a_b: Array, frame: str, stamp_s: float = 0.0) -> PoseStamped:
    """Converts the pose of b in the frame a."""
    return PoseStamped(header=header_to_msg(frame, stamp_s), pose=pose_to_msg(T_a_b))


def pose_stamped_from_msg(msg: PoseStamped, frame: str, what: str = "pose") -> Array:
    """Returns a pose in a frame that must be the one asked for, shape (4, 4).

    Raises:
        InputError: Another frame, numbers that are not finite, or a quaternion that is none.
    """
    require_frame(msg.header, frame, what)
    return _rigid(msg.pose.position, msg.pose.orientation, what)


def transform_to_msg(T_a_b: Array) -> Transform:
    """Converts a rigid transform, shape (4, 4)."""
    return Transform(translation=vector_to_msg(T_a_b[:3, 3]), rotation=_quaternion_to_msg(T_a_b))


def transform_from_msg(msg: Transform) -> Array:
    """Returns a rigid transform, shape (4, 4).

    Raises:
        InputError: A number is not finite, or the quaternion has not the length 1.
    """
    return _rigid(msg.translation, msg.rotation, "transform")


def transform_stamped_to_msg(
    parent: str, child: str, T_parent_child: Array, stamp_s: float = 0.0
) -> TransformStamped:
    """Converts an edge of the frame tree."""
    return TransformStamped(
        header=header_to_msg(parent, stamp_s),
        child_frame_id=child,
        transform=transform_to_msg(T_parent_child),
    )


def transform_stamped_from_msg(msg: TransformStamped) -> tuple[str, str, Array, float]:
    """Returns parent, child, ``T_parent_child`` and time [s]; a slash before a name is left out.

    Raises:
        InputError: A name is empty, or the transform is none.
    """
    parent, child = msg.header.frame_id.lstrip("/"), msg.child_frame_id.lstrip("/")
    if not parent or not child:
        raise InputError(
            f"a transform between two named frames is accepted, found {parent!r} and {child!r}"
        )
    return parent, child, transform_from_msg(msg.transform), stamp_from_msg(msg.header.stamp)


def _quaternion_to_msg(T_a_b: Array) -> Quaternion:
    x, y, z, w = quaternion(T_a_b).tolist()
    return Quaternion(x=x, y=y, z=z, w=w)


def _rigid(position: Any, turn: Quaternion, what: str) -> Array:
    numbers = [position.x, position.y, position.z, turn.x, turn.y, turn.z, turn.w]
    if not all(math.isfinite(number) for number in numbers):
        raise InputError(f"{what}: finite numbers are accepted, found {numbers}")
    length = math.hypot(*numbers[3:])
    if abs(length - 1.0) > _LENGTH_TOLERANCE:
        raise InputError(f"{what}: a quaternion of length 1 is accepted, found length {length:g}")
    return transform(numbers[:3], numbers[3:])


def _nanoseconds(time_s: float) -> int:
    if not math.isfinite(time_s):
        raise InputError(f"a finite time is accepted, found {time_s} s")
    # Whole seconds apart: a float of today's date in seconds has no nanoseconds left.
    whole = math.floor(time_s)
    return whole * _SECOND_NS + round((time_s - whole) * _SECOND_NS)
