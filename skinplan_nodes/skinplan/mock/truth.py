"""What only a simulation can know: where the part and the base really stand at the start."""

import numpy as np

from skinplan.part.model import Part
from skinplan.robot.cell import CellConfig
from skinplan.transforms import Array, planar, require_transform

PLACE_ERROR_M = 0.03
PLACE_ERROR_RAD = float(np.radians(1.0))
# The base starts so far from the work position: back along its heading and away from the part.
_START_FROM_WORK = planar(-1.5, -1.0, 0.0)


class Truth:
    """True places of one run.

    The fixture stands on the floor: the part is moved by at most `PLACE_ERROR_M` along the floor
    (uniform over a disc) and turned by at most `PLACE_ERROR_RAD` about the vertical through its
    origin; height and upright stance are as drawn.

    Args:
        part: Its nominal place is what the draw starts from.
        cell: Its work position is what the start of the base goes by.
        seed: Of the draw.

    Attributes:
        T_map_workpiece: Where the part truly stands, shape (4, 4) [m].
        T_map_base_start: Where the base believes to stand at the start, shape (4, 4) [m].
    """

    def __init__(self, part: Part, cell: CellConfig, seed: int) -> None:
        random = np.random.default_rng([seed, 0x7247])
        radius = PLACE_ERROR_M * np.sqrt(random.uniform())
        bearing = random.uniform(-np.pi, np.pi)
        turn = random.uniform(-PLACE_ERROR_RAD, PLACE_ERROR_RAD)
        place = require_transform(part.T_map_workpiece, "T_map_workpiece of the part").copy()
        place[:3, 3] += radius * np.array([np.cos(bearing), np.sin(bearing), 0.0])
        place[:3, :3] = planar(0.0, 0.0, turn)[:3, :3] @ place[:3, :3]
        self.T_map_workpiece: Array = place
        self.T_map_base_start: Array = cell.T_map_work @ _START_FROM_WORK
