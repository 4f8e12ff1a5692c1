"""What a station strategy is given, and what it gives back."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import MarkersUnseenError
from skinplan.mesh.model import SurfaceMesh
from skinplan.part.model import ScanSettings
from skinplan.robot.cell import CellConfig
from skinplan.robot.records import ReachTable
from skinplan.scan_path.model import ScanPath
from skinplan.stations.candidate_map import CandidateMap
from skinplan.stations.marker_view import MarkerView
from skinplan.stations.standing import Standing, standing
from skinplan.transforms import Array

Progress = Callable[[float, str], None]


@dataclass(frozen=True, eq=False)
class StationProblem:
    """What stations are wanted for.

    Attributes:
        path: The scan path, workpiece frame.
        T_map_workpiece: Part in the shop, shape (4, 4) [m].
        mesh: The part, workpiece frame.
        settings: Scan settings.
        cell: The cell.
        tell: Told the share done and what is being done.
        is_cancelled: Asked now and then; None = never.
        markers: What the camera is to see of the part from each station; None = nothing.
    """

    path: ScanPath
    T_map_workpiece: Array
    mesh: SurfaceMesh
    settings: ScanSettings
    cell: CellConfig
    tell: Progress = field(default=lambda share, text: None)
    is_cancelled: Callable[[], bool] | None = None
    markers: MarkerView | None = None

    @property
    def marker_quality(self) -> float:
        """E that is asked of each station [1]; NaN = none is."""
        return float("nan") if self.markers is None else self.markers.required(self.cell)

    def standing(self, poses: Array) -> Standing:
        """Tells where the base can stand, of poses ``T_map_base_link``, shape (c, 4, 4) [m]."""
        return standing(self.cell, self.mesh, self.T_map_workpiece, poses, self.markers)

    def unseen(self, poses: Array) -> MarkersUnseenError:
        """Returns the error of markers that are seen from none of some poses, (c, 4, 4) [m]."""
        assert self.markers is not None
        return self.markers.unseen(self.cell, self.T_map_workpiece, poses)

    @property
    def views(self) -> tuple[Array, Array, Array]:
        """Scanner origins, view directions and targets, workpiece frame, each (n, 3) [m]."""
        return self.path.positions, self.path.directions, self.path.targets


@dataclass(frozen=True, eq=False)
class StationReach:
    """What proposed stations really reach.

    Attributes:
        reached: Which station reaches which point from where it should stand, shape (k, n).
        robust: ... from all places where the base may come to stand, shape (k, n); None = not
            asked.
        table: The records, one row for each station; None = not kept.
        reasons: Why a point is not reached, for points that no station reaches.
    """

    reached: NDArray[np.bool_]
    robust: NDArray[np.bool_] | None
    table: ReachTable | None
    reasons: dict[int, str]


@dataclass(frozen=True, eq=False)
class Proposal:
    """Base poses proposed by a strategy.

    Attributes:
        poses: ``T_map_base_link`` in the order of visit, each of shape (4, 4) [m].
        along: Unit direction on the floor along which stations follow one another, shape (2,), map
            frame.
        candidates: Number of candidates.
        lower_bound: Proven least number of stations over the candidates.
        proven_optimal: No smaller set of candidates covers as much.
        uncovered: Points that no candidate covers, shape (u,).
        reach: What the poses really reach; None = the strategy does not know.
        candidates_seen: The candidates, for pictures; None = not kept.
        left_out: Candidates left out only for what the camera sees there, shape (b, 4, 4) [m].
    """

    poses: tuple[Array, ...]
    along: Array
    candidates: int
    lower_bound: int
    proven_optimal: bool
    uncovered: NDArray[np.int64]
    reach: StationReach | None = None
    candidates_seen: CandidateMap | None = None
    left_out: Array = field(default_factory=lambda: np.zeros((0, 4, 4)))
