"""Reads mesh files into metres."""

import hashlib
import io
import logging
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from skinplan.errors import (
    MeshEmptyError,
    MeshNotFiniteError,
    MeshNotFoundError,
    MeshRefusedError,
    MeshUnitError,
    MeshUnreadableError,
)
from skinplan.mesh.model import SurfaceMesh
from skinplan.transforms import Array

UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}
FORMATS = (".stl", ".ply", ".obj")
LEAST_EXTENT_M = 0.05
LARGEST_EXTENT_M = 30.0
_LARGEST_FILE_BYTES = 2 * 1024**3
_STL_HEADER_BYTES = 84
_STL_FACE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
# trimesh logs tracebacks of files that it can not read; load_mesh says the same in one sentence.
logging.getLogger("trimesh").setLevel(logging.CRITICAL)


def load_mesh(path: Path | str, unit: str = "m") -> SurfaceMesh:
    """Reads a mesh file.

    Equal vertices are merged; nothing is repaired (see `skinplan.mesh.check.check_mesh`).

    Args:
        path: STL (binary or ASCII), PLY or OBJ file.
        unit: Unit of the file: ``m``, ``cm``, ``mm`` or ``inch``.

    Returns:
        The mesh in metres, with the hash of the file's bytes.

    Raises:
        MeshNotFoundError: No such file.
        MeshUnreadableError: No mesh of a known format.
        MeshEmptyError: No bytes, no vertices or no faces.
        MeshNotFiniteError: A vertex is NaN or infinite.
        MeshUnitError: The unit is unknown, or makes the part larger or smaller than any that is
            accepted.
        MeshRefusedError: The file is larger than 2 GiB.
    """
    file = Path(path)
    if unit not in UNITS_M:
        raise MeshUnitError(
            f"the unit {unit!r} was given for {file.name}; accepted are {', '.join(UNITS_M)}"
        )
    data = _read_bytes(file)
    vertices, faces = _parse(file, data)
    if len(vertices) == 0 or len(faces) == 0:
        raise MeshEmptyError(
            f"{file.name} has {len(vertices)} vertices and {len(faces)} faces; a mesh with at "
            "least one face is accepted"
        )
    broken = int(np.count_nonzero(~np.isfinite(vertices).all(axis=1)))
    if broken:
        raise MeshNotFiniteError(
            f"{file.name} has {broken} of {len(vertices)} vertices that are NaN or infinite; "
            "finite numbers are accepted"
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise MeshUnreadableError(
            f"{file.name} has a face that names vertex {faces.max()}, but {len(vertices)} "
            "vertices; "
            "a file whose faces name its own vertices is accepted"
        )
    vertices, faces = merge_vertices(vertices, faces)
    _check_size(file.name, np.ptp(vertices[np.unique(faces)], axis=0).max(), unit)
    return SurfaceMesh(vertices * UNITS_M[unit], faces, hashlib.sha256(data).hexdigest())


def file_sha256(path: Path | str) -> str:
    """Returns the SHA-256 of a file's bytes, lower-case hex.

    Raises:
        MeshNotFoundError: No such file.
        MeshUnreadableError: It can't be opened.
    """
    file = _existing(Path(path))
    try:
        with file.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise MeshUnreadableError(
            f"{file} can't be opened: {error.strerror}; a readable file is accepted"
        ) from error


def merge_vertices(vertices: Array, faces: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """Makes one vertex of those with exactly the same coordinates.

    Args:
        vertices: shape (v, 3).
        faces: shape (f, 3).

    Returns:
        Vertices in the order of their first use in the file, and the faces that name them.
    """
    plain = np.ascontiguousarray(vertices, dtype=np.float64) + 0.0  # -0.0 is 0.0
    words = plain.view(np.uint64).reshape(-1, 3)
    # Sorting one number per vertex is far cheaper than sorting rows; the check below makes a
    # collision harmless.
    keys = words[:, 0] * np.uint64(0x9E3779B97F4A7C15) ^ words[:, 1] * np.uint64(0xC2B2AE3D27D4EB4F)
    keys = (keys ^ (keys >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9) + words[
        :, 2
    ] * np.uint64(0x165667B19E3779F9)
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    if not np.array_equal(plain[first][inverse], plain):
        _, first, inverse = np.unique(plain, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    return plain[first[order]], rank[inverse.reshape(-1)][faces]


def _existing(file: Path) -> Path:
    if not file.exists():
        raise MeshNotFoundError(
            f"no mesh file at {file}; the path of an existing {_formats()} file is accepted"
        )
    if not file.is_file():
        raise MeshUnreadableError(f"{file} is no file; a {_formats()} file is accepted")
    return file


def _read_bytes(file: Path) -> bytes:
    _existing(file)
    if file.suffix.lower() not in FORMATS:
        raise MeshUnreadableError(
            f"{file.name} has the extension {file.suffix or '(none)'}; {_formats()} files are "
            "accepted"
        )
    try:
        size = file.stat().st_size
        if size > _LARGEST_FILE_BYTES:
            raise MeshRefusedError(
                f"{file.name} has {size / 1024**3:.1f} GiB; up to "
                f"{_LARGEST_FILE_BYTES / 1024**3:.0f} GiB are accepted"
            )
        data = file.read_bytes()
    except OSError as error:
        raise MeshUnreadableError(
            f"{file} can't be opened: {error.strerror}; a readable file is accepted"
        ) from error
    if not data:
        raise MeshEmptyError(
            f"{file.name} has no bytes; a {_formats()} file with at least one face is accepted"
        )
    return data


def _parse(file: Path, data: bytes) -> tuple[Array, NDArray[np.int64]]:
    """Returns vertices, shape (v, 3), and faces, shape (f, 3), in the unit of the file."""
    kind = file.suffix.lower()[1:]
    if kind == "stl" and _is_binary_stl(data):
        return _parse_binary_stl(data)
    options: dict[str, Any] = {"skip_materials": True} if kind == "obj" else {}
    try:
        # trimesh raises whatever its parsers stumble over: every one of them means the same to the
        # caller.
        loaded: Any = trimesh.load(
            io.BytesIO(data),
            file_type=kind,
            process=False,
            force="mesh",
            **options,
        )
        vertices = np.asarray(loaded.vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.asarray(getattr(loaded, "faces", ()), dtype=np.int64).reshape(-1, 3)
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise MeshUnreadableError(
            f"{file.name} can't be read as {kind.upper()} ({reason}); a {_formats()} file is "
            "accepted"
        ) from error
    if kind == "stl" and len(faces) == 0 and not data.lstrip().lower().startswith(b"solid"):
        raise MeshUnreadableError(f"{file.name} is no STL file; a {_formats()} file is accepted")
    return vertices, faces


def _is_binary_stl(data: bytes) -> bool:
    if len(data) < _STL_HEADER_BYTES:
        return False
    count = int.from_bytes(data[80:84], "little")
    return len(data) == _STL_HEADER_BYTES + count * _STL_FACE.itemsize


def _parse_binary_stl(data: bytes) -> tuple[Array, NDArray[np.int64]]:
    records = np.frombuffer(data, dtype=_STL_FACE, offset=_STL_HEADER_BYTES)
    with np.errstate(invalid="ignore"):  # NaN is reported by name later
        corners = records["corners"].reshape(-1, 3).astype(np.float64)
    return corners, np.arange(len(corners), dtype=np.int64).reshape(-1, 3)


def _check_size(name: str, extent: float, unit: str) -> None:
    """Raises MeshUnitError when the largest extent, in the file's unit, is no size of a part."""
    size = extent * UNITS_M[unit]
    if LEAST_EXTENT_M <= size <= LARGEST_EXTENT_M:
        return
    likely = [
        other
        for other, factor in UNITS_M.items()
        if LEAST_EXTENT_M <= extent * factor <= LARGEST_EXTENT_M
    ]
    # Of several plausible units the one nearest to a panel of 2 m is named first.
    likely.sort(key=lambda other: abs(np.log(max(extent * UNITS_M[other], 1e-30) / 2.0)))
    hint = f"; did you mean unit {' or '.join(likely)}?" if likely else ""
    raise MeshUnitError(
        f"{name} in {unit} would be {_length(size)} long; {LEAST_EXTENT_M} m to "
        f"{LARGEST_EXTENT_M:g} m are accepted{hint}"
    )


def _length(size_m: float) -> str:
    for limit, factor, name in ((1e-3, 1e6, "um"), (1.0, 1e3, "mm"), (1e3, 1.0, "m")):
        if size_m < limit:
            return f"{size_m * factor:.3g} {name}"
    return f"{size_m / 1e3:.3g} km"


def _formats() -> str:
    return ", ".join(suffix[1:].upper() for suffix in FORMATS)
