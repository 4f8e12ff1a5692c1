"""From which stations the camera sees the part's markers well enough to locate it (M1.2).

At a station the base does not come nearer: what it sees from there has to do.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import MarkersUnseenError
from skinplan.localization.approach import stop_miss_m
from skinplan.localization.camera import camera_model
from skinplan.localization.stand import predicted_quality
from skinplan.part.model import Fixture
from skinplan.robot.cell import CellConfig
from skinplan.transforms import Array

# The place of the part in the shop is as wrong as the base was when the part was located: 50 mm
# more distance cost 0.011 of E by the default figures, the heading of a base 1.3 m aside of what it
# looked at as much as another 23 mm.
MARGIN = 0.015


@dataclass(frozen=True, eq=False)
class MarkerView:
    """What the camera is to see from each station.

    Attributes:
        fixture: The markers.
        margin: E that is asked for beyond T_E [1].
        threshold: T_E of eq (3) [1]; 0 = the cell's.
    """

    fixture: Fixture
    margin: float = MARGIN
    threshold: float = 0.0

    def required(self, cell: CellConfig) -> float:
        """Returns the E that is asked for; more than 1 there is not."""
        return min(1.0, (self.threshold or cell.quality.threshold) + self.margin)

    def quality(self, cell: CellConfig, T_map_workpiece: Array, poses: Array) -> Array:
        """Predicts E from poses of the base.

        Args:
            cell: The cell.
            T_map_workpiece: Part in the shop, shape (4, 4) [m].
            poses: ``T_map_base_link``, shape (c, 4, 4) [m].

        Returns:
            shape (c,); 0 = too few markers in the image.
        """
        lever = float(np.linalg.norm(cell.camera.T_base_link_optical[:2, 3]))
        camera, miss = camera_model(cell.camera), stop_miss_m(cell, lever)
        return predicted_quality(poses, T_map_workpiece, self.fixture, camera, cell, miss)

    def suffices(self, cell: CellConfig, T_map_workpiece: Array, poses: Array) -> NDArray[np.bool_]:
        """Tells from which poses E is as large as asked for; arguments as `quality`, (c,)."""
        return self.quality(cell, T_map_workpiece, poses) >= self.required(cell)

    def words(self, cell: CellConfig) -> str:
        """Says what is missing at a place that does not suffice."""
        return f"the camera sees no marker with E >= {self.required(cell):.3f}"

    def unseen(self, cell: CellConfig, T_map_workpiece: Array, poses: Array) -> MarkersUnseenError:
        """Returns the error of a part that is located from none of the free places.

        Args:
            cell: The cell.
            T_map_workpiece: Part in the shop, shape (4, 4) [m].
            poses: The places that would do but for the markers, shape (c, 4, 4) [m].
        """
        quality = self.quality(cell, T_map_workpiece, poses)
        best = int(np.argmax(quality))
        x, y = poses[best, :2, 3]
        found = f"the best is {quality[best]:.3f}, from ({x:.2f}, {y:.2f}) m"
        if quality[best] <= 0.0:
            found = "from none enough of them are in the image, facing it and large enough"
        threshold = self.threshold or cell.quality.threshold
        return MarkersUnseenError(
            f"a marker seen with E >= {self.required(cell):.3f} (T_E {threshold:.3f} and a margin "
            f"of {self.margin:.3f}) was asked of each station; of the {len(poses)} places that "
            f"would do without, {found}; markers that face these places at the camera's height, a "
            "lower T_E or a lower margin are accepted"
        )
