"""Exports the scan frames of a bag as one cloud per topic and frame."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from skinplan.errors import BagInvalidError, InputError
from skinplan.recording.reader import BagReader
from skinplan.recording.tables import decoded, topics_of

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_PLY = {"i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint"}
_PLY |= {"f4": "float", "f8": "double"}
# LAS keeps whole multiples of this [m].
_LAS_STEP_M = 1e-5


def write_clouds(reader: BagReader, folder: Path, kind: str) -> Iterator[tuple[Path, int]]:
    """Writes all point clouds, frame after frame, in the frame in which they were recorded.

    Args:
        reader: The bag.
        folder: Where to write.
        kind: ``ply`` or ``laz``.

    Yields:
        File and number of points.

    Raises:
        InputError: LAZ without its packages.
        BagInvalidError: A cloud is damaged, or its fields change.
    """
    if kind == "laz":
        _require_laspy()
    for topic in topics_of(reader, "sensor_msgs/msg/PointCloud2"):
        pieces: dict[str, list[np.ndarray]] = {}
        for _, _, cloud in decoded(reader, [topic]):
            found = _points(topic.name, cloud)
            mine = pieces.setdefault(cloud["header"]["frame_id"], [])
            if mine and mine[0].dtype != found.dtype:
                raise BagInvalidError(f"{topic.name}: clouds of the same fields are accepted")
            mine.append(found)
        for frame, arrays in pieces.items():
            points = np.concatenate(arrays)
            name = f"{topic.name.strip('/').replace('/', '_')}.{frame or 'none'}.{kind}"
            path = folder / name.replace("/", "_")
            (_write_ply if kind == "ply" else _write_laz)(path, points)
            yield path, len(points)


def _points(topic: str, cloud: dict[str, Any]) -> np.ndarray:
    """Returns the points of one message as a structured array; only finite ones."""
    try:
        order = ">" if cloud["is_bigendian"] else "<"
        fields = [(f["name"], order + _TYPES[f["datatype"]], f["offset"]) for f in cloud["fields"]]
        names, formats, offsets = zip(*fields, strict=True)
        layout = np.dtype(
            {
                "names": names,
                "formats": formats,
                "offsets": offsets,
                "itemsize": cloud["point_step"],
            }
        )
        count = cloud["width"] * cloud["height"]
        data = np.frombuffer(cloud["data"].tobytes(), layout, count)
        packed = np.empty(len(data), [(name, kind[1:]) for name, kind, _ in fields])
        for name in names:
            packed[name] = data[name]
        finite = np.isfinite(packed["x"]) & np.isfinite(packed["y"]) & np.isfinite(packed["z"])
        return packed[finite]
    except (ValueError, KeyError, TypeError) as error:
        raise BagInvalidError(
            f"{topic}: clouds with fields x, y, z are accepted, one can't be read ({error})"
        ) from error


def _write_ply(path: Path, points: np.ndarray) -> None:
    names = points.dtype.names or ()
    kinds = [_PLY[points.dtype[name].str[1:]] for name in names]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    lines += [f"property {kind} {name}" for kind, name in zip(kinds, names, strict=True)]
    with path.open("wb") as stream:
        stream.write(("\n".join([*lines, "end_header"]) + "\n").encode())
        stream.write(points.tobytes())


def _write_laz(path: Path, points: np.ndarray) -> None:
    laspy = _require_laspy()
    header = laspy.LasHeader(point_format=0, version="1.4")
    places = np.stack([points[axis].astype(np.float64) for axis in "xyz"], axis=1)
    header.scales = np.full(3, _LAS_STEP_M)
    header.offsets = places.min(axis=0) if len(places) else np.zeros(3)
    for name in points.dtype.names or ():
        if name not in "xyz":
            # LAS has an intensity of its own, in whole numbers.
            name_there = f"recorded_{name}" if name == "intensity" else name
            header.add_extra_dim(laspy.ExtraBytesParams(name_there, points.dtype[name].str[1:]))
    file = laspy.LasData(header)
    file.x, file.y, file.z = places.T
    for name in points.dtype.names or ():
        if name not in "xyz":
            file[f"recorded_{name}" if name == "intensity" else name] = points[name]
    file.write(str(path), do_compress=True)


def _require_laspy() -> Any:
    try:
        import laspy
        import lazrs  # noqa: F401
    except ImportError as error:
        raise InputError(
            "LAZ was asked for; it needs the packages laspy and lazrs, which `make setup` installs"
        ) from error
    return laspy
