"""OBJ files: vertices and faces; everything else in them is skipped."""

import io
from array import array

import numpy as np

from skinplan.mesh.formats.raw import (
    FormatError,
    Indices,
    RawMesh,
    numbers,
    require_few,
    triangulated,
)
from skinplan.mesh.model import Finding
from skinplan.transforms import Array

_MOST_CORNERS = 10_000


def read_obj(data: bytes) -> RawMesh:
    """Reads an OBJ file.

    Polygons are split into triangles. Vertex numbers below 0 count back from the last vertex.

    Raises:
        FormatError: It is none.
        TooManyFacesError: More faces than are accepted.
    """
    if b"\0" in data[:4096]:
        raise FormatError("it is no text")
    points: list[bytes] = []
    polygons: dict[int, array[int]] = {}
    thin = faces = 0
    lines = io.BytesIO(data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" "))
    for number, line in enumerate(lines, start=1):
        keyword, _, rest = line.strip().replace(b"\t", b" ").partition(b" ")
        if keyword == b"v":
            points.append(_point(rest, number))
        elif keyword == b"f":
            corners = _corners(rest, len(points), number)
            polygons.setdefault(len(corners), array("q")).extend(corners)
            faces += max(0, len(corners) - 2)
            require_few(faces)
        elif keyword in (b"l", b"p"):
            thin += 1
    vertices = _vertices(points)
    groups = [_group(polygons[corners], corners) for corners in sorted(polygons) if corners]
    triangles, findings = triangulated(vertices, groups)
    return RawMesh(vertices, triangles, tuple(findings + _thin(thin)))


def _point(text: bytes, line: int) -> bytes:
    found = text.split(b"#")[0].split()
    if len(found) < 3:
        raise FormatError(f"line {line}: a vertex with {len(found)} numbers, not three")
    # A fourth number is a weight, further ones are a colour.
    return b" ".join(found[:3])


def _corners(text: bytes, vertices: int, line: int) -> list[int]:
    try:
        found = [int(word.partition(b"/")[0]) for word in text.split(b"#")[0].split()]
    except ValueError as error:
        raise FormatError(f"line {line}: a face that is not made of vertex numbers") from error
    if 0 in found:
        raise FormatError(f"line {line}: a face that names vertex 0; numbers begin with 1")
    if len(found) > _MOST_CORNERS or any(abs(number) > 2**62 for number in found):
        raise FormatError(f"line {line}: a face that can't be one")
    return [number - 1 if number > 0 else _back(vertices + number, line) for number in found]


def _back(number: int, line: int) -> int:
    if number < 0:
        raise FormatError(f"line {line}: a face that counts back beyond the first vertex")
    return number


def _group(corners: "array[int]", count: int) -> Indices:
    return np.frombuffer(corners, dtype=np.int64).reshape(-1, count)


def _vertices(points: list[bytes]) -> Array:
    flat = numbers(b" ".join(points))
    if len(flat) != 3 * len(points):
        raise FormatError(f"{len(points)} vertices with {len(flat)} numbers, not three each")
    return flat.reshape(-1, 3)


def _thin(count: int) -> list[Finding]:
    if not count:
        return []
    return [Finding("lines and points", count, "noted", "were left out")]
