"""What the readers of mesh files hand on, and how polygons become triangles."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.mesh.model import Finding
from skinplan.transforms import Array

Indices = NDArray[np.int64]

MOST_FACES = 10_000_000
_MOST_FAN_STARTS = 16


class FormatError(ValueError):
    """The bytes are no file of the format; the message is the reason."""


class TooManyFacesError(Exception):
    """The file has more faces than are accepted.

    Attributes:
        faces: Number of faces found.
    """

    def __init__(self, faces: int) -> None:
        super().__init__(faces)
        self.faces = faces


@dataclass(frozen=True, eq=False)
class RawMesh:
    """A mesh as it stands in its file.

    Attributes:
        vertices: shape (v, 3), in the file's unit; may hold NaN.
        faces: shape (f, 3), vertex numbers from 0; may name vertices that do not exist.
        findings: What the reader noticed.
        unit_m: Length of the file's unit [m] where the file itself says it; else None.
    """

    vertices: Array
    faces: Indices
    findings: tuple[Finding, ...] = ()
    unit_m: float | None = None


def require_few(faces: int) -> None:
    """Raises TooManyFacesError when a file has more faces than are accepted."""
    if faces > MOST_FACES:
        raise TooManyFacesError(faces)


def numbers(text: bytes) -> Array:
    """Reads numbers that are separated by white space.

    Raises:
        FormatError: Something else stands between them.
    """
    if not text.strip():
        return np.zeros(0)
    try:
        return np.fromstring(text, dtype=np.float64, sep=" ")
    except ValueError as error:
        raise FormatError("a number was expected, something else was found") from error


def triangulated(vertices: Array, polygons: Iterable[Indices]) -> tuple[Indices, list[Finding]]:
    """Splits polygons into triangles; what has fewer than three corners is left out.

    Args:
        vertices: shape (v, 3).
        polygons: Arrays of polygons with equally many corners, each of shape (m, k).

    Returns:
        Triangles, shape (f, 3), and what was done.
    """
    faces = [np.zeros((0, 3), dtype=np.int64)]
    split = thin = 0
    for group in polygons:
        corners = group.shape[1]
        if corners < 3:
            thin += len(group)
        elif corners == 3:
            faces.append(group)
        elif len(group):
            require_few(len(group) * (corners - 2))
            split += len(group)
            faces.append(_fans(vertices, group))
    findings = []
    if split:
        findings.append(Finding("polygons", split, "repaired", "were split into triangles"))
    if thin:
        detail = "elements with fewer than three corners were left out"
        findings.append(Finding("lines and points", thin, "noted", detail))
    triangles = np.concatenate(faces)
    require_few(len(triangles))
    return triangles, findings


def _fans(vertices: Array, polygons: Indices) -> Indices:
    """Splits polygons, shape (m, k), from the corner that leaves no triangle turned over."""
    count, corners = polygons.shape
    if polygons.min() < 0 or polygons.max() >= len(vertices):
        raise FormatError(f"a face names a vertex that is none of the {len(vertices)}")
    starts = np.zeros(count, dtype=np.int64)
    if corners <= _MOST_FAN_STARTS:
        with np.errstate(all="ignore"):  # what is not finite is reported by name later
            starts = _best_starts(vertices[polygons])
    rolled = polygons[np.arange(count)[:, None], (starts[:, None] + np.arange(corners)) % corners]
    fan = [rolled[:, [0, corner, corner + 1]] for corner in range(1, corners - 1)]
    return np.stack(fan, axis=1).reshape(-1, 3)


def _best_starts(points: Array) -> Indices:
    """Returns for polygons, shape (m, k, 3), the corner whose fan has the largest least area."""
    corners = points.shape[1]
    # Newell's normal: right for concave polygons too.
    normal = np.cross(points - points[:, :1], np.roll(points, -1, axis=1) - points[:, :1])
    normal = normal.sum(axis=1)
    least = []
    for start in range(corners):
        spokes = np.roll(points, -start, axis=1)[:, 1:] - points[:, start, None]
        areas = np.einsum("mkc,mc->mk", np.cross(spokes[:, :-1], spokes[:, 1:]), normal)
        least.append(areas.min(axis=1))
    return np.argmax(np.nan_to_num(np.stack(least, axis=1)), axis=1)
