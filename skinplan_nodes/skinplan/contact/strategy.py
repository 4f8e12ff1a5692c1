"""Station strategy ``axial_radial``: the algorithm of C 3.1 for scan paths and any arm.

The axis is the direction along which the path extends most on the floor, radial is away from what
the scanner looks at. Counted is what the arm truly reaches from a place where base and arm at home
are free. The condition of overlap is dropped: as printed, one station would never do. The radial
step is half the paper's, for an arm of about half the length; of equal counts the middle step is
taken, away from both ends of the reach.
"""

import numpy as np
from numpy.typing import NDArray

from skinplan.contact.axial_radial import plan_axial_radial
from skinplan.contact.settings import AxialRadialSettings
from skinplan.errors import CancelledError, NothingReachedError, ScanPathInvalidError
from skinplan.stations.problem import Proposal, StationProblem
from skinplan.stations.reach_strategy import engine_for
from skinplan.transforms import Array, apply, inverse, planar, require_transform, rotate

SETTINGS = AxialRadialSettings(
    step_m=0.1, k_max=10, stations_max=6, overlap_required=False, middle_of_ties=True
)
_LEVEL = 0.2  # least horizontal share of the mean view direction


def axial_radial(problem: StationProblem, figures: AxialRadialSettings = SETTINGS) -> Proposal:
    """Proposes stations.

    Args:
        problem: Path, part and cell.
        figures: Figures of the algorithm.

    Returns:
        Stations along the axis; no bound is known, and the true reach is not.

    Raises:
        ScanPathInvalidError: A path without points.
        InspectionPointsError: Points that are not finite or not in metres.
        NothingReachedError: No point is reached from anywhere.
        MarkersUnseenError: Nor can the part be located from all of the places.
    """
    if not len(problem.path):
        raise ScanPathInvalidError(
            "stations were asked for a scan path without points; at least one point is accepted"
        )
    reach = _PathReach(problem)
    try:
        plan = plan_axial_radial(reach.points, reach.at, figures)
    except NothingReachedError as error:
        if reach.left_out:
            raise problem.unseen(np.array(reach.left_out)) from error
        raise
    return Proposal(
        poses=tuple(reach.base_pose(station.x_m, station.y_m) for station in plan.stations),
        along=reach.T_map_axial[:2, 1],
        candidates=figures.k_max * sum(count for count, _, _ in plan.history),
        lower_bound=0,
        proven_optimal=False,
        uncovered=np.flatnonzero(~plan.covered).astype(np.int64),
        left_out=np.array(reach.left_out).reshape(-1, 4, 4),
    )


def axial_directions(positions: Array, directions: Array) -> Array:
    """Returns the axial frame's axes on the floor: radial, axis; the columns of (2, 2).

    Args:
        positions: Scan positions on the floor, map frame, shape (n, 2) [m].
        directions: Unit view directions, map frame, shape (n, 3).

    Returns:
        A rotation of the plane: x is radial (away from the part), y the axis.
    """
    spread = positions - positions.mean(axis=0)
    axis = np.linalg.svd(spread, full_matrices=False)[2][0] if len(positions) > 1 else np.zeros(2)
    away = -directions[:, :2].mean(axis=0)
    length = float(np.linalg.norm(away))
    if length > _LEVEL:
        away = away / length
        across = away - (away @ axis) * axis
        # Seen along the axis, or hardly extended at all: the axis is across the view.
        weak = np.linalg.norm(across) < 0.5 or not spread.any()
        radial = away if weak else across / np.linalg.norm(across)
    else:
        axis = axis if spread.any() else np.array([0.0, 1.0])
        radial = np.array([axis[1], -axis[0]])
        radial = radial * np.sign(radial[np.argmax(np.abs(radial))])
    return np.stack([radial, [-radial[1], radial[0]]], axis=1)


class _PathReach:
    """What the arm reaches of a scan path from a place in the axial frame."""

    def __init__(self, problem: StationProblem) -> None:
        T_map_workpiece = require_transform(problem.T_map_workpiece, "T_map_workpiece")
        positions = apply(T_map_workpiece, problem.path.positions)
        directions = rotate(T_map_workpiece, problem.path.directions)
        self.T_map_axial = np.eye(4)
        self.T_map_axial[:2, :2] = axial_directions(positions[:, :2], directions)
        self.points = apply(inverse(self.T_map_axial), positions)
        #: Places left out only for what the camera sees there, (4, 4) [m] each.
        self.left_out: list[Array] = []
        self._problem = problem
        self._engine = engine_for(problem, (1.0,), False)

    def base_pose(self, x: float, y: float) -> Array:
        """``T_map_base_link``, its arm at (x, y) [m] of the axial frame, the part on its left."""
        # Left of the base is -x of the axial frame: its heading is along +y.
        turn = planar(0.0, 0.0, 0.5 * np.pi)
        offset = turn[:2, :2] @ self._problem.cell.T_base_link_arm_base[:2, 3]
        return np.asarray(self.T_map_axial @ planar(x - offset[0], y - offset[1], 0.5 * np.pi))

    def at(self, x: float, y: float) -> NDArray[np.bool_]:
        """Which points the arm reaches, shape (n,)."""
        problem, cell = self._problem, self._problem.cell
        if problem.is_cancelled is not None and problem.is_cancelled():
            raise CancelledError("station planning was cancelled")
        poses = self.base_pose(x, y)[None]
        found = problem.standing(poses)
        self.left_out.extend(poses[found.blind])
        T_map_arm = poses @ cell.T_base_link_arm_base
        T_part_arm = inverse(problem.T_map_workpiece) @ T_map_arm
        home = np.array([cell.home_rad])
        if not found.free[0] or self._engine.world.codes(home, T_part_arm, T_map_arm)[0] > 0:
            return np.zeros(len(self.points), dtype=bool)
        return np.asarray(self._engine.table(poses).reached[0], dtype=bool)
