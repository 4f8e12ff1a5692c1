"""Is the arm clear of itself, the base, the floor, the cell and the part?

The arm is a set of capsules (its URDF's cylinders), the scanner a sphere, the base a box with a
pedestal under the arm, the floor a half space, the cell's obstacles boxes, the part its raw mesh.
Everything keeps `CellConfig.collision_margin_m`, but for the arm's links among each other, whose
capsules only must not meet; neighbouring links and the pairs that the arm's SRDF leaves out are not
compared.

A skin is thin, so two things keep the arm from slipping through it. Motions are checked at
configurations between which no body moves more than twice the margin, so that it can't jump across;
and the fixture, a box behind the part (its bounding box's outline, from its lowest point
`FIXTURE_DEPTH_M` down along -z of the workpiece), is forbidden too: the space behind the part is
not free even when the arm would get there around the edge.
"""

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import InputError
from skinplan.mesh.model import SurfaceMesh
from skinplan.robot.arm import ArmModel
from skinplan.robot.bodies import Bodies
from skinplan.robot.cell import CellConfig
from skinplan.robot.cell_check import PEDESTAL_RADIUS_M, CellCheck, SelfCheck
from skinplan.robot.part_check import FIXTURE_DEPTH_M, PartCheck
from skinplan.robot.shapes import box_distances
from skinplan.transforms import Array, apply, inverse, require_transform

__all__ = ["FIXTURE_DEPTH_M", "CollisionWorld"]
_CHUNK = 2048
_COARSE = 8

Codes = NDArray[np.int64]


