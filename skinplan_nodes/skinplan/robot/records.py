"""Reach records: what is known of every pair of a station and a point."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skinplan.transforms import Array

REACHED = 0
NO_IK = 1
SINGULAR = 2
LIMITS = 3
FIRST_PAIR = 4  # codes from here on: collision pairs, then what hides the scanner

_TEXTS = {
    NO_IK: "out of the arm's reach: no inverse kinematics",
    LIMITS: "joint limits",
    SINGULAR: "too close to a singular position of elbow or wrist",
}


@dataclass(frozen=True, eq=False)
class ReachRecord:
    """One station and one point.

    Attributes:
        reached: The arm brings the scanner there, free of collision and seen by the tracker.
        reason: Why not; empty when reached.
        q: Best joint positions, shape (6,) [rad]; None when not reached.
        tilt_rad: Tilt about the target that was used [rad].
        roll_rad: Roll about the view axis, counted from the reference direction [rad]; NaN = free.
        limit_margin_rad: Smallest distance to a joint limit [rad].
        singularity: Smaller of the elbow's and the wrist's measure, 0 = singular, 1 = farthest.
        collision: The colliding pair; None when there is none.
        visible: The tracker sees the scanner; None when it was not asked.
    """

    reached: bool
    reason: str
    q: Array | None
    tilt_rad: float
    roll_rad: float
    limit_margin_rad: float
    singularity: float
    collision: str | None
    visible: bool | None


@dataclass(frozen=True, eq=False)
class ReachTable:
    """Records of all pairs of s stations and n points, as arrays.

    Attributes:
        codes: Why a point is not reached (`reason`); 0 = reached, shape (s, n).
        options: Number of the option of the view that was used; -1 = none, shape (s, n).
        singularity: The measure of the best branch, NaN where not reached, shape (s, n).
        limit_margin: Smallest distance to a joint limit, NaN where not reached, (s, n) [rad].
        q: Best branch, NaN where not reached, shape (s, n, 6) [rad]; None = not kept.
        tilts: Tilt of each option, shape (o,) [rad].
        rolls: Roll of each option, NaN = free, shape (o,) [rad].
        pairs: Names of the collision pairs.
        sights: Names of what keeps the tracker from seeing the scanner; None = it was not asked.
    """

    codes: NDArray[np.int16]
    options: NDArray[np.int16]
    singularity: NDArray[np.float32]
    limit_margin: NDArray[np.float32]
    q: Array | None
    tilts: Array
    rolls: Array
    pairs: tuple[str, ...]
    sights: tuple[str, ...] | None

    @property
    def reached(self) -> NDArray[np.bool_]:
        """Which station reaches which point, shape (s, n)."""
        return self.codes == REACHED

    @property
    def nearness(self) -> NDArray[np.int8]:
        """How near each pair is to success, from 0 (no inverse kinematics) to 5 (reached)."""
        result = np.full(self.codes.shape, 3, dtype=np.int8)  # a collision
        result[self.codes >= FIRST_PAIR + len(self.pairs)] = 4  # all but seen
        for code, rank in ((REACHED, 5), (NO_IK, 0), (SINGULAR, 1), (LIMITS, 2)):
            result[self.codes == code] = rank
        return result

    def rows(self, stations: list[int]) -> "ReachTable":
        """Returns the records of some of the stations."""
        return replace(
            self,
            codes=self.codes[stations],
            options=self.options[stations],
            singularity=self.singularity[stations],
            limit_margin=self.limit_margin[stations],
            q=None if self.q is None else self.q[stations],
        )

    def reason(self, code: int) -> str:
        """Returns a code in words; empty for `REACHED`."""
        if code == REACHED:
            return ""
        if code < FIRST_PAIR:
            return _TEXTS[code]
        number = code - FIRST_PAIR
        if number < len(self.pairs):
            return f"collision of {self.pairs[number]}"
        return (self.sights or ())[number - len(self.pairs)]

    def record(self, station: int, point: int) -> ReachRecord:
        """Returns the record of one pair."""
        code, option = int(self.codes[station, point]), int(self.options[station, point])
        collides = FIRST_PAIR <= code < FIRST_PAIR + len(self.pairs)
        asked = self.sights is not None and (code == REACHED or code >= FIRST_PAIR and not collides)
        return ReachRecord(
            code == REACHED,
            self.reason(code),
            None if self.q is None or code != REACHED else self.q[station, point],
            float(self.tilts[option]) if option >= 0 else float("nan"),
            float(self.rolls[option]) if option >= 0 else float("nan"),
            float(self.limit_margin[station, point]),
            float(self.singularity[station, point]),
            self.pairs[code - FIRST_PAIR] if collides else None,
            code == REACHED if asked else None,
        )
