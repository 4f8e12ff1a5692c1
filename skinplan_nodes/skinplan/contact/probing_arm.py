"""The arm with probe and T-Mac at one place: frames (3) and (4), all branches, collisions.

Bodies are the arm's capsules and those of probe, stylus and T-Mac. They keep `margin_m` from the
part, the floor, the vehicle below the arm and, as far as the tool is concerned, from the arm; links
of the arm only must not meet each other. The stylus may come as near to the part as a measurement
needs: its last 10 mm are left out.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skinplan.contact.part_clearance import PartClearance
from skinplan.contact.settings import ContactSettings
from skinplan.mesh.model import SurfaceMesh
from skinplan.robot.arm import ArmModel, Body
from skinplan.robot.cell import CellConfig
from skinplan.robot.dh import Capsule
from skinplan.robot.shapes import box_distances, segment_box_distances, segment_distances
from skinplan.transforms import Array, apply, inverse

NO_SOLUTION = "out of the arm's reach: no inverse kinematics"
LIMITS = "joint limits"
_TOOL_LINK = 7
_CHUNK = 4096


@dataclass(frozen=True, eq=False)
class Options:
    """Joint positions that bring the probe to points, any number for each.

    Attributes:
        point: Number of the point, rising, shape (m,).
        q: Joint positions within limits, free of collision, shape (m, 6) [rad].
        rolls: Turn about the probe, shape (m,) [rad].
    """

    point: NDArray[np.int64]
    q: Array
    rolls: Array


class ProbingArm:
    """Arm, probe, T-Mac and vehicle, with the part as obstacle.

    Attributes:
        arm: The arm.
        settings: What it was made from.
        bodies: All capsules, those of probe, stylus and T-Mac last.
    """

    def __init__(self, settings: ContactSettings, mesh: SurfaceMesh | None) -> None:
        """Prepares the shapes.

        Args:
            settings: The cell.
            mesh: The part, in its own frame; None = nothing to collide with.
        """
        self.settings = settings
        self.arm = ArmModel.load(replace(CellConfig(), robot=settings.robot))
        zero = self.arm.links(np.zeros((1, 6)))[0, 6]
        self.T_6_tool0 = inverse(zero) @ self.arm.forward(np.zeros((1, 6)))[0]
        tool = [_on_flange(n, c, self.T_6_tool0) for n, c in settings.tool.bodies.items()]
        self.bodies: tuple[Body, ...] = (*self.arm.bodies, *tool)
        self.T_tool0_mirror = settings.tool.T_tool0_probe @ inverse(settings.tool.T_mirror_probe)
        self._mesh = mesh
        self._part = PartClearance(mesh, self.bodies, settings.margin_m) if mesh else None
        self._joints = np.array([body.joint for body in self.bodies])
        self._ends = np.array([body.ends for body in self.bodies])
        self._radii = np.array([body.radius for body in self.bodies])
        self._order = np.append(self._joints[: len(self.arm.bodies)], [_TOOL_LINK] * len(tool))
        self._tmac = np.array([len(self.bodies) - 1])
        self._rest = np.arange(len(self.bodies) - 1)

    def flange_poses(self, T_a_probe: Array) -> Array:
        """Eq (3): flange poses of probe poses, (n, 4, 4) [m], in the same frame."""
        return np.asarray(T_a_probe @ inverse(self.settings.tool.T_tool0_probe))

    def mirror_poses(self, T_a_probe: Array) -> Array:
        """Eq (4): mirror poses of probe poses, (n, 4, 4) [m]; +x out of the mirror."""
        return np.asarray(T_a_probe @ inverse(self.settings.tool.T_mirror_probe))

    def forward_mirror(self, q: Array) -> Array:
        """Returns ``T_arm_base_mirror``, (n, 4, 4) [m], of joint positions, (n, 6) [rad]."""
        return np.asarray(self.arm.forward(q) @ self.T_tool0_mirror)

    def solve(self, T_arm_probe: Array) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
        """All branches of probe poses.

        Args:
            T_arm_probe: Probe poses in the arm's base, shape (n, 4, 4) [m].

        Returns:
            Joint positions, wound into their ranges where that is possible, shape (n, 8, 6) [rad];
            which are solutions; and which of them are within the ranges, both shape (n, 8).
        """
        branches, valid = self.arm.inverse(self.flange_poses(T_arm_probe))
        branches = self.wound(branches)
        return branches, valid, valid & self.arm.within_limits(branches)

    def wound(self, q: Array) -> Array:
        """Adds full turns so that joint positions, (..., 6) [rad], are in range if they can be."""
        down = np.ceil((q - self.arm.upper - 1e-9) / (2.0 * np.pi))
        q = q - 2.0 * np.pi * np.maximum(down, 0.0)
        up = np.ceil((self.arm.lower - 1e-9 - q) / (2.0 * np.pi))
        return np.asarray(q + 2.0 * np.pi * np.maximum(up, 0.0))

    def rolled(self, q: Array, rolls: Array) -> Array:
        """Turns joint positions, (n, 6) [rad], about the probe: it is on the last joint's axis."""
        turned = q.copy()
        turned[:, 5] += rolls
        return self.wound(turned)

    def station_problem(self, T_part_arm: Array) -> str:
        """Says what the vehicle stands in, judged at the part's vertices; empty when free.

        Args:
            T_part_arm: Arm's base in the part, shape (4, 4) [m].
        """
        if self._mesh is None:
            return ""
        low, high = self.vehicle()
        corners = apply(inverse(T_part_arm), self._mesh.vertices)
        near = box_distances(corners, low, high).min() < self.settings.margin_m
        return "vehicle with part" if near else ""

    def problems(self, q: Array, T_part_arm: Array, tmac: bool | None = None) -> list[str]:
        """Names the first colliding pair of each configuration; empty when it is free.

        Args:
            q: Joint positions, shape (n, 6) [rad].
            T_part_arm: Arm's base in the part, shape (4, 4) [m].
            tmac: True = only the T-Mac against all, False = all but the T-Mac, None = all.
        """
        q = self.arm.require_joints(q)
        result: list[str] = []
        for start in range(0, len(q), _CHUNK):
            segments = self._segments(q[start : start + _CHUNK])
            names = [""] * len(segments)
            for check in (self._near_cell, self._near_self, self._near_part):
                open_rows = np.flatnonzero([not name for name in names])
                if len(open_rows):
                    found = check(segments[open_rows], T_part_arm, tmac)
                    for row, name in zip(open_rows, found, strict=True):
                        names[row] = name
            result += names
        return result

    def free(self, q: Array, T_part_arm: Array, tmac: bool | None = None) -> NDArray[np.bool_]:
        """Tells which configurations are free of collision, shape (n,); as `problems`."""
        return np.array([not name for name in self.problems(q, T_part_arm, tmac)], dtype=bool)

    def segments(self, q: Array, T_a_arm: Array) -> Array:
        """Axes of all bodies in frame a, shape (n, b, 2, 3) [m]."""
        return np.asarray(self._segments(q) @ T_a_arm[:3, :3].T + T_a_arm[:3, 3])

    @property
    def radii(self) -> Array:
        """Radii of all bodies, shape (b,) [m]."""
        return self._radii

    def _segments(self, q: Array) -> Array:
        frames = self.arm.links(q)[:, self._joints]
        turned = frames[..., :3, :3] @ np.swapaxes(self._ends, 1, 2)
        return np.asarray(np.swapaxes(turned, 2, 3) + frames[:, :, None, :3, 3])

    def _numbers(self, tmac: bool | None) -> NDArray[np.int64]:
        if tmac is None:
            return np.arange(len(self.bodies))
        return self._tmac if tmac else self._rest

    def vehicle(self) -> tuple[Array, Array]:
        """Lower and upper corner of the vehicle's box in the arm's base, both (3,) [m]."""
        length, width = self.settings.base_size_m
        low = np.array([-0.5 * length, -0.5 * width, -self.settings.base_height_m])
        return low, np.array([0.5 * length, 0.5 * width, 0.0])

    def _near_cell(self, segments: Array, _: Array, tmac: bool | None) -> list[str]:
        numbers = self._numbers(tmac)
        numbers = numbers[self._joints[numbers] >= 2]
        keep = self._radii[numbers] + self.settings.margin_m
        picked = segments[:, numbers]
        floor = picked[..., 2].min(axis=2) + self.settings.base_height_m < keep
        low, high = self.vehicle()
        gaps = segment_box_distances(picked.reshape(-1, 2, 3), low, high).reshape(floor.shape)
        names = [self.bodies[k].link for k in numbers]
        return _first(
            np.concatenate([floor, gaps < keep], axis=1),
            [f"{name} with floor" for name in names] + [f"{name} with vehicle" for name in names],
        )

    def _near_self(self, segments: Array, _: Array, tmac: bool | None) -> list[str]:
        first, second = self._pairs(tmac)
        a = segments[:, first].reshape(-1, 2, 3)
        b = segments[:, second].reshape(-1, 2, 3)
        gaps = segment_distances(a, b).reshape(len(segments), len(first))
        tool = self._order[second] == _TOOL_LINK
        keep = self._radii[first] + self._radii[second] + tool * self.settings.margin_m
        names = [
            f"{self.bodies[i].link} with {self.bodies[j].link}"
            for i, j in zip(first, second, strict=True)
        ]
        return _first(gaps < keep, names)

    def _pairs(self, tmac: bool | None) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        first, second = np.triu_indices(len(self.bodies), 1)
        kept = np.abs(self._order[first] - self._order[second]) > 1
        left_out = self.arm.pairs_left_out
        kept &= np.array(
            [
                frozenset((self.bodies[i].link, self.bodies[j].link)) not in left_out
                for i, j in zip(first, second, strict=True)
            ]
        )
        last = second == self._tmac[0]
        if tmac is not None:
            kept &= last if tmac else ~last
        return first[kept], second[kept]

    def _near_part(self, segments: Array, T_part_arm: Array, tmac: bool | None) -> list[str]:
        if self._part is None:
            return [""] * len(segments)
        numbers = self._numbers(tmac)
        in_part = segments[:, numbers] @ T_part_arm[:3, :3].T + T_part_arm[:3, 3]
        return _first(
            self._part.hits(in_part, numbers),
            [f"{self.bodies[k].link} with part" for k in numbers],
        )


def _on_flange(name: str, shape: Capsule, T_6_tool0: Array) -> Body:
    return Body(name, 6, apply(T_6_tool0, np.array([shape.start_m, shape.end_m])), shape.radius_m)


def _first(hits: NDArray[np.bool_], names: list[str]) -> list[str]:
    number = np.argmax(hits, axis=1).tolist()
    found = np.any(hits, axis=1).tolist()
    return [names[k] if hit else "" for k, hit in zip(number, found, strict=True)]
