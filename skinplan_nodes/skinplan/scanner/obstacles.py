"""What stands beside the part and may hide it: a simple shape of the fixture."""

import numpy as np

from skinplan.errors import InputError
from skinplan.mesh.model import SurfaceMesh
from skinplan.part.model import Fixture
from skinplan.transforms import apply

# White border of a printed marker about its black square, as a share of the square's side: one and
# a half cells of a board of seven.
BORDER_RATIO = 1.5 / 7.0
BOARD_THICKNESS_M = 0.005
_CORNERS = np.array(
    [[x, y, z] for z in (-1.0, 0.0) for y in (-0.5, 0.5) for x in (-0.5, 0.5)], dtype=float
)
_FACES = np.array(
    [
        [0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4],
        [2, 6, 7], [2, 7, 3], [0, 4, 6], [0, 6, 2], [1, 3, 7], [1, 7, 5],
    ],
    dtype=np.int64,
)  # fmt: skip


def fixture_obstacle(
    fixture: Fixture,
    thickness_m: float = BOARD_THICKNESS_M,
    border_ratio: float = BORDER_RATIO,
) -> SurfaceMesh:
    """Makes a mesh of the fixture as far as its drawing is known: one thin box for each marker.

    The front of each box is the print, with the white border; the box lies behind it.

    Args:
        fixture: The fixture.
        thickness_m: Thickness of the boards [m].
        border_ratio: Width of the white border as a share of the black square's side.

    Returns:
        Closed boxes, normals outward, in the workpiece frame; no faces without markers.

    Raises:
        InputError: A thickness that is not positive, or a border that is negative.
    """
    if not (0.0 < thickness_m < np.inf and 0.0 <= border_ratio < np.inf):
        raise InputError(
            "marker boards with a thickness above 0 and a border from 0 are accepted, found "
            f"{thickness_m} m and {border_ratio}"
        )
    vertices = [np.zeros((0, 3))]
    for marker in fixture.markers:
        side = marker.size_m * (1.0 + 2.0 * border_ratio)
        corners = _CORNERS * (side, side, thickness_m)
        vertices.append(apply(fixture.T_workpiece_marker(marker.id), corners))
    firsts = np.arange(len(fixture.markers)) * len(_CORNERS)
    faces = (_FACES[None, :, :] + firsts[:, None, None]).reshape(-1, 3)
    return SurfaceMesh(np.concatenate(vertices), faces)
