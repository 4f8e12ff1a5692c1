"""The header of a PLY file."""

from dataclasses import dataclass

from skinplan.mesh.formats.raw import FormatError

_MOST_HEADER_BYTES = 64 * 1024
_MOST_PROPERTIES = 256
_ORDERS = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}
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


@dataclass(frozen=True)
class Property:
    """A value, or a list of values, of every row of an element.

    Attributes:
        name: As in the file.
        type: NumPy code of the values, without byte order.
        count_type: Of a list: NumPy code of its length; None for one value.
    """

    name: str
    type: str
    count_type: str | None = None


@dataclass(frozen=True)
class Element:
    """A table of the file: ``vertex``, ``face`` or another.

    Attributes:
        name: As in the file.
        count: Number of rows that the header claims.
        properties: The columns.
    """

    name: str
    count: int
    properties: tuple[Property, ...]


@dataclass(frozen=True)
class Header:
    """The header of a PLY file.

    Attributes:
        order: Byte order, ``<`` or ``>``; None for text.
        elements: The tables in the order of the file.
        end: Where the body begins [bytes].
    """

    order: str | None
    elements: tuple[Element, ...]
    end: int


def read_header(data: bytes) -> Header:
    """Reads the header.

    Raises:
        FormatError: It is none.
    """
    head = data[:_MOST_HEADER_BYTES]
    mark = head.find(b"end_header")
    if head[:3] != b"ply" or mark < 0:
        raise FormatError("no header from ply to end_header")
    end = mark + len(b"end_header")
    # Lines end with LF, CR LF, or a lone CR.
    end += 2 if head[end : end + 2] == b"\r\n" else 1
    order: str | None = None
    known = False
    elements: list[Element] = []
    for line in head[:mark].decode("latin-1").splitlines()[1:]:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) > 1 and words[1] in _ORDERS:
            order, known = _ORDERS[words[1]], True
        elif words[0] == "element" and len(words) == 3 and words[2].isdecimal():
            elements.append(Element(words[1], int(words[2][:20]), ()))
        elif words[0] == "property" and elements:
            elements[-1] = _extended(elements[-1], words)
        else:
            raise FormatError(f"its header has the line {line[:60]!r}")
    if not known:
        raise FormatError("its header names no format")
    return Header(order, tuple(elements), end)


def _extended(element: Element, words: list[str]) -> Element:
    if len(words) == 3 and words[1] in _TYPES:
        made = Property(words[2], _TYPES[words[1]])
    elif len(words) == 5 and words[1] == "list" and words[2] in _TYPES and words[3] in _TYPES:
        made = Property(words[4], _TYPES[words[3]], _TYPES[words[2]])
    else:
        raise FormatError(f"its header has the line {' '.join(words)[:60]!r}")
    if made.name in {item.name for item in element.properties}:
        raise FormatError(f"its element {element.name!r} has two properties {made.name!r}")
    if len(element.properties) == _MOST_PROPERTIES:
        raise FormatError(f"its element {element.name!r} has over {_MOST_PROPERTIES} properties")
    return Element(element.name, element.count, (*element.properties, made))
