"""What contact measurement plans, as the rooms exchange it.

The **axial frame** (C 3.1): y along the part's axis, x radial toward the stations, z up, z = 0 at
the height of the arm's base. For the sample ``engine`` it is the part's own frame.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.transforms import Array


@dataclass(frozen=True, eq=False)
class ContactStation:
    """A place of the arm.

    Attributes:
        x_m: Arm's base in the axial frame [m].
        y_m: Same, along the axis; S_i_y of step (3) [m].
        start_x_m: S_i_x of eq (5) [m].
        k: Radial steps from there.
        counts: Points reached at k = 1.. K_max, shape (K_max,).
        reached: Points that the arm reaches from here, shape (n,).
        points: Points measured here, in the order of visit, shape (p,).
        T_axial_arm: Arm's base in the axial frame, shape (4, 4) [m].
    """

    x_m: float
    y_m: float
    start_x_m: float
    k: int
    counts: NDArray[np.int64]
    reached: NDArray[np.bool_]
    points: NDArray[np.int64]
    T_axial_arm: Array


@dataclass(frozen=True, eq=False)
class Motion:
    """The dynamic check of one motion: back from a point, over, and down to the next (C 4).

    Attributes:
        station: Number of the station.
        start: Point that it starts at.
        end: Point that it ends at.
        problem: First thing that is wrong along it: a broken beam or a collision; empty = nothing.
        corners: Joint positions to be joined straight in joint space, both points included, shape
            (k, 6) [rad].
    """

    station: int
    start: int
    end: int
    problem: str
    corners: Array


@dataclass(frozen=True, eq=False)
class TrackerStation:
    """A place of the laser tracker and what it sees.

    Attributes:
        position: In the axial frame, shape (3,) [m].
        sees: Points at whose measuring pose it holds the T-Mac (static check), shape (n,).
        emission_rad: Angle of the beam to the horizontal at each pose, shape (n,); NaN unseen.
        incidence_rad: Angle of the beam to the mirror's normal, shape (n,); NaN unseen.
        range_m: Length of the beam, shape (n,); NaN unseen.
    """

    position: Array
    sees: NDArray[np.bool_]
    emission_rad: Array
    incidence_rad: Array
    range_m: Array


@dataclass(frozen=True)
class MissedPoint:
    """A point that is not measured.

    Attributes:
        point: Its number.
        reason: Why, at the station nearest to it along the axis.
    """

    point: int
    reason: str


@dataclass(frozen=True, eq=False)
class ContactPlan:
    """Stations, tracker and a pose for every point.

    Attributes:
        T_map_axial: Axial frame in the shop, shape (4, 4) [m].
        stations: In rising y.
        complete: Step (9) holds: overlap, and every point covered.
        reached_sum: N_sum, sum over the stations of the points reached.
        history: (S_num, N_sum, points covered) of every S_num tried.
        tracker: The tracker's place; None when none sees all points.
        station_of: Station of each point, -1 = not measured, shape (n,).
        q: Joint positions at each point, shape (n, 6) [rad]; NaN where not measured.
        T_axial_probe: Ball of the probe, shape (n, 4, 4) [m]; NaN where not measured.
        T_axial_flange: Flange, eq (3), likewise.
        T_axial_mirror: Mirror of the T-Mac, eq (4), likewise.
        motions: Dynamic check of every motion between points of one station.
        missed: Points not measured, with reasons.
    """

    T_map_axial: Array
    stations: tuple[ContactStation, ...]
    complete: bool
    reached_sum: int
    history: tuple[tuple[int, int, int], ...]
    tracker: TrackerStation | None
    station_of: NDArray[np.int64]
    q: Array
    T_axial_probe: Array
    T_axial_flange: Array
    T_axial_mirror: Array
    motions: tuple[Motion, ...]
    missed: tuple[MissedPoint, ...]

    @property
    def covered(self) -> NDArray[np.bool_]:
        """Points that some station reaches, shape (n,)."""
        return np.any([station.reached for station in self.stations], axis=0)
