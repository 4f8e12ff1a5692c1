"""The sample part ``engine``: the mock-up of an aero-engine that C 4 plans its stations for.

Published are the length (2600 mm), the largest and smallest diameter (600 and 260 mm), "cylinders
and cones", three surfaces on one side with 50 points each at equal steps of their surface
parameters, and the first and last point of each surface. What follows from them:

- The midpoints of the published pairs of surfaces 2 and 3 are 300 mm high: the axis is level at z =
  0.300 m, and the lowest generator of the 600 mm end at z = 0. The floor is at z = -0.752 m, and z
  = 0 is the height of the arm's base (C 4): the axis is 1.052 m above the floor.
- The radii at the published points are those of a cylinder of 290 mm and one of 260 mm and of a
  cone of slope 150/700 to within 5 um when the axis is turned by 1.6 mrad about the vertical
  through the origin: along (0.0016, 1, 0). Without that turn the two ends of a surface are not
  symmetric to their cylinder. It also explains the published stations: their y gives Y_min =
  -2449.601 mm, 0.146 mm less than the lowest published y.
- The published points lie 16.5 degrees from the vertical plane of the axis, which is the eleventh
  part of the half turn, and 4/6 of a surface's length apart: ten points around by five along.

So: a cone, 600 to 300 mm over 700 mm, a cylinder of 290 mm over 1000 mm, one of 260 mm over 900 mm,
from y = 0 to -2.600 m; points of the side x > 0. Fillets of about 1 mm that the figures hint at are
left out. The frame of the part is the frame of the paper.
"""

import math

import numpy as np
from numpy.typing import NDArray

from skinplan.mesh.model import SurfaceMesh
from skinplan.transforms import Array, transform

LENGTH_M = 2.6
AXIS_HEIGHT_M = 0.3
ARM_BASE_HEIGHT_M = 0.752  # the arm's base, z = 0 of the part's frame, above the floor
AXIS_TURN = 0.0016  # dx/dy of the axis
POINTS_AROUND, POINTS_ALONG = 10, 5
#: Profile from the large end on: (distance along the axis [m], radius [m]).
PROFILE = ((0.0, 0.300), (0.7, 0.150), (0.7, 0.145), (1.7, 0.145), (1.7, 0.130), (2.6, 0.130))
#: First and last point of surfaces 1, 2 and 3 (C Table 3), shape (3, 2, 3) [m].
KNOWN_POINTS = (
    np.array(
        [
            [[48.834, -582.945, 467.879], [77.938, -117.257, 36.434]],
            [[38.767, -1532.730, 439.021], [39.826, -867.397, 160.978]],
            [[33.044, -2449.455, 424.639], [33.997, -1850.655, 175.360]],
        ]
    )
    / 1000.0
)


def engine_points() -> tuple[Array, Array, NDArray[np.int64]]:
    """Returns the 150 measuring points of C 4.

    Returns:
        Points, shape (150, 3) [m], outward unit normals, shape (150, 3), both in the part's frame,
        and the number of the surface, 1 to 3, shape (150,). Within a surface they run along the
        axis first, then around: the first and the last one are the published ones.
    """
    along, side, up = _axes()
    points, normals = [], []
    for number, ends in enumerate(KNOWN_POINTS):
        offset = ends - np.array([0.0, 0.0, AXIS_HEIGHT_M])
        angles = np.arctan2(offset @ side, offset @ up)
        radii = np.hypot(offset @ side, offset @ up)
        around = np.linspace(angles[0], angles[1], POINTS_AROUND)
        share = np.linspace(0.0, 1.0, POINTS_ALONG)
        angle, part = (a.ravel() for a in np.meshgrid(around, share, indexing="ij"))
        radius = radii[0] + part * (radii[1] - radii[0])
        place = (offset @ along)[0] + part * np.diff(offset @ along)
        radial = np.sin(angle)[:, None] * side + np.cos(angle)[:, None] * up
        points.append(place[:, None] * along + radius[:, None] * radial)
        slope = _slope(2 * number)
        normals.append((radial - slope * along) / math.hypot(1.0, slope))
    surfaces = np.repeat(np.arange(1, 4), POINTS_AROUND * POINTS_ALONG)
    height = np.array([0.0, 0.0, AXIS_HEIGHT_M])
    return np.concatenate(points) + height, np.concatenate(normals), surfaces


