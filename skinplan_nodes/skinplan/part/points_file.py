"""The file with a part's measuring points: CSV, one point a line, lengths in the part's unit.

::

    x,y,z,nx,ny,nz,group
    48.834,-582.945,467.879,0.272,0.209,0.939,1

``x, y, z`` is a point of the surface in the workpiece frame, ``nx, ny, nz`` its outward normal of
any length but 0, ``group`` the number of the surface that it belongs to, from 1. Empty lines are
skipped.
"""

import csv
import io
import logging
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import InspectionPointsError
from skinplan.inspection.closest import SurfaceIndex
from skinplan.mesh.load import UNITS_M
from skinplan.mesh.model import SurfaceMesh
from skinplan.part.inspection_points import InspectionPoints
from skinplan.scanner.samples import sample_surface
from skinplan.transforms import Array

COLUMNS = ("x", "y", "z", "nx", "ny", "nz", "group")
_LARGEST_FILE_BYTES = 10_000_000
_MOST_POINTS = 20_000
_MOST_GROUPS = 10_000
_LEAST_NORMAL = 1e-9
_UNIT_ENOUGH = 1e-6  # a normal so near to unit length stays as it is: writing changes nothing
_DECIMALS = 9
_FARTHEST_M = 0.005  # from the mesh: a mesh keeps such a chord where it is coarse
_BOX_ROOM = 0.02  # of the part's size
_log = logging.getLogger(__name__)


def read_points(path: Path, unit: str, mesh: SurfaceMesh) -> InspectionPoints:
    """Reads a part's measuring points.

    Args:
        path: The CSV file.
        unit: Unit of its lengths, that of the mesh file.
        mesh: The part, workpiece frame, as loaded [m].

    Returns:
        The points; those that are given twice stay, and are noted in the log.

    Raises:
        InspectionPointsError: No such file, no CSV with `COLUMNS`, a value that can't be used, or
            points that are not on the part.
    """
    rows = _read_rows(path)
    values = np.array([_numbers(path, number, row) for number, row in rows])
    lengths = np.linalg.norm(values[:, 3:6], axis=1)
    flat = np.flatnonzero(lengths < _LEAST_NORMAL)
    if len(flat):
        raise InspectionPointsError(
            f"{path.name}: the normal of line {rows[flat[0]][0]} is zero, and so are "
            f"{len(flat) - 1} more; an outward normal is accepted"
        )
    scale = np.where(np.abs(lengths - 1.0) < _UNIT_ENOUGH, 1.0, lengths)
    _require_on_part(path, values[:, :3], unit, mesh)
    points = InspectionPoints(
        values[:, :3] * UNITS_M[unit],
        values[:, 3:6] / scale[:, None],
        np.rint(values[:, 6]).astype(np.int64),
    )
    twice = points.repeated()
    if len(twice):
        _log.warning(
            "%s: %d points are given twice, the first in line %d; each is measured as often",
            path.name, len(twice), rows[int(twice[0])][0],
        )  # fmt: skip
    return points


def write_points(points: InspectionPoints, path: Path, unit: str) -> None:
    """Writes measuring points; reading them gives the same to 1e-9 of the unit.

    Args:
        points: What to write.
        path: The CSV file.
        unit: Unit of its lengths.
    """
    places = np.round(points.targets / UNITS_M[unit], _DECIMALS) + 0.0
    normals = np.round(points.normals, _DECIMALS) + 0.0
    lines = [",".join(COLUMNS)]
    for place, normal, group in zip(places, normals, points.groups, strict=True):
        numbers = [repr(value) for value in (*place.tolist(), *normal.tolist())]
        lines.append(",".join([*numbers, str(int(group))]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _read_rows(path: Path) -> list[tuple[int, list[str]]]:
    """Lines with their numbers, the heading left out."""
    if not path.is_file():
        raise InspectionPointsError(
            f"no file with measuring points at {path}; a CSV file with the columns "
            f"{','.join(COLUMNS)} is accepted"
        )
    try:
        size = path.stat().st_size
        if size > _LARGEST_FILE_BYTES:
            raise InspectionPointsError(
                f"{path.name} has {size} bytes; up to {_LARGEST_FILE_BYTES} are accepted"
            )
        text = path.read_text(encoding="utf-8-sig")
        rows = [(number, row) for number, row in enumerate(csv.reader(io.StringIO(text)), 1) if row]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InspectionPointsError(
            f"{path.name}: CSV text is accepted, but it can't be read: {error}"
        ) from error
    heading = tuple(name.strip().lower() for name in rows[0][1]) if rows else ()
    if heading != COLUMNS:
        raise InspectionPointsError(
            f"{path.name}: the first line {','.join(heading)[:80]!r} was found; "
            f"{','.join(COLUMNS)} is accepted"
        )
    if not 1 <= len(rows) - 1 <= _MOST_POINTS:
        raise InspectionPointsError(
            f"{path.name}: {len(rows) - 1} points were found; 1 to {_MOST_POINTS} are accepted"
        )
    return rows[1:]


def _numbers(path: Path, line: int, row: list[str]) -> list[float]:
    try:
        values = [float(cell) for cell in row]
    except ValueError:
        values = []
    if len(values) != len(COLUMNS) or not np.all(np.isfinite(values)):
        raise InspectionPointsError(
            f"{path.name}: line {line}: {','.join(row)[:80]!r} was found; {len(COLUMNS)} finite "
            f"numbers {','.join(COLUMNS)} are accepted"
        )
    group = values[-1]
    if group != int(group) or not 1 <= group <= _MOST_GROUPS:
        raise InspectionPointsError(
            f"{path.name}: line {line}: group {group:g} was found; a whole number from 1 to "
            f"{_MOST_GROUPS} is accepted"
        )
    return values


def _require_on_part(path: Path, raw: Array, unit: str, mesh: SurfaceMesh) -> None:
    """Raises where points, shape (n, 3) [unit], are not on the part."""
    if not _in_box(raw * UNITS_M[unit], mesh).all():
        fitting = [
            name for name, scale in UNITS_M.items()
            if name != unit and _in_box(raw * scale, mesh).all()
        ]  # fmt: skip
        hint = f"; read in {fitting[0]} they are: is the unit wrong?" if fitting else ""
        outside = int(np.flatnonzero(~_in_box(raw * UNITS_M[unit], mesh))[0])
        raise InspectionPointsError(
            f"{path.name}: point {outside + 1}, {raw[outside].tolist()} {unit}, is outside of the "
            f"part's box; points on the surface, in the unit of the part, are accepted{hint}"
        )
    index = SurfaceIndex(mesh, sample_surface(mesh, float(np.sqrt(mesh.area / 20_000.0))))
    distance = index.closest(raw * UNITS_M[unit]).distance
    worst = int(np.argmax(distance))
    if distance[worst] > _FARTHEST_M:
        raise InspectionPointsError(
            f"{path.name}: point {worst + 1}, {raw[worst].tolist()} {unit}, is "
            f"{1000.0 * distance[worst]:.1f} mm from the part's surface; up to "
            f"{1000.0 * _FARTHEST_M:g} mm are accepted (is the unit, or the mesh, another one?)"
        )


def _in_box(places: Array, mesh: SurfaceMesh) -> NDArray[np.bool_]:
    low, high = mesh.bounds
    room = _FARTHEST_M + _BOX_ROOM * float(np.linalg.norm(high - low))
    return np.asarray(np.all((places >= low - room) & (places <= high + room), axis=1))
