"""Parallel views of a part: where a point of space is in a picture."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import InputError
from skinplan.mesh.model import SurfaceMesh
from skinplan.scan_path.frame import base_normal, candidate_frames, vertex_areas
from skinplan.transforms import Array

_MARGIN = 0.04
_LEVEL = 0.05  # a part that lies has no upper side: its picture is left as it is


@dataclass(frozen=True, eq=False)
class ParallelView:
    """A parallel projection with a window, in the frame of the mesh.

    The picture plane has the coordinates u = p . right and v = p . up [m]; depth is p . toward [m],
    the greater the nearer to the viewer.

    Attributes:
        right: Unit vector to the right, shape (3,).
        up: Unit vector upward, shape (3,).
        left: Least u of the window [m].
        bottom: Least v of the window [m].
        columns: Width of the picture [px].
        rows: Height of the picture [px].
        pixel_m: Side of a pixel [m].
    """

    right: Array
    up: Array
    left: float
    bottom: float
    columns: int
    rows: int
    pixel_m: float

    @property
    def toward(self) -> Array:
        """Unit vector from the part to the viewer, shape (3,)."""
        return np.cross(self.right, self.up)

    @property
    def width_m(self) -> float:
        """Width of the window [m]."""
        return self.columns * self.pixel_m

    @property
    def height_m(self) -> float:
        """Height of the window [m]."""
        return self.rows * self.pixel_m

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top of the window [m]."""
        return (self.left, self.left + self.width_m, self.bottom, self.bottom + self.height_m)

    def plane(self, points: Array) -> Array:
        """Returns u and v of points, shape (n, 3) [m], as shape (n, 2) [m]."""
        return np.asarray(points, dtype=float) @ np.stack([self.right, self.up], axis=1)

    def depth(self, points: Array) -> Array:
        """Returns the depth of points, shape (n, 3) [m], as shape (n,) [m]."""
        return np.asarray(points, dtype=float) @ self.toward

    def pixels(self, points: Array) -> NDArray[np.int64]:
        """Returns row and column of points, shape (n, 3) [m], as shape (n, 2); top row is 0.

        Points outside the window get rows or columns outside the picture.
        """
        flat = (self.plane(points) - (self.left, self.bottom)) / self.pixel_m
        cells = np.floor(flat).astype(np.int64)
        return np.stack([self.rows - 1 - cells[:, 1], cells[:, 0]], axis=1)

    def pixel_centres(self) -> Array:
        """Returns the places of the pixels at depth 0, shape (rows, columns, 3) [m]."""
        u = self.left + (np.arange(self.columns) + 0.5) * self.pixel_m
        v = self.bottom + (self.rows - 0.5 - np.arange(self.rows)) * self.pixel_m
        return u[None, :, None] * self.right + v[:, None, None] * self.up

    def finer(self, factor: int) -> "ParallelView":
        """Returns the same window with ``factor`` times as many pixels each way."""
        return replace(
            self,
            columns=self.columns * factor,
            rows=self.rows * factor,
            pixel_m=self.pixel_m / factor,
        )


def view_of(points: Array, right: Array, toward: Array, width_px: int) -> ParallelView:
    """Makes the view of points that shows all of them.

    Args:
        points: shape (n, 3) [m], at least one, finite.
        right: Unit vector to the right, shape (3,).
        toward: Unit vector to the viewer, perpendicular to right, shape (3,).
        width_px: Width of the picture [px].

    Returns:
        The view, with a margin of 4 % of the longer side.

    Raises:
        InputError: No points, or points that are not finite.
    """
    places = np.asarray(points, dtype=float)
    if places.ndim != 2 or places.shape[1] != 3 or not len(places):
        raise InputError(f"a view of points of shape (n, 3) is accepted, found {places.shape}")
    if not np.isfinite(places).all():
        raise InputError("a view of finite points is accepted, found NaN or infinite values")
    up = np.cross(toward, right)
    flat = places @ np.stack([right, up], axis=1)
    low, high = flat.min(axis=0), flat.max(axis=0)
    size = np.maximum(high - low, 1e-3)
    edge = _MARGIN * size.max()
    pixel = float(size[0] + 2 * edge) / width_px
    rows = max(1, int(np.ceil((size[1] + 2 * edge) / pixel)))
    middle = 0.5 * (low + high)
    return ParallelView(
        right=np.asarray(right, dtype=float),
        up=up,
        left=float(middle[0] - 0.5 * width_px * pixel),
        bottom=float(middle[1] - 0.5 * rows * pixel),
        columns=width_px,
        rows=rows,
        pixel_m=pixel,
    )


def front_axes(mesh: SurfaceMesh) -> tuple[Array, Array]:
    """Returns right and toward of the front view: along the mean normal, long side horizontal.

    Raises:
        MeshRefusedError: The part has no side that faces a viewer.
    """
    base = base_normal(mesh)
    return candidate_frames(mesh.vertices, base, vertex_areas(mesh))[0].along, base


def front_view(mesh: SurfaceMesh, width_px: int, turned: bool = False) -> ParallelView:
    """Makes the view from the front.

    Args:
        mesh: The part.
        width_px: Width of the picture [px].
        turned: Turn the picture by half a turn.

    Raises:
        MeshRefusedError: The part has no side that faces a viewer.
    """
    right, toward = front_axes(mesh)
    return view_of(mesh.vertices, -right if turned else right, toward, width_px)


def is_upside_down(mesh: SurfaceMesh, T_map_workpiece: Array) -> bool:
    """Tells whether up in the front view is down in the shop.

    Args:
        mesh: The part, workpiece frame.
        T_map_workpiece: Part in the shop, shape (4, 4) [m].

    Raises:
        MeshRefusedError: The part has no side that faces a viewer.
    """
    right, toward = front_axes(mesh)
    return bool(T_map_workpiece[2, :3] @ np.cross(toward, right) < -_LEVEL)


def raised_view(
    mesh: SurfaceMesh,
    width_px: int,
    raise_rad: float = np.deg2rad(55.0),
    turned: bool = False,
) -> ParallelView:
    """Makes the view from above the front: view directions appear as arrows, tilts as leaning ones.

    Args:
        mesh: The part.
        width_px: Width of the picture [px].
        raise_rad: How far the viewer is raised from the front [rad].
        turned: Turn the picture by half a turn; the viewer is raised to the other side.

    Raises:
        MeshRefusedError: The part has no side that faces a viewer.
    """
    right, front = front_axes(mesh)
    right = -right if turned else right
    up = np.cross(front, right)
    toward = np.cos(raise_rad) * front + np.sin(raise_rad) * up
    return view_of(mesh.vertices, right, toward, width_px)
