"""STL files, binary and text."""

import re
from collections.abc import Iterator

import numpy as np

from skinplan.mesh.formats.raw import FormatError, RawMesh, numbers, require_few
from skinplan.mesh.model import Finding
from skinplan.transforms import Array

_HEADER_BYTES = 84
_FACE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_CHUNK_BYTES = 16 * 1024**2
_LOOP = re.compile(rb"\bouter\s+loop\b", re.IGNORECASE)
_VERTEX = re.compile(rb"\bvertex\s+(\S+\s+\S+\s+\S+)", re.IGNORECASE)
_END_OF_FACE = re.compile(rb"\bendfacet\b", re.IGNORECASE)
_END = re.compile(rb"\bendsolid\b", re.IGNORECASE)


def read_stl(data: bytes) -> RawMesh:
    """Reads an STL file, every corner a vertex of its own.

    Raises:
        FormatError: It is none.
        TooManyFacesError: More faces than are accepted.
    """
    if _is_binary(data):
        return _read_binary(data)
    if data.lstrip()[:5].lower() == b"solid":
        return _read_text(data)
    if len(data) < _HEADER_BYTES:
        raise FormatError(f"neither text nor the {_HEADER_BYTES} bytes of a binary header")
    raise FormatError(
        f"its header says {_count(data)} faces, which are {_binary_bytes(data)} bytes; it has "
        f"{len(data)}"
    )


def _count(data: bytes) -> int:
    return int.from_bytes(data[80:84], "little")


def _binary_bytes(data: bytes) -> int:
    return _HEADER_BYTES + _count(data) * _FACE.itemsize


def _is_binary(data: bytes) -> bool:
    # Binary files may begin with "solid" too: only the length tells them apart.
    return len(data) >= _HEADER_BYTES and len(data) == _binary_bytes(data)


def _read_binary(data: bytes) -> RawMesh:
    require_few(_count(data))
    records = np.frombuffer(data, dtype=_FACE, offset=_HEADER_BYTES)
    with np.errstate(invalid="ignore"):  # NaN is reported by name later
        corners = records["corners"].reshape(-1, 3).astype(np.float64)
    return _soup(corners, ())


def _read_text(data: bytes) -> RawMesh:
    points = [np.zeros(0)]
    corners = 0
    for chunk in _chunks(data):
        found = _VERTEX.findall(chunk)
        loops = len(_LOOP.findall(chunk))
        if len(found) != 3 * loops:
            raise FormatError(f"{loops} loops with {len(found)} vertices, not three each")
        corners += len(found)
        require_few(corners // 3)
        points.append(numbers(b" ".join(found)))
    flat = np.concatenate(points)
    if len(flat) != 3 * corners:
        raise FormatError(f"{corners} vertices with {len(flat)} numbers, not three each")
    findings: tuple[Finding, ...] = ()
    if corners and not _END.search(data, max(0, len(data) - 4096)):
        findings = (Finding("incomplete file", 1, "noted", "the text ends without endsolid"),)
    return _soup(flat.reshape(-1, 3), findings)


def _chunks(data: bytes) -> Iterator[bytes]:
    """Yields whole faces in pieces, so that memory stays near the size of the file."""
    begin = 0
    while begin < len(data):
        end = _END_OF_FACE.search(data, begin + _CHUNK_BYTES)
        stop = end.end() if end else len(data)
        yield data[begin:stop]
        begin = stop


def _soup(corners: Array, findings: tuple[Finding, ...]) -> RawMesh:
    return RawMesh(corners, np.arange(len(corners), dtype=np.int64).reshape(-1, 3), findings)
