"""How far the localisations of a simulated run were from the truth. Needs no ROS.

Only the job client may know it: the cell itself has to do without.
"""

import bisect
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from skinplan.transforms import Array, difference, inverse, transform

# A base that stands is published seldom or often: its pose holds until the next one.
_EARLY_S = 1.0


@dataclass
class TruthLog:
    """True poses of a run.

    Attributes:
        T_base_link_arm_base: Arm on the base, shape (4, 4) [m].
        T_map_workpiece: Where the part truly stands, shape (4, 4) [m]; None = unknown.
    """

    T_base_link_arm_base: Array
    T_map_workpiece: Array | None = None
    _stamps: list[float] = field(default_factory=list)
    _poses: list[Array] = field(default_factory=list)

    def base_stood(self, stamp_s: float, T_map_base_link: Array) -> None:
        """Notes where the base truly was; a pose like the last one is not kept."""
        if self._poses and np.array_equal(self._poses[-1], T_map_base_link):
            return
        if not self._stamps or stamp_s > self._stamps[-1]:
            self._stamps.append(stamp_s)
            self._poses.append(T_map_base_link)

    def T_arm_base_workpiece(self, stamp_s: float) -> Array | None:
        """Returns where the part truly was in the arm base, shape (4, 4) [m]; None = unknown."""
        number = bisect.bisect_right(self._stamps, stamp_s) - 1
        if self.T_map_workpiece is None or not self._stamps or stamp_s < self._stamps[0] - _EARLY_S:
            return None
        T_map_arm_base = self._poses[max(number, 0)] @ self.T_base_link_arm_base
        return inverse(T_map_arm_base) @ self.T_map_workpiece

    def judged(self, entry: Mapping[str, Any]) -> dict[str, Any]:
        """Returns an entry of ``localization`` with its errors, where the truth is known."""
        found = entry["part_in_arm_base"]
        true = self.T_arm_base_workpiece(float(entry["stamp_s"]))
        if true is None:
            return dict(entry)
        estimated = transform(found["position_m"], found["quaternion_xyzw"])
        distance, angle = difference(true, estimated)
        return {**entry, "position_error_m": distance, "angle_error_rad": angle}
