"""The frame that contact measurement is planned in (C 3.1)."""

import math

from skinplan.errors import InspectionPointsError
from skinplan.transforms import Array, planar, transform

_UPRIGHT = 0.98  # least horizontal share of the part's y axis


def axial_frame(T_map_workpiece: Array, height_m: float) -> Array:
    """Returns ``T_map_axial``, shape (4, 4) [m].

    Args:
        T_map_workpiece: Part in the shop, shape (4, 4) [m].
        height_m: The arm's base above the floor [m].

    Raises:
        InspectionPointsError: The part's y axis is not level.
    """
    axis = T_map_workpiece[:3, 1]
    level = math.hypot(axis[0], axis[1])
    if level < _UPRIGHT:
        raise InspectionPointsError(
            f"the part's y axis rises by {math.degrees(math.asin(abs(axis[2]))):.1f} degrees; "
            "a part whose axis y is level is accepted"
        )
    heading = math.atan2(axis[1], axis[0]) - 0.5 * math.pi
    place = planar(T_map_workpiece[0, 3], T_map_workpiece[1, 3], heading)
    return transform((0.0, 0.0, height_m)) @ place
