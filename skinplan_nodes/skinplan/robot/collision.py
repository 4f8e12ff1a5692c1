"""Is the arm clear of itself, the base, the floor and the part?

The arm is a set of capsules (its URDF's cylinders), the scanner a sphere, the base a box with a
pedestal under the arm, the floor a half space, the part its raw mesh. Everything keeps
`CellConfig.collision_margin_m`, but for the arm's links among each other, whose capsules only must
not meet; neighbouring links and the pairs that the arm's SRDF leaves out are not compared.

A skin is thin, so two things keep the arm from slipping through it. Motions are checked at
configurations between which no body moves more than twice the margin, so that it can't jump across;
and the fixture, a box behind the part (its bounding box's outline, from its lowest point
`FIXTURE_DEPTH_M` down along -z of the workpiece), is forbidden too: the space behind the part is
not free even when the arm would get there around the edge.
"""

from collections.abc import Callable, Iterable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import InputError
from skinplan.mesh.model import SurfaceMesh
from skinplan.robot.arm import ArmModel, Body
from skinplan.robot.cell import CellConfig
from skinplan.robot.distance_field import distance_field
from skinplan.robot.exact import touches
from skinplan.robot.shapes import box_distances, segment_box_distances, segment_distances
from skinplan.transforms import Array, apply, inverse, require_transform

FIXTURE_DEPTH_M = 0.40
PEDESTAL_RADIUS_M = 0.08
_CHUNK = 2048
_SAMPLE_M = 0.05  # spacing of the points on capsule axes at which the distance field is read
_SCANNER_LINK = 7
_COARSE = 8

Codes = NDArray[np.int64]


