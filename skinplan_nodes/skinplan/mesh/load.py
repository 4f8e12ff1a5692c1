"""Reads mesh files into metres."""

import hashlib
from pathlib import Path

import numpy as np

from skinplan.errors import (
    MeshEmptyError,
    MeshExtraMissingError,
    MeshNotFiniteError,
    MeshNotFoundError,
    MeshRefusedError,
    MeshUnreadableError,
)
from skinplan.mesh.formats.obj import read_obj
from skinplan.mesh.formats.ply import read_ply
from skinplan.mesh.formats.raw import MOST_FACES, RawMesh, TooManyFacesError
from skinplan.mesh.formats.step import Tessellation, read_step
from skinplan.mesh.formats.stl import read_stl
from skinplan.mesh.merge import merge_vertices
from skinplan.mesh.model import Finding, SurfaceMesh
from skinplan.mesh.units import UNITS_M, require_part_size, require_unit

__all__ = [
    "FORMATS",
    "UNITS_M",
    "Tessellation",
    "file_sha256",
    "load_mesh",
    "merge_vertices",
    "read_mesh",
]

FORMATS = (".stl", ".ply", ".obj", ".step", ".stp")
_READERS = {".stl": read_stl, ".ply": read_ply, ".obj": read_obj}
_FORMAT_NAMES = "STL, PLY, OBJ and STEP"
_LARGEST_FILE_BYTES = 2 * 1024**3


def load_mesh(
    path: Path | str, unit: str = "m", tessellation: Tessellation | None = None
) -> SurfaceMesh:
    """Reads a mesh file.

    Equal vertices are merged; nothing is repaired (see `skinplan.mesh.check.check_mesh`).

    Args:
        path: STL (binary or ASCII), PLY, OBJ or STEP file.
        unit: Unit of the file: ``m``, ``cm``, ``mm`` or ``inch``. Not used for STEP, which says
            its own.
        tessellation: How fine the triangles of a STEP file are; None = 0.1 mm, 0.1 rad.

    Returns:
        The mesh in metres, with the hash of the file's bytes.

    Raises:
        MeshNotFoundError: No such file.
        MeshUnreadableError: No mesh of a known format.
        MeshExtraMissingError: A STEP file, and the optional package for it is not installed.
        MeshEmptyError: No bytes, no vertices or no faces.
        MeshNotFiniteError: A vertex is NaN or infinite.
        MeshUnitError: The unit is unknown, or makes the part larger or smaller than any that is
            accepted.
        MeshRefusedError: The file is larger than 2 GiB or has more than 10 million faces.
    """
    return read_mesh(path, unit, tessellation)[0]


def read_mesh(
    path: Path | str, unit: str = "m", tessellation: Tessellation | None = None
) -> tuple[SurfaceMesh, tuple[Finding, ...]]:
    """Reads a mesh file and says what was noticed on the way.

    Args:
        path: As in `load_mesh`.
        unit: As in `load_mesh`.
        tessellation: As in `load_mesh`.

    Returns:
        What `load_mesh` returns, and the findings of reading: polygons that were split, lines that
        were left out, the tolerance of a tessellation.

    Raises:
        MeshError: As in `load_mesh`.
    """
    file = Path(path)
    require_unit(file.name, unit)
    data = _read_bytes(file)
    raw = _parse(file, data, tessellation or Tessellation())
    _require_faces(file.name, raw)
    raw = _finite(file.name, raw)
    vertices, faces = merge_vertices(raw.vertices, raw.faces)
    factor = UNITS_M[unit] if raw.unit_m is None else raw.unit_m
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    with np.errstate(over="ignore"):  # an infinite extent is refused with the others
        extent = float(np.ptp(vertices[used], axis=0).max())
    require_part_size(file.name, extent, None if raw.unit_m else unit, factor)
    mesh = SurfaceMesh(vertices * factor, faces, hashlib.sha256(data).hexdigest())
    return mesh, raw.findings


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


