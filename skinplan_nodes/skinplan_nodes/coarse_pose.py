"""Where the part stands in the tracker frame, coarsely: the start of the alignment.

Needs no ROS.
"""

import numpy as np

from skinplan.transforms import Array, transform

_FEWEST_PER_STAND = 3
_MOST_PER_STAND = 400


class CoarsePose:
    """Where the part stands in the tracker frame, by the arm: good to some millimetres.

    Each stand of the base gives ``T_tracker_scanner(t) @ T_scanner_arm_base(q(t)) @
    T_arm_base_workpiece`` for many times t; the median over them, and over the stands, is not moved
    by a few bad ones.
    """

    def __init__(self) -> None:
        self._stands: dict[float, list[Array]] = {}
        self._estimate: Array | None = None

    def add(self, stand: float, T_tracker_workpiece: Array) -> bool:
        """Takes an estimate in.

        Args:
            stand: What tells the stand from others: the time of its localisation.
            T_tracker_workpiece: shape (4, 4) [m].

        Returns:
            False when there are enough of that stand.
        """
        found = self._stands.setdefault(stand, [])
        if len(found) >= _MOST_PER_STAND:
            return False
        found.append(T_tracker_workpiece)
        self._estimate = None
        return True

    @property
    def count(self) -> int:
        """Number of estimates taken in."""
        return sum(len(poses) for poses in self._stands.values())

    def estimate(self) -> Array | None:
        """Returns ``T_tracker_workpiece``, shape (4, 4) [m]; None = not known yet."""
        if self._estimate is None:
            enough = [poses for poses in self._stands.values() if len(poses) >= _FEWEST_PER_STAND]
            self._estimate = _median([_median(poses) for poses in enough]) if enough else None
        return self._estimate


def _median(poses: list[Array]) -> Array:
    """Returns the median place and the mean turn (the nearest rotation to the mean matrix)."""
    stacked = np.array(poses)
    u, _, vt = np.linalg.svd(np.median(stacked[:, :3, :3], axis=0))
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return transform(np.median(stacked[:, :3, 3], axis=0), turn)
