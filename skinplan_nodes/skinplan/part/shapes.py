"""Height fields from which the sample parts are made.

Only sums, products and square roots of IEEE numbers are used on arrays: they are exact to the last
bit everywhere, so that every machine and Python version writes the same bytes.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skinplan.transforms import Array


@dataclass(frozen=True)
class Plateau:
    """A bump (or recess): flat top, inclined wall all round, fillets at foot and shoulder.

    Attributes:
        centre_m: Middle of the outline, (x, y) [m].
        size_m: Outline at half height, (length along x, length along y) [m].
        corner_m: Corner radius of the outline [m].
        height_m: Height; negative = recess [m].
        wall_rad: Steepest slope of the wall against the base surface [rad].
        fillet_m: Radius of both fillets [m].
    """

    centre_m: tuple[float, float]
    size_m: tuple[float, float]
    corner_m: float
    height_m: float
    wall_rad: float
    fillet_m: float

    def height(self, x: Array, y: Array) -> Array:
        """Returns the height over the base surface [m] at x, y, any equal shapes [m]."""
        half = (self.size_m[0] / 2 - self.corner_m, self.size_m[1] / 2 - self.corner_m)
        across = np.abs(x - self.centre_m[0]) - half[0]
        along = np.abs(y - self.centre_m[1]) - half[1]
        outside = np.sqrt(np.maximum(across, 0.0) ** 2 + np.maximum(along, 0.0) ** 2)
        distance = outside + np.minimum(np.maximum(across, along), 0.0) - self.corner_m
        return math.copysign(1.0, self.height_m) * self._wall(distance)

    def _wall(self, distance: Array) -> Array:
        """Returns the height over the signed distance [m] from the outline, outside positive."""
        sine, cosine = math.sin(self.wall_rad), math.cos(self.wall_rad)
        height, radius = abs(self.height_m), self.fillet_m
        if 2 * radius * (1 - cosine) > height:
            raise ValueError("the fillets are too large for the height")
        half_wall = (height / 2 - radius * (1 - cosine)) * cosine / sine
        half_width = half_wall + radius * sine
        # The profile is point-symmetric about half height: one side is enough.
        inward = np.minimum(half_width - np.abs(distance), 2 * half_width)
        foot = radius - np.sqrt(
            np.maximum(radius**2 - np.clip(inward, 0.0, radius * sine) ** 2, 0.0)
        )
        rise = foot + np.maximum(inward - radius * sine, 0.0) * (sine / cosine)
        low = np.where(inward > 0.0, np.minimum(rise, height / 2), 0.0)
        return np.where(distance >= 0.0, low, height - low)


@dataclass(frozen=True)
class Panel:
    """A panel: a curved base surface with plateaus on it.

    Attributes:
        size_m: Size along x and y [m].
        radius_y_m: Radius of the base surface's curvature across the panel [m].
        radius_x_m: Same along the panel; 0 = straight [m].
        features: Bumps and recesses.
    """

    size_m: tuple[float, float]
    radius_y_m: float
    radius_x_m: float
    features: tuple[Plateau, ...]

    def height(self, x: Array, y: Array) -> Array:
        """Returns the height of the surface [m] at x, y, any equal shapes [m]."""
        surface = np.sqrt(self.radius_y_m**2 - y**2) - self.radius_y_m
        if self.radius_x_m:
            surface = surface + np.sqrt(self.radius_x_m**2 - x**2) - self.radius_x_m
        for feature in self.features:
            surface = surface + feature.height(x, y)
        return surface

    def triangulate(self, triangles: int) -> tuple[Array, NDArray[np.int64]]:
        """Makes a mesh of about the given number of triangles, with its box centred on the origin.

        Args:
            triangles: How many triangles to aim at.

        Returns:
            Vertices, shape (v, 3) [m], and faces, shape (f, 3), outward +z.
        """
        cell = math.sqrt(2 * self.size_m[0] * self.size_m[1] / triangles)
        columns, rows = (max(2, round(size / cell)) for size in self.size_m)
        x, y = np.meshgrid(
            (np.arange(columns + 1) / columns - 0.5) * self.size_m[0],
            (np.arange(rows + 1) / rows - 0.5) * self.size_m[1],
        )
        z = self.height(x, y)
        z = z - (z.max() + z.min()) / 2
        vertices = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
        return vertices, _grid_faces(columns, rows)


def write_stl(path: Path, vertices: Array, faces: NDArray[np.int64]) -> None:
    """Writes a binary STL file.

    Args:
        path: The file.
        vertices: shape (v, 3), in the unit of the file.
        faces: shape (f, 3).
    """
    corners = vertices[faces]
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.sqrt((crosses**2).sum(axis=1, keepdims=True))
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    records = np.zeros(len(faces), dtype=record)
    records["normal"] = np.divide(crosses, lengths, out=np.zeros_like(crosses), where=lengths > 0)
    records["corners"] = corners
    header = b"binary STL, metres".ljust(80, b" ") + len(faces).to_bytes(4, "little")
    path.write_bytes(header + records.tobytes())


def _grid_faces(columns: int, rows: int) -> NDArray[np.int64]:
    """Makes two faces per cell; the diagonals alternate, so that no direction is preferred."""
    row, column = np.divmod(np.arange(rows * columns, dtype=np.int64), columns)
    a = row * (columns + 1) + column
    b, c, d = a + 1, a + columns + 2, a + columns + 1
    even = ((row + column) % 2 == 0)[:, None]
    first = np.where(even, np.stack([a, b, c], axis=1), np.stack([a, b, d], axis=1))
    second = np.where(even, np.stack([a, c, d], axis=1), np.stack([b, c, d], axis=1))
    return np.stack([first, second], axis=1).reshape(-1, 3)
