"""Clouds as binary PLY files with the frame and further values of each point."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from skinplan.errors import CloudInvalidError
from skinplan.transforms import Array
from skinplan.whole_file import whole_file

_MOST_HEADER = 64 * 1024
_MOST_POINTS = 2_000_000_000
_BATCH = 500_000
_FRAME = "frame "
# PLY's names of numbers, old and new.
_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
}


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points with further values.

    Attributes:
        points: shape (n, 3) [m].
        frame: Frame of the points; empty = the file does not say.
        values: Further values by name (``deviation`` [m], ``intensity``, ...), each shape (n,).
    """

    points: Array
    frame: str = ""
    values: dict[str, Array] = field(default_factory=dict)


def write_ply(
    path: Path, points: Array, frame: str = "workpiece", values: Mapping[str, Array] | None = None
) -> None:
    """Writes a binary little-endian PLY in one step.

    A reader sees the old file or the whole new one.

    Args:
        path: The file.
        points: shape (n, 3) [m].
        frame: Frame of the points, written as comment ``frame <name>``.
        values: Further values by name, each shape (n,); written as ``float``.

    Raises:
        CloudInvalidError: Shapes that do not fit, a name that PLY can't have, or a file that can't
            be written.
    """
    if np.ndim(points) != 2 or np.shape(points)[1] != 3:
        raise CloudInvalidError(
            f"{path}: points of shape (n, 3) are accepted, found {np.shape(points)}"
        )
    named = {"x": points[:, 0], "y": points[:, 1], "z": points[:, 2]}
    for name, value in (values or {}).items():
        if not name.isidentifier() or name in named or np.shape(value) != (len(points),):
            raise CloudInvalidError(
                f"{path}: a value by a plain name for each of the {len(points)} points is "
                "accepted, "
                f"found {name!r} of shape {np.shape(value)}"
            )
        named[name] = np.asarray(value)
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment {_FRAME}{frame}",
        f"element vertex {len(points)}",
    ]
    header += [f"property float {name}" for name in named]
    try:
        with whole_file(path) as temporary, temporary.open("wb") as stream:
            stream.write(("\n".join([*header, "end_header"]) + "\n").encode("ascii", "replace"))
            for begin in range(0, len(points), _BATCH):
                columns = [value[begin : begin + _BATCH] for value in named.values()]
                stream.write(np.stack(columns, axis=1).astype("<f4").tobytes())
    except OSError as error:
        raise CloudInvalidError(
            f"{path}: the cloud can't be written ({error.strerror or error})"
        ) from error


def read_ply(path: Path) -> Cloud:
    """Reads a binary PLY whose first element is ``vertex`` with ``x``, ``y``, ``z``.

    Args:
        path: The file.

    Returns:
        The points and their further values.

    Raises:
        CloudInvalidError: Missing, no such PLY, cut off, or with coordinates that are not finite.
    """
    try:
        with path.open("rb") as stream:
            lines = _header(path, stream.read(_MOST_HEADER))
            kind, count, frame = _vertex_type(path, lines)
            stream.seek(sum(len(line) + 1 for line in lines))
            size = path.stat().st_size - stream.tell()
            if count * kind.itemsize > size:
                raise CloudInvalidError(
                    f"{path}: {count} points of {kind.itemsize} bytes are announced, only "
                    f"{size} bytes follow"
                )
            table = np.fromfile(stream, dtype=kind, count=count)
    except OSError as error:
        raise CloudInvalidError(
            f"{path}: a readable PLY file is accepted ({error.strerror or error})"
        ) from error
    points = np.stack([table[axis].astype(float) for axis in "xyz"], axis=1)
    if not np.all(np.isfinite(points)):
        bad = np.count_nonzero(~np.isfinite(points).all(axis=1))
        raise CloudInvalidError(
            f"{path}: finite coordinates are accepted, {bad} of {count} points have others"
        )
    names = [name for name in kind.names or () if name not in ("x", "y", "z")]
    return Cloud(points, frame, {name: table[name].astype(float) for name in names})


def _header(path: Path, head: bytes) -> list[bytes]:
    lines = head.split(b"\n")
    if lines[0].rstrip(b"\r") != b"ply":
        raise CloudInvalidError(f"{path}: a PLY file is accepted, but it does not begin with 'ply'")
    for number, line in enumerate(lines):
        if line.rstrip(b"\r") == b"end_header":
            return lines[: number + 1]
    raise CloudInvalidError(
        f"{path}: a PLY header that ends within {_MOST_HEADER} bytes is accepted, found none"
    )


def _vertex_type(path: Path, lines: list[bytes]) -> tuple["np.dtype[np.void]", int, str]:
    words = [line.decode("ascii", "replace").split() for line in lines]
    texts = [line.decode("utf-8", "replace").strip() for line in lines]
    frames = [
        t.removeprefix("comment " + _FRAME) for t in texts if t.startswith("comment " + _FRAME)
    ]
    formats = [w[1:] for w in words if w[:1] == ["format"]]
    if formats not in ([["binary_little_endian", "1.0"]], [["binary_big_endian", "1.0"]]):
        raise CloudInvalidError(
            f"{path}: format binary_little_endian 1.0 is accepted, found {formats}"
        )
    elements = [i for i, w in enumerate(words) if w[:1] == ["element"]]
    if not elements or len(words[elements[0]]) != 3 or words[elements[0]][1] != "vertex":
        raise CloudInvalidError(f"{path}: a PLY whose first element is vertex is accepted")
    count = words[elements[0]][2]
    if not count.isdecimal() or int(count) > _MOST_POINTS:
        raise CloudInvalidError(
            f"{path}: up to {_MOST_POINTS} points are accepted, found {count[:40]!r}"
        )
    end = elements[1] if len(elements) > 1 else len(words)
    properties = [w for w in words[elements[0] : end] if w[:1] == ["property"]]
    if any(len(w) != 3 or w[1] not in _TYPES for w in properties):
        raise CloudInvalidError(
            f"{path}: plain numbers as properties of vertex are accepted, found {properties}"
        )
    names = [w[2] for w in properties]
    if len(set(names)) != len(names) or not {"x", "y", "z"} <= set(names):
        raise CloudInvalidError(
            f"{path}: properties x, y and z, each name once, are accepted, found {names}"
        )
    order = "<" if formats[0][0] == "binary_little_endian" else ">"
    kind = np.dtype(
        [(name, order + _TYPES[w[1]]) for name, w in zip(names, properties, strict=True)]
    )
    return kind, int(count), frames[0] if frames else ""
