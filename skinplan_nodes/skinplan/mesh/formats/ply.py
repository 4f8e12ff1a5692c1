"""PLY files: text and binary, both byte orders.

A file's header can claim anything: every claim is held against the bytes that are there before
memory is taken.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.mesh.formats.ply_body import BinaryBody, Body, TextBody
from skinplan.mesh.formats.ply_header import Element, Header, Property, read_header
from skinplan.mesh.formats.raw import (
    FormatError,
    Indices,
    RawMesh,
    numbers,
    require_few,
    triangulated,
)

_CORNER_LISTS = ("vertex_indices", "vertex_index")


@dataclass(frozen=True, eq=False)
class _Rows:
    """Where the values of an element stand in the body.

    Attributes:
        starts: For each property the place of its value, or of its list's first value, in each
            row, shape (n,).
        lengths: For each list the number of its values in each row, shape (n,).
        end: Where the next element begins.
    """

    starts: dict[str, Indices]
    lengths: dict[str, Indices]
    end: int


def read_ply(data: bytes) -> RawMesh:
    """Reads a PLY file; polygons are split into triangles.

    Raises:
        FormatError: It is none.
        TooManyFacesError: More faces than are accepted.
    """
    header = read_header(data)
    body = _body(header, data)
    vertices = np.zeros((0, 3))
    groups: list[Indices] = []
    place = 0
    for element in header.elements:
        rows = _locate(body, element, place)
        if element.name == "vertex":
            vertices = _vertices(body, element, rows)
        elif element.name == "face":
            groups = _polygons(body, element, rows)
        place = rows.end
    triangles, findings = triangulated(vertices, groups)
    return RawMesh(vertices, triangles, tuple(findings))


def _body(header: Header, data: bytes) -> Body:
    if header.order is None:
        return TextBody(numbers(data[header.end :]))
    return BinaryBody(np.frombuffer(data, dtype=np.uint8, offset=header.end), header.order)


def _locate(body: Body, element: Element, place: int) -> _Rows:
    """Finds the values of an element whose first row stands at a place."""
    least = sum(body.width(item.count_type or item.type) for item in element.properties)
    if element.count * least > body.size - place:
        raise FormatError(
            f"its header says {element.count} elements {element.name!r}; the rest of the file is "
            "too short for them"
        )
    if element.count == 0 or not element.properties:
        return _Rows({}, {}, place)
    if element.name == "face":
        require_few(element.count)
    return _locate_even(body, element, place) or _locate_uneven(body, element, place)


def _locate_even(body: Body, element: Element, place: int) -> _Rows | None:
    """Returns None when the rows do not all have lists as long as those of the first."""
    offsets, lengths, end = _walk(body, element.properties, place)
    stride = end - place
    if place + stride * element.count > body.size:
        return None
    rows = stride * np.arange(element.count)
    for item, offset, length in zip(element.properties, offsets, lengths, strict=True):
        if item.count_type is None:
            continue
        counts = body.take(offset - body.width(item.count_type) + rows, item.count_type, 1)
        if np.any(counts != length):
            return None
    return _Rows(
        {
            item.name: offset + rows
            for item, offset in zip(element.properties, offsets, strict=True)
        },
        {
            item.name: np.full(element.count, length)
            for item, length in zip(element.properties, lengths, strict=True)
        },
        place + stride * element.count,
    )


def _locate_uneven(body: Body, element: Element, place: int) -> _Rows:
    starts, lengths = [], []
    for _ in range(element.count):
        offsets, counts, place = _walk(body, element.properties, place)
        starts.append(offsets)
        lengths.append(counts)
    names = [item.name for item in element.properties]
    return _Rows(
        dict(zip(names, np.array(starts, dtype=np.int64).T, strict=True)),
        dict(zip(names, np.array(lengths, dtype=np.int64).T, strict=True)),
        place,
    )


def _walk(
    body: Body, properties: tuple[Property, ...], place: int
) -> tuple[list[int], list[int], int]:
    """Returns where the properties of a row stand, how many values each has, and its end."""
    offsets, lengths = [], []
    for item in properties:
        length = 1
        if item.count_type is not None:
            length = body.count(place, item.count_type)
            place += body.width(item.count_type)
        offsets.append(place)
        lengths.append(length)
        place += length * body.width(item.type)
        if place > body.size:
            raise FormatError("it ends in the middle of an element")
    return offsets, lengths, place


def _vertices(body: Body, element: Element, rows: _Rows) -> NDArray[np.float64]:
    if element.count == 0:
        return np.zeros((0, 3))
    scalars = {item.name: item for item in element.properties if item.count_type is None}
    if not {"x", "y", "z"} <= set(scalars):
        raise FormatError("its vertices have no x, y and z")
    with np.errstate(invalid="ignore"):  # NaN is reported by name later
        columns = [
            body.take(rows.starts[axis], scalars[axis].type, 1)[:, 0].astype(np.float64)
            for axis in "xyz"
        ]
    return np.stack(columns, axis=1)


def _polygons(body: Body, element: Element, rows: _Rows) -> list[Indices]:
    lists = {item.name: item for item in element.properties if item.count_type is not None}
    name = next((name for name in _CORNER_LISTS if name in lists), None)
    if element.count == 0:
        return []
    if name is None:
        raise FormatError(f"its faces have no list {' or '.join(_CORNER_LISTS)}")
    groups = []
    starts, lengths = rows.starts[name], rows.lengths[name]
    for corners in np.unique(lengths[lengths > 0]):
        found = body.take(starts[lengths == corners], lists[name].type, int(corners))
        with np.errstate(invalid="ignore"):  # NaN is no whole number
            whole = found.astype(np.int64)
        if np.any(whole != found):
            raise FormatError("a face names a vertex by no whole number")
        groups.append(whole)
    return groups