def engine_mesh(triangles: int = 100_000, ends: bool = True) -> SurfaceMesh:
    """Makes the engine's whole surface, outward.

    Args:
        triangles: About how many triangles, at least 100.
        ends: Whether both ends are closed.

    Returns:
        The mesh in the part's frame [m]; coordinates are rounded to 0.1 um, so that every machine
        makes the same.
    """
    lengths = [math.dist(a, b) for a, b in zip(PROFILE, PROFILE[1:], strict=False)]
    cell = math.sqrt(2.0 * _area() / max(100, triangles))
    stations = [PROFILE[0]]
    for (y0, r0), (y1, r1), length in zip(PROFILE, PROFILE[1:], lengths, strict=False):
        count = max(1, round(length / cell))
        stations += [
            (y0 + (y1 - y0) * k / count, r0 + (r1 - r0) * k / count) for k in range(1, count + 1)
        ]
    around = max(12, round(2.0 * math.pi * 0.18 / cell))
    vertices = _rings(np.array(stations), around)
    faces = _ring_faces(len(stations), around)
    if not ends:
        vertices, faces = vertices[:-2], faces[: -2 * around]
    return SurfaceMesh(np.round(vertices, 7), faces)


def engine_placement() -> Array:
    """Returns ``T_map_workpiece``, shape (4, 4) [m]: the floor of the shop is z = 0 of the map."""
    return transform((0.0, 0.0, ARM_BASE_HEIGHT_M))


def _axes() -> tuple[Array, Array, Array]:
    """Unit vectors along the axis (+y), sideways (+x) and up."""
    length = math.hypot(1.0, AXIS_TURN)
    along = np.array([AXIS_TURN, 1.0, 0.0]) / length
    side = np.array([1.0, -AXIS_TURN, 0.0]) / length
    return along, side, np.array([0.0, 0.0, 1.0])


def _slope(piece: int) -> float:
    """Growth of the radius along +y over a piece of the profile."""
    (y0, r0), (y1, r1) = PROFILE[piece], PROFILE[piece + 1]
    return (r0 - r1) / (y1 - y0)


def _area() -> float:
    pieces = zip(PROFILE, PROFILE[1:], strict=False)
    sides = sum(math.pi * (a[1] + b[1]) * math.dist(a, b) for a, b in pieces)
    return sides + math.pi * (PROFILE[0][1] ** 2 + PROFILE[-1][1] ** 2)


def _rings(stations: Array, around: int) -> Array:
    """Vertices: rings along the axis, then the middle of the large and of the small end."""
    along, side, up = _axes()
    angle = 2.0 * math.pi * np.arange(around) / around
    radial = np.sin(angle)[:, None] * side + np.cos(angle)[:, None] * up
    rings = -stations[:, None, :1] * along + stations[:, None, 1:] * radial
    ends = -stations[[0, -1], :1] * along
    middle = np.array([0.0, 0.0, AXIS_HEIGHT_M])
    return np.asarray(np.concatenate([rings.reshape(-1, 3), ends]) + middle)


def _ring_faces(rings: int, around: int) -> NDArray[np.int64]:
    ring, step = np.divmod(np.arange((rings - 1) * around, dtype=np.int64), around)
    a, b = ring * around + step, ring * around + (step + 1) % around
    c, d = a + around, b + around
    sides = np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)])
    first = np.arange(around, dtype=np.int64)
    after = (first + 1) % around
    last = (rings - 1) * around
    large = np.stack([np.full(around, rings * around), first, after], axis=1)
    small = np.stack([np.full(around, rings * around + 1), last + after, last + first], axis=1)
    return np.concatenate([sides, large, small])
