"""Scan frames: points with further values in the tracker frame."""

from dataclasses import dataclass, field

import numpy as np
from sensor_msgs.msg import PointCloud2, PointField

from skinplan.errors import InputError
from skinplan.transforms import Array
from skinplan_nodes.conversions.geometry import header_to_msg, require_frame, stamp_from_msg

_KINDS = {
    PointField.INT8: "i1",
    PointField.UINT8: "u1",
    PointField.INT16: "i2",
    PointField.UINT16: "u2",
    PointField.INT32: "i4",
    PointField.UINT32: "u4",
    PointField.FLOAT32: "f4",
    PointField.FLOAT64: "f8",
}


@dataclass(frozen=True, eq=False)
class ScanFrame:
    """Points of one scan frame.

    Attributes:
        points: shape (n, 3) [m].
        values: Further values by name (``intensity``, ``incidence`` [rad]), each shape (n,).
        frame: Frame of the points.
        stamp_s: Time of the measurement [s].
    """

    points: Array
    values: dict[str, Array] = field(default_factory=dict)
    frame: str = "tracker"
    stamp_s: float = 0.0


def scan_frame_to_msg(scan: ScanFrame) -> PointCloud2:
    """Converts a scan frame; all numbers as float32.

    Raises:
        InputError: Shapes that do not fit.
    """
    columns = {
        "x": scan.points[:, 0],
        "y": scan.points[:, 1],
        "z": scan.points[:, 2],
        **scan.values,
    }
    count = len(scan.points)
    if any(np.shape(column) != (count,) for column in columns.values()):
        shapes = {name: np.shape(column) for name, column in columns.items()}
        raise InputError(
            f"scan frame: {count} values by name are accepted, found the shapes {shapes}"
        )
    table = (
        np.stack(list(columns.values()), axis=1).astype("<f4")
        if count
        else np.zeros((0, len(columns)), "<f4")
    )
    return PointCloud2(
        header=header_to_msg(scan.frame, scan.stamp_s),
        height=1,
        width=count,
        fields=[
            PointField(name=name, offset=4 * place, datatype=PointField.FLOAT32, count=1)
            for place, name in enumerate(columns)
        ],
        is_bigendian=False,
        point_step=4 * len(columns),
        row_step=4 * len(columns) * count,
        data=table.tobytes(),
        is_dense=True,
    )


def scan_frame_from_msg(msg: PointCloud2, frame: str = "tracker") -> ScanFrame:
    """Returns a scan frame; points that are not finite are left out, they are no echoes.

    Args:
        msg: Cloud with the fields x, y, z and further ones of one number each.
        frame: The frame that it must be in.

    Raises:
        InputError: Another frame, missing coordinates, an unknown kind of number, or not as many
            bytes as announced.
    """
    require_frame(msg.header, frame, "scan frame")
    kind = _kind(msg)
    count = msg.width * msg.height
    if msg.row_step < msg.width * msg.point_step or len(msg.data) != msg.row_step * msg.height:
        raise InputError(
            f"scan frame: {msg.height} rows of {msg.width} points of {msg.point_step} bytes were "
            f"announced, found {len(msg.data)} bytes in rows of {msg.row_step}"
        )
    rows = np.frombuffer(msg.data, dtype=np.uint8).reshape(msg.height, -1)
    used = np.ascontiguousarray(rows[:, : msg.width * msg.point_step])
    table = used.reshape(-1).view(kind) if count else np.zeros(0, dtype=kind)
    points = np.stack([table[axis].astype(float) for axis in "xyz"], axis=1)
    seen = np.isfinite(points).all(axis=1)
    names = [name for name in kind.names or () if name not in ("x", "y", "z")]
    values = {name: table[name][seen].astype(float) for name in names}
    return ScanFrame(points[seen], values, frame, stamp_from_msg(msg.header.stamp))


def _kind(msg: PointCloud2) -> "np.dtype[np.void]":
    order = ">" if msg.is_bigendian else "<"
    single = [field for field in msg.fields if field.count == 1]
    names = [field.name for field in single]
    if not {"x", "y", "z"} <= set(names) or len(set(names)) != len(names):
        raise InputError(
            f"scan frame: the fields x, y, z, each name once, are accepted, found {names}"
        )
    if any(field.datatype not in _KINDS for field in single):
        raise InputError(
            "scan frame: numbers as sensor_msgs/PointField names them are accepted, found others"
        )
    formats = [order + _KINDS[field.datatype] for field in single]
    try:
        return np.dtype(
            {
                "names": names,
                "formats": formats,
                "offsets": [field.offset for field in single],
                "itemsize": msg.point_step,
            }
        )
    except ValueError as error:
        raise InputError(
            f"scan frame: fields inside of the {msg.point_step} bytes of a point are accepted "
            f"({error})"
        ) from error
