"""What a scan keeps on disk: frames, estimates of the part's place, and their bytes."""

import struct
from dataclasses import dataclass

import numpy as np

from skinplan.transforms import Array

_FRAME = struct.Struct("<cd3d?cI")
_POSE = struct.Struct("<cd16d")


@dataclass(frozen=True, eq=False)
class FrameRecord:
    """A frame that was taken in.

    Attributes:
        stamp_s: Its time [s].
        direction: View direction of the scanner, tracker frame, shape (3,).
        partial: Some of its points were left out.
        points: Tracker frame, shape (n, 3) [m].
        intensity: shape (n,); NaN = not known.
        incidence: shape (n,) [rad]; NaN = not known.
    """

    stamp_s: float
    direction: Array
    partial: bool
    points: Array
    intensity: Array
    incidence: Array


@dataclass(frozen=True, eq=False)
class PoseRecord:
    """An estimate of where the part stands.

    Attributes:
        stand: Which stand of the base it is of.
        T_tracker_workpiece: shape (4, 4) [m].
    """

    stand: float
    T_tracker_workpiece: Array


@dataclass(frozen=True)
class HiddenRecord:
    """A frame that the tracker did not see."""


Record = FrameRecord | PoseRecord | HiddenRecord


def packed(record: Record) -> bytes:
    """Returns the bytes of a record."""
    if isinstance(record, HiddenRecord):
        return b"H"
    if isinstance(record, PoseRecord):
        return _POSE.pack(b"P", record.stand, *np.ravel(record.T_tracker_workpiece))
    # Coordinates come as float32 from most scanners; then nothing is lost by keeping them so.
    small = record.points.astype("<f4")
    kind = b"f" if np.array_equal(small, record.points) else b"d"
    points = small if kind == b"f" else record.points.astype("<f8")
    head = _FRAME.pack(
        b"F", record.stamp_s, *record.direction, record.partial, kind, len(record.points)
    )
    values = np.stack([record.intensity, record.incidence]).astype("<f4")
    return head + points.tobytes() + values.tobytes()


def unpacked(payload: bytes) -> Record | None:
    """Returns a record of its bytes; None = of an unknown kind, or damaged."""
    try:
        return _read(payload)
    except ValueError:
        return None


def _read(payload: bytes) -> Record | None:
    kind = payload[:1]
    if kind == b"H":
        return HiddenRecord()
    if kind == b"P" and len(payload) == _POSE.size:
        _, stand, *numbers = _POSE.unpack(payload)
        return PoseRecord(stand, np.array(numbers).reshape(4, 4))
    if kind != b"F" or len(payload) < _FRAME.size:
        return None
    _, stamp_s, x, y, z, partial, wide, count = _FRAME.unpack_from(payload)
    dtype = "<f4" if wide == b"f" else "<f8"
    points = np.frombuffer(payload, dtype, 3 * count, _FRAME.size)
    rest = _FRAME.size + points.nbytes
    values = np.frombuffer(payload, "<f4", 2 * count, rest).reshape(2, count).astype(float)
    direction = np.array([x, y, z])
    placed = points.reshape(count, 3).astype(float)
    return FrameRecord(stamp_s, direction, partial, placed, values[0], values[1])