def _existing(file: Path) -> Path:
    if not file.exists():
        raise MeshNotFoundError(
            f"no mesh file at {file}; the path of an existing {_FORMAT_NAMES} file is accepted"
        )
    if not file.is_file():
        raise MeshUnreadableError(f"{file} is no file; {_FORMAT_NAMES} files are accepted")
    return file


def _read_bytes(file: Path) -> bytes:
    _existing(file)
    if file.suffix.lower() not in FORMATS:
        raise MeshUnreadableError(
            f"{file.name} has the extension {file.suffix or '(none)'}; {_FORMAT_NAMES} files are "
            "accepted"
        )
    try:
        size = file.stat().st_size
        if size > _LARGEST_FILE_BYTES:
            raise _refused(
                "huge file",
                size,
                f"{file.name} has {size / 1024**3:.1f} GiB; up to "
                f"{_LARGEST_FILE_BYTES / 1024**3:.0f} GiB are accepted",
            )
        data = file.read_bytes()
    except OSError as error:
        raise MeshUnreadableError(
            f"{file} can't be opened: {error.strerror}; a readable file is accepted"
        ) from error
    if not data:
        raise MeshEmptyError(
            f"{file.name} has no bytes; {_FORMAT_NAMES} files with at least one face are accepted"
        )
    return data


def _parse(file: Path, data: bytes, tessellation: Tessellation) -> RawMesh:
    kind = file.suffix.lower()
    try:
        return _READERS[kind](data) if kind in _READERS else read_step(data, tessellation)
    except MeshExtraMissingError as error:
        raise MeshExtraMissingError(f"{file.name} can't be read: {error}") from error
    except TooManyFacesError as error:
        message = (
            f"{file.name} has {error.faces} faces; up to {MOST_FACES} are accepted: decimate it, "
            "5 mm triangles are enough"
        )
        raise _refused("huge mesh", error.faces, message) from error
    except (ValueError, OverflowError) as error:  # FormatError is a ValueError
        reason = " ".join(str(error).split())[:200]
        raise MeshUnreadableError(
            f"{file.name} can't be read as {kind[1:].upper()} ({reason}); {_FORMAT_NAMES} files "
            "are accepted"
        ) from error


def _require_faces(name: str, raw: RawMesh) -> None:
    vertices, faces = raw.vertices, raw.faces
    if len(vertices) == 0 or len(faces) == 0:
        raise MeshEmptyError(
            f"{name} has {len(vertices)} vertices and {len(faces)} faces; a mesh with at "
            "least one face is accepted",
            raw.findings,
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        outside = (faces < 0) | (faces >= len(vertices))
        raise MeshUnreadableError(
            f"{name} has {np.count_nonzero(outside.any(axis=1))} faces that name vertices it does "
            f"not have, such as {faces[outside][0]} of {len(vertices)}; a file whose faces name "
            "its own vertices is accepted",
            raw.findings,
        )


def _finite(name: str, raw: RawMesh) -> RawMesh:
    """Returns the mesh without vertices that are not finite, when no face uses them."""
    if np.isfinite(raw.vertices).all():
        return raw
    broken = np.logical_not(np.isfinite(raw.vertices).all(axis=1))
    touched = int(np.count_nonzero(broken[raw.faces].any(axis=1)))
    count = int(np.count_nonzero(broken))
    if touched:
        detail = f"{touched} faces use them, the first is face {broken[raw.faces].any(1).argmax()}"
        finding = Finding("vertices not finite", count, "refused", detail)
        raise MeshNotFiniteError(
            f"{name} has {count} of {len(broken)} vertices that are NaN or infinite, and {detail}; "
            "finite numbers are accepted",
            (*raw.findings, finding),
        )
    finding = Finding("vertices not finite", count, "repaired", "were removed; no face uses them")
    rank = np.cumsum(~broken) - 1
    return RawMesh(raw.vertices[~broken], rank[raw.faces], (*raw.findings, finding), raw.unit_m)


def _refused(name: str, count: int, message: str) -> MeshRefusedError:
    return MeshRefusedError(message, (Finding(name, count, "refused", message),))
