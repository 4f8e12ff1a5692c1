"""Fixture and place in the shop for a part of which only the mesh is known.

The panel stands upright: workpiece x is map x, workpiece y is map z (up), the outward normal
(workpiece z) is map -y.
"""

import numpy as np

from skinplan.part.model import Fixture, Marker
from skinplan.transforms import Array, transform

DICTIONARY = "DICT_5X5_100"
MARKER_SIZE_M = 0.10
MARKER_PITCH_M = 0.40
MARKER_DROP_M = 0.10
_LEAST_CENTRE_HEIGHT_M = 1.05
_LEAST_EDGE_HEIGHT_M = 0.55
# Higher markers leave the image of the camera (0.45 m above the floor) when it comes near.
_MOST_MARKER_HEIGHT_M = 0.55
_UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def default_fixture(bounds: Array) -> Fixture:
    """Makes a fixture with a row of markers below the lower edge of a part.

    The fixture frame stands parallel to the workpiece, its origin in the middle of the row. Markers
    of 0.10 m stand every 0.40 m over the length of the part, at least two, numbered from 0 along x;
    the row is 0.10 m below the edge, or lower where it would be too high for the camera.

    Args:
        bounds: Box of the part in the workpiece frame, shape (2, 3) [m].

    Returns:
        The fixture.
    """
    length = float(bounds[1, 0] - bounds[0, 0])
    middle = float(bounds[0, 0] + bounds[1, 0]) / 2
    count = max(2, int((length - MARKER_SIZE_M) / MARKER_PITCH_M) + 1)
    # A part too short for two markers at the usual pitch has them as near as the white border
    # around them allows.
    pitch = (
        MARKER_PITCH_M
        if count > 2
        else float(np.clip(length - MARKER_SIZE_M, 0.15, MARKER_PITCH_M))
    )
    places = (np.arange(count) - (count - 1) / 2) * pitch
    markers = tuple(
        Marker(number, MARKER_SIZE_M, transform((round(float(x), 6), 0.0, 0.0)))
        for number, x in enumerate(places)
    )
    floor = -float(default_placement(bounds)[2, 3])
    row = min(float(bounds[0, 1]) - MARKER_DROP_M, floor + _MOST_MARKER_HEIGHT_M)
    origin = (round(middle, 6), round(row, 6), 0.0)
    return Fixture(DICTIONARY, transform(origin), markers)


def default_placement(bounds: Array) -> Array:
    """Returns ``T_map_workpiece``, shape (4, 4) [m], of a part upright at the shop's origin.

    Args:
        bounds: Box of the part in the workpiece frame, shape (2, 3) [m].
    """
    half_height = float(bounds[1, 1] - bounds[0, 1]) / 2
    centre = float(bounds[0, 1] + bounds[1, 1]) / 2
    height = max(_LEAST_CENTRE_HEIGHT_M, _LEAST_EDGE_HEIGHT_M + half_height)
    return transform((0.0, 0.0, round(height - centre, 6)), _UPRIGHT)