class CollisionWorld:
    """The arm at one place, with the part beside it.

    Attributes:
        arm: The arm.
        step_m: How far a body may move between two checked configurations of a motion [m].
        exact_checks: How many body-mesh pairs the distance field could not decide so far.
    """

    def __init__(
        self, cell: CellConfig, mesh: SurfaceMesh | None, T_arm_base_workpiece: Array | None = None
    ) -> None:
        """Places arm, base and part.

        Args:
            cell: The cell.
            mesh: The part, in the workpiece frame; None = no part.
            T_arm_base_workpiece: Part in the arm base, shape (4, 4) [m]; needed with a part.
        """
        self.arm = ArmModel.load(cell)
        self.exact_checks = 0
        self._margin = cell.collision_margin_m
        self.step_m = 1.5 * max(self._margin, 0.005)
        self._names: list[str] = ["free"]
        self._place_bodies(cell)
        self._place_base(cell)
        self._mesh = mesh
        if mesh is not None:
            if T_arm_base_workpiece is None:
                raise InputError("a part without T_arm_base_workpiece: its place is needed too")
            self._T_part_arm = inverse(
                require_transform(T_arm_base_workpiece, "T_arm_base_workpiece")
            )
            self._T_arm_part = inverse(self._T_part_arm)
            self._place_part(mesh)

    def free(self, q: Array) -> NDArray[np.bool_]:
        """Tells which joint positions, shape (n, 6) [rad], are free of collision, shape (n,)."""
        return self._codes(self.arm.require_joints(q)) == 0

    def pair(self, q: Array) -> str | None:
        """Names the first colliding pair at joint positions, shape (6,) [rad]; None when free."""
        code = int(self._codes(self.arm.require_joints(np.atleast_2d(q)))[0])
        return self._names[code] if code else None

    def pairs(self, q: Array) -> list[str | None]:
        """Names the first colliding pair at each of the joint positions, shape (n, 6) [rad]."""
        return [
            self._names[code] if code else None for code in self._codes(self.arm.require_joints(q))
        ]

    def base_problem(self) -> str | None:
        """Names what base or pedestal stands in, judged at the mesh's vertices; None when free."""
        if self._mesh is None:
            return None
        corners = apply(self._T_base_arm @ self._T_arm_part, self._mesh.vertices)
        if box_distances(corners, self._base_low, self._base_high).min() < self._margin:
            return "base with part"
        top = np.array(
            [self._pedestal[1, 0], self._pedestal[1, 1], self._pedestal[1, 2] + PEDESTAL_RADIUS_M]
        )
        low, high = (
            self._pedestal[0] - [PEDESTAL_RADIUS_M, PEDESTAL_RADIUS_M, 0.0],
            top + [PEDESTAL_RADIUS_M, PEDESTAL_RADIUS_M, 0.0],
        )
        return (
            "pedestal with part" if box_distances(corners, low, high).min() < self._margin else None
        )

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

    def _place_bodies(self, cell: CellConfig) -> None:
        T_6_scanner = (
            inverse(self.arm.links(np.zeros((1, 6)))[0, 6])
            @ self.arm.forward_scanner(np.zeros((1, 6)))[0]
        )
        scanner = Body("scanner", 6, np.tile(T_6_scanner[:3, 3], (2, 1)), cell.scanner_radius_m)
        self._bodies = (*self.arm.bodies, scanner)
        self._joints = np.array([b.joint for b in self._bodies])
        self._ends = np.array([b.ends for b in self._bodies])
        self._radii = np.array([b.radius for b in self._bodies])
        order = np.append(self._joints[:-1], _SCANNER_LINK)
        first, second = np.triu_indices(len(self._bodies), 1)
        left_out = self.arm.pairs_left_out
        kept = [
            abs(order[a] - order[b]) > 1
            and frozenset((self._bodies[a].link, self._bodies[b].link)) not in left_out
            for a, b in zip(first, second, strict=True)
        ]
        self._first, self._second = first[kept], second[kept]
        # The wrist's links pass each other within millimetres by design: among links the capsules
        # are margin enough.
        self._self_margins = np.where(order[self._second] == _SCANNER_LINK, self._margin, 0.0)
        self._self_codes = self._codes_for(
            f"{self._bodies[a].link} with {self._bodies[b].link}"
            for a, b in zip(self._first, self._second, strict=True)
        )
        self._moving = np.flatnonzero(self._joints >= 2)

    def _place_base(self, cell: CellConfig) -> None:
        self._T_base_arm = cell.T_base_link_arm_base
        length, width, height = cell.base_size_m
        self._base_low = np.array([-0.5 * length, -0.5 * width, 0.0])
        self._base_high = np.array([0.5 * length, 0.5 * width, height])
        arm = self._T_base_arm[:3, 3]
        top = max(arm[2] - PEDESTAL_RADIUS_M, height)
        self._pedestal = np.array([[arm[0], arm[1], height], [arm[0], arm[1], top]])
        links = [self._bodies[b].link for b in self._moving]
        self._floor_codes = self._codes_for(f"{name} with floor" for name in links)
        self._base_codes = self._codes_for(f"{name} with base" for name in links)
        self._pedestal_codes = self._codes_for(f"{name} with pedestal" for name in links)

    def _place_part(self, mesh: SurfaceMesh) -> None:
        self._field = distance_field(mesh)
        low, high = mesh.bounds
        self._fixture_low = np.array([low[0], low[1], low[2] - FIXTURE_DEPTH_M])
        self._fixture_high = np.array([high[0], high[1], low[2]])
        links = [body.link for body in self._bodies]
        self._part_codes = self._codes_for(f"{name} with part" for name in links)
        self._fixture_codes = self._codes_for(f"{name} with fixture" for name in links)
        shares, owners, slack = [], [], []
        for number, body in enumerate(self._bodies):
            length = float(np.linalg.norm(body.ends[1] - body.ends[0]))
            count = max(1, int(np.ceil(length / _SAMPLE_M)))
            shares.append((np.arange(count) + 0.5) / count)
            owners.append(np.full(count, number))
            slack.append(0.5 * length / count)
        self._shares, self._owners = np.concatenate(shares), np.concatenate(owners)
        self._starts = np.cumsum([0] + [len(s) for s in shares[:-1]])
        self._slack = np.array(slack)

    def _codes_for(self, names: Iterable[str]) -> Codes:
        first = len(self._names)
        self._names.extend(names)
        return np.arange(first, len(self._names))

    def _segments(self, q: Array) -> Array:
        """Capsule axes in the arm base, shape (n, b, 2, 3) [m]."""
        frames = self.arm.links(q)[:, self._joints]
        return np.asarray(
            np.einsum("nbij,bej->nbei", frames[:, :, :3, :3], self._ends)
            + frames[:, :, None, :3, 3]
        )

    def _codes(self, q: Array) -> Codes:
        parts = [self._codes_of(q[start : start + _CHUNK]) for start in range(0, len(q), _CHUNK)]
        return np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)

    def _codes_of(self, q: Array) -> Codes:
        codes = np.zeros(len(q), dtype=np.int64)
        segments = self._segments(q)
        checks: list[Callable[[Array], Codes]] = [self._check_cell, self._check_self]
        if self._mesh is not None:
            checks += [self._check_fixture, partial(self._check_part, self._mesh)]
        for check in checks:
            still = np.flatnonzero(codes == 0)
            if len(still):
                codes[still] = check(segments[still])
        return codes

    def _check_cell(self, segments: Array) -> Codes:
        shape = (len(segments), len(self._moving))
        in_base = segments[:, self._moving] @ self._T_base_arm[:3, :3].T + self._T_base_arm[:3, 3]
        flat = in_base.reshape(-1, 2, 3)
        radii = self._radii[self._moving] + self._margin
        floor = in_base[:, :, :, 2].min(axis=2) < radii
        base = _near_box(in_base, radii, self._base_low, self._base_high)
        post = np.broadcast_to(self._pedestal, flat.shape)
        pedestal = segment_distances(flat, post).reshape(shape) < radii + PEDESTAL_RADIUS_M
        hits = np.concatenate([floor, base, pedestal], axis=1)
        return _first_code(
            hits, np.concatenate([self._floor_codes, self._base_codes, self._pedestal_codes])
        )

    def _self_gaps(self, segments: Array) -> Array:
        first, second = self._first, self._second
        a, b = segments[:, first].reshape(-1, 2, 3), segments[:, second].reshape(-1, 2, 3)
        distances = segment_distances(a, b).reshape(len(segments), len(first))
        return np.asarray(distances - self._radii[first] - self._radii[second])

    def _check_self(self, segments: Array) -> Codes:
        return _first_code(self._self_gaps(segments) < self._self_margins, self._self_codes)

    def _check_fixture(self, segments: Array) -> Codes:
        in_part = segments @ self._T_part_arm[:3, :3].T + self._T_part_arm[:3, 3]
        hits = _near_box(in_part, self._radii + self._margin, self._fixture_low, self._fixture_high)
        return _first_code(hits, self._fixture_codes)

    def _check_part(self, mesh: SurfaceMesh, segments: Array) -> Codes:
        in_part = segments @ self._T_part_arm[:3, :3].T + self._T_part_arm[:3, 3]
        start, end = in_part[:, self._owners, 0], in_part[:, self._owners, 1]
        points = start + self._shares[:, None] * (end - start)
        distance = self._field.distance(points.reshape(-1, 3)).reshape(points.shape[:2])
        least = np.minimum.reduceat(distance, self._starts, axis=1)
        keep = self._radii + self._margin
        hits = least + self._field.error < keep
        unsure = (least - self._field.error - self._slack < keep) & ~hits
        unsure[hits.any(axis=1)] = False
        for row, body in zip(*np.nonzero(unsure), strict=True):
            if not hits[row].any():
                self.exact_checks += 1
                ends = in_part[row, body]
                hits[row, body] = touches(mesh, self._bodies[body], ends, self._margin)
        return _first_code(hits, self._part_codes)


def _near_box(segments: Array, radii: Array, low: Array, high: Array) -> NDArray[np.bool_]:
    """Tells which capsules, axes (n, b, 2, 3) and radii (b,), reach into a box, shape (n, b)."""
    half = 0.5 * np.linalg.norm(segments[:, :, 1] - segments[:, :, 0], axis=2)
    middle = box_distances(segments.mean(axis=2).reshape(-1, 3), low, high).reshape(half.shape)
    hits = middle < half + radii  # a ball around the whole capsule, first
    row, body = np.nonzero(hits)
    hits[row, body] = segment_box_distances(segments[row, body], low, high) < radii[body]
    return np.asarray(hits)


def _first_code(hits: NDArray[np.bool_], codes: Codes) -> Codes:
    return np.where(hits.any(axis=1), codes[np.argmax(hits, axis=1)], 0)