class CollisionWorld:
    """The arm at one place, with the part beside it.

    Attributes:
        arm: The arm.
        bodies: Its capsules and the scanner.
        names: Names of the pairs; number 0 is none. Codes are numbers of these.
        step_m: How far a body may move between two checked configurations of a motion [m].
    """

    def __init__(
        self,
        cell: CellConfig,
        mesh: SurfaceMesh | None,
        T_arm_base_workpiece: Array | None = None,
        T_arm_base_map: Array | None = None,
    ) -> None:
        """Places arm, base and part.

        Args:
            cell: The cell.
            mesh: The part, in the workpiece frame; None = no part.
            T_arm_base_workpiece: Part in the arm base, shape (4, 4) [m]; needed with a part.
            T_arm_base_map: Shop in the arm base, shape (4, 4) [m]; None = the cell's obstacles are
                left out.
        """
        self.arm = ArmModel.load(cell)
        self.bodies = Bodies(self.arm, cell)
        self._margin = cell.collision_margin_m
        self.step_m = 1.5 * max(self._margin, 0.005)
        self._cell_check = CellCheck(self.bodies, cell, T_arm_base_map)
        self._self_check = SelfCheck(self.arm, self.bodies, self._margin)
        self._part_check: PartCheck | None = None
        self._mesh = mesh
        if mesh is not None:
            if T_arm_base_workpiece is None:
                raise InputError("a part without T_arm_base_workpiece: its place is needed too")
            self._T_arm_part = require_transform(T_arm_base_workpiece, "T_arm_base_workpiece")
            self._T_part_arm = inverse(self._T_arm_part)
            self._part_check = PartCheck(self.bodies, mesh, self._margin)
        self._T_base_arm = cell.T_base_link_arm_base
        self.names = ["free", *self._cell_check.names, *self._self_check.names]
        self.names += self._part_check.names if self._part_check else []

    @property
    def exact_checks(self) -> int:
        """How many body-mesh pairs the distance field could not decide so far."""
        return self._part_check.exact_checks if self._part_check else 0

    def free(self, q: Array) -> NDArray[np.bool_]:
        """Tells which joint positions, shape (n, 6) [rad], are free of collision, shape (n,)."""
        return self.codes(q) == 0

    def pair(self, q: Array) -> str | None:
        """Names the first colliding pair at joint positions, shape (6,) [rad]; None when free."""
        return self.pairs(np.atleast_2d(q))[0]

    def pairs(self, q: Array) -> list[str | None]:
        """Names the first colliding pair at each of the joint positions, shape (n, 6) [rad]."""
        return [self.names[code] if code else None for code in self.codes(q)]

    def codes(
        self, q: Array, T_part_arm: Array | None = None, T_map_arm: Array | None = None
    ) -> Codes:
        """Returns the number of the first colliding pair in `names`; 0 = free, shape (n,).

        Args:
            q: Joint positions, shape (n, 6) [rad].
            T_part_arm: Where the arm stands beside the part for each of them, shape (n, 4, 4) [m];
                None = where this world has it.
            T_map_arm: The same in the shop, for its obstacles.
        """
        q = self.arm.require_joints(q)
        parts = []
        for start in range(0, len(q), _CHUNK):
            chunk = slice(start, start + _CHUNK)
            parts.append(
                self.segment_codes(
                    self.bodies.segments(q[chunk]),
                    None if T_part_arm is None else T_part_arm[chunk],
                    None if T_map_arm is None else T_map_arm[chunk],
                )
            )
        return np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)

    def base_problem(self) -> str | None:
        """Names what base or pedestal stands in, judged at the mesh's vertices; None when free."""
        if self._mesh is None:
            return None
        corners = apply(self._T_base_arm @ self._T_arm_part, self._mesh.vertices)
        low, high = self._cell_check.base_low, self._cell_check.base_high
        if box_distances(corners, low, high).min() < self._margin:
            return "base with part"
        side = np.array([PEDESTAL_RADIUS_M, PEDESTAL_RADIUS_M, 0.0])
        foot, top = self._cell_check.pedestal
        high = top + side + [0.0, 0.0, PEDESTAL_RADIUS_M]
        clear = box_distances(corners, foot - side, high).min() >= self._margin
        return None if clear else "pedestal with part"

    def free_motion(self, q_from: Array, q_to: Array) -> bool:
        """Tells whether straight joint-space motion between positions, (6,) [rad], is free."""
        q = self.between(q_from, q_to)
        coarse = np.zeros(len(q), dtype=bool)
        coarse[::_COARSE] = True  # most motions that are not free show it here
        return bool(np.all(self.free(q[coarse])) and np.all(self.free(q[~coarse])))

    def between(self, q_from: Array, q_to: Array) -> Array:
        """Returns joint positions on a straight joint-space motion, with ends, (n, 6) [rad].

        No body moves more than one and a half margins from one to the next: between two free ones
        nothing can touch, because each point of a body is then always nearer than the margin to
        where it is checked.
        """
        way = float(np.abs(q_to - q_from) @ self.arm.lever_arms())
        count = max(1, int(np.ceil(way / self.step_m)))
        return np.asarray(q_from + np.linspace(0.0, 1.0, count + 1)[:, None] * (q_to - q_from))

    def dense(self, q: Array) -> tuple[Array, NDArray[np.int64]]:
        """Adds joint positions on the straight joint motions between neighbours, as `between` does.

        Args:
            q: Joint positions on a path, shape (k >= 1, 6) [rad].

        Returns:
            Joint positions, the given ones among them, shape (n, 6) [rad], and the step of the path
            that each lies on, shape (n,).
        """
        way = np.abs(np.diff(q, axis=0)) @ self.arm.lever_arms()
        count = np.maximum(np.ceil(way / self.step_m), 1).astype(np.int64)
        owner = np.repeat(np.arange(len(count)), count)
        share = (np.arange(len(owner)) - (np.cumsum(count) - count)[owner]) / count[owner]
        between = q[owner] + share[:, None] * (q[owner + 1] - q[owner])
        return np.vstack([between, q[-1:]]), np.append(owner, max(len(q) - 2, 0))

    def segment_codes(
        self, segments: Array, T_part_arm: Array | None, T_map_arm: Array | None
    ) -> Codes:
        """Returns `codes` of bodies that have been placed, axes (n, b, 2, 3) [m]; a few 1000."""
        codes = np.asarray(self._cell_check.hits(segments, T_map_arm), dtype=np.int64)
        first = 1 + len(self._cell_check.names)
        still = np.flatnonzero(codes == 0)
        codes[still] = _numbered(self._self_check.hits(segments[still]), first)
        if self._part_check is not None:
            first += len(self._self_check.names)
            still = np.flatnonzero(codes == 0)
            place = self._T_part_arm if T_part_arm is None else T_part_arm[still]
            codes[still] = _numbered(self._part_check.hits(segments[still], place), first)
        return codes


def _numbered(hits: Codes, first: int) -> Codes:
    return np.where(hits > 0, hits + (first - 1), 0)
