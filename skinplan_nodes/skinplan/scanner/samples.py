"""Points spread evenly over a surface."""

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import InputError
from skinplan.mesh.axes import own_axes
from skinplan.mesh.model import SurfaceMesh
from skinplan.scanner.model import SurfaceSamples
from skinplan.transforms import Array

# Steps of the two-dimensional sequence of least discrepancy that the plastic number gives.
_STEPS = (0.7548776662466927, 0.5698402909980532)
# Any start in (0, 1) would do; a plain fraction would meet the ends of equal faces exactly.
_FIRST = 0.5307
_MOST_SAMPLES = 50_000_000
# Faces are sorted by the cells of a cube with this many bits to a side.
_BITS = 20
_SPREADS = (
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def sample_surface(
    mesh: SurfaceMesh, spacing_m: float = 0.005, faces: NDArray[np.int64] | None = None
) -> SurfaceSamples:
    """Spreads points evenly over a mesh; each stands for the same area. No random numbers.

    Points follow a walk through space, so that the order of the faces has no influence (but on a
    part whose ends are alike).

    Args:
        mesh: The mesh.
        spacing_m: About the distance between neighbours [m]: each point stands for about its
            square.
        faces: Numbers of the faces to sample, shape (n,); None = all.

    Returns:
        The samples.

    Raises:
        InputError: The spacing is not positive, or so small that there were more than 50 million
            points.
    """
    if not np.isfinite(spacing_m) or spacing_m <= 0:
        raise InputError(f"a positive spacing of samples is accepted, found {spacing_m}")
    chosen = np.arange(len(mesh.faces)) if faces is None else np.asarray(faces, dtype=np.int64)
    chosen = chosen[_walk(mesh.corners[chosen].mean(axis=1), mesh.face_areas[chosen])]
    ends = np.cumsum(mesh.face_areas[chosen])
    area = float(ends[-1]) if len(ends) else 0.0
    if area / spacing_m**2 > _MOST_SAMPLES:
        raise InputError(
            f"samples every {spacing_m} m on {area:.3g} m2 are more than {_MOST_SAMPLES}; a "
            "wider spacing is accepted"
        )
    if area <= 0:
        return SurfaceSamples(
            np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, dtype=np.int64), np.zeros(0)
        )
    count = max(1, round(area / spacing_m**2))
    number = np.arange(count)
    picked = np.searchsorted(ends, (number + _FIRST) / count * area, side="right")
    owners = chosen[np.minimum(picked, len(chosen) - 1)]
    shares = barycentric(number)
    points = np.einsum("sc,sci->si", shares, mesh.corners[owners])
    return SurfaceSamples(points, mesh.face_normals[owners], owners, np.full(count, area / count))


def _walk(places: Array, areas: Array) -> NDArray[np.int64]:
    """Sorts places, shape (n, 3), along a curve that fills space (Morton's), shape (n,).

    The curve turns with the part. A part whose axes or ends are alike (a square or a rectangular
    plate) has none of its own; its faces are taken as they come.
    """
    axes = own_axes(places, areas) if len(places) > 1 else None
    if axes is None:
        return np.arange(len(places))
    turned = places @ axes.T
    low = turned.min(axis=0)
    # The cells are laid out askew: planes of symmetry do not run along their walls.
    size = float((turned.max(axis=0) - low).max()) * 1.37
    keys = np.zeros(len(places), dtype=np.int64)
    for axis in range(3):
        cells = ((turned[:, axis] - low[axis]) / size + 0.1234) * 2**_BITS
        keys |= _apart(cells.astype(np.int64)) << axis
    return np.argsort(keys, kind="stable")


def _apart(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Puts two zero bits between the lowest 20 bits of numbers, shape (n,)."""
    spread = cells & 0xFFFFF
    for shift, mask in _SPREADS:
        spread = (spread | (spread << shift)) & mask
    return spread


def barycentric(numbers: NDArray[np.int64]) -> Array:
    """Returns the places inside a triangle of a sequence that fills it evenly.

    Args:
        numbers: Places in the sequence, shape (n,).

    Returns:
        Shares of the three corners, shape (n, 3), sum 1.
    """
    first = (0.5 + numbers * _STEPS[0]) % 1.0
    second = (0.5 + numbers * _STEPS[1]) % 1.0
    folded = first + second > 1.0
    first, second = np.where(folded, 1.0 - first, first), np.where(folded, 1.0 - second, second)
    return np.stack([1.0 - first - second, first, second], axis=1)
