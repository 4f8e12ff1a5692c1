"""Random layouts of parts on the tray, with the truth kept.

Frame of the tray: origin at a corner of its upper side, x along the longer side, z up.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from skinplan.errors import InputError
from skinplan.recognition.tray.blocks import boundary
from skinplan.recognition.tray.parts import MAKERS, part_mesh
from skinplan.transforms import Array, apply, transform

TRAY_SIZE_M = (1.8, 0.9)
# The tray is a grid of bars.
GRID_PITCH_M, BAR_WIDTH_M, BAR_HEIGHT_M = 0.03, 0.004, 0.004
_TRIES = 150
_RESTARTS = 5


@dataclass(frozen=True, eq=False)
class PlacedPart:
    """A part on the tray.

    Attributes:
        name: Its type.
        T_tray_part: Where it lies, shape (4, 4) [m].
        mesh: In the part's frame [m].
        upside_down: It was turned over before it was put down.
    """

    name: str
    T_tray_part: Array
    mesh: trimesh.Trimesh
    upside_down: bool = False

    @property
    def points(self) -> Array:
        """Vertices on the tray, shape (n, 3) [m]."""
        return apply(self.T_tray_part, self.mesh.vertices)

    @property
    def outline(self) -> Array:
        """Convex outline seen from above, counter-clockwise, shape (n, 2) [m]."""
        return _hull(self.points)


def tray_grid(size_m: tuple[float, float] = TRAY_SIZE_M) -> trimesh.Trimesh:
    """Makes the grid of the tray: bars with square openings, upper side at z = 0 [m]."""
    along = [_bar_lines(length) for length in size_m]
    bars = [np.arange(len(each) - 1) % 2 == 0 for each in along]
    keep = bars[0][:, None] | bars[1][None, :]
    return boundary(
        along[0], along[1], np.array([-BAR_HEIGHT_M, 0.0]), keep[:, :, None], lambda grid: grid
    )


def layout(
    seed: int,
    names: Sequence[str] | None = None,
    upside_down: Sequence[str] = (),
    gap_m: float = 0.02,
    size_m: tuple[float, float] = TRAY_SIZE_M,
) -> tuple[PlacedPart, ...]:
    """Puts parts at random places and headings on the tray, none over another.

    Args:
        seed: The same seed gives the same layout.
        names: Types, each put as often as it is named; None = each of the nine once.
        upside_down: Types that are turned over first.
        gap_m: Least distance between convex outlines, and to the tray's edge [m].
        size_m: Tray.

    Returns:
        The parts in the order of their names.

    Raises:
        InputError: An unknown name, or no place is found.
    """
    wanted = tuple(MAKERS) if names is None else tuple(names)
    if unknown := sorted(set(upside_down) - set(wanted)):
        raise InputError(
            f"{', '.join(unknown)} were to lie upside down; types on the tray are accepted"
        )
    meshes = {name: part_mesh(name) for name in wanted}
    rng = np.random.default_rng(seed)
    # The largest first: small ones find a place between them.
    order = sorted(range(len(wanted)), key=lambda i: -float(meshes[wanted[i]].extents[:2].max()))
    for _ in range(_RESTARTS):
        placed: dict[int, PlacedPart] = {}
        for i in order:
            name = wanted[i]
            others = [other.outline for other in placed.values()]
            part = _put(name, meshes[name], name in upside_down, others, gap_m, size_m, rng)
            if part is None:
                break
            placed[i] = part
        else:
            return tuple(placed[i] for i in range(len(wanted)))
    raise InputError(
        f"{len(wanted)} parts were to lie {gap_m:g} m apart on a tray of {size_m[0]:g} x "
        f"{size_m[1]:g} m; no place was found, fewer parts or a smaller gap are accepted"
    )


def resting(mesh: trimesh.Trimesh, heading_rad: float, upside_down: bool) -> Array:
    """Pose of a part that lies on the tray with its box centred over the tray's origin, (4, 4)."""
    turn = Rotation.from_euler("xz", [np.pi if upside_down else 0.0, heading_rad]).as_matrix()
    points = mesh.vertices @ turn.T
    low, high = points.min(axis=0), points.max(axis=0)
    middle = (low + high) / 2.0
    return transform((-middle[0], -middle[1], -low[2]), turn)


def _put(
    name: str,
    mesh: trimesh.Trimesh,
    upside_down: bool,
    others: list[Array],
    gap_m: float,
    size_m: tuple[float, float],
    rng: np.random.Generator,
) -> PlacedPart | None:
    for _ in range(_TRIES):
        pose = resting(mesh, rng.uniform(0.0, 2.0 * np.pi), upside_down)
        half = np.abs(apply(pose, mesh.vertices)[:, :2]).max(axis=0) + gap_m
        room = np.array(size_m) - 2.0 * half
        if np.any(room < 0.0):
            continue
        pose[:2, 3] += half + room * rng.random(2)
        part = PlacedPart(name, pose, mesh, upside_down)
        outline = part.outline
        if all(_apart(outline, other, gap_m) for other in others):
            return part
    return None


def _hull(points: Array) -> Array:
    flat = np.asarray(points[:, :2])
    return np.asarray(flat[ConvexHull(flat).vertices])


def _apart(one: Array, other: Array, gap_m: float) -> bool:
    """Says if an edge of one of two convex outlines separates them by the gap."""
    for first, second in ((one, other), (other, one)):
        edges = np.roll(first, -1, axis=0) - first
        outward = np.stack([edges[:, 1], -edges[:, 0]], axis=1)
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        limit = np.einsum("ij,ij->i", outward, first)
        if np.any((outward @ second.T).min(axis=1) - limit >= gap_m):
            return True
    return False


def _bar_lines(length: float) -> Array:
    pitches = round((length - BAR_WIDTH_M) / GRID_PITCH_M)
    starts = np.linspace(0.0, length - BAR_WIDTH_M, pitches + 1)
    return np.stack([starts, starts + BAR_WIDTH_M], axis=1).ravel()
