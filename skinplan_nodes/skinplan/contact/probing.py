"""What the arm measures from one place (C 2.3, step 8): poses of the probe, options, reasons."""

import numpy as np
from numpy.typing import NDArray

from skinplan.contact.probing_arm import LIMITS, NO_SOLUTION, Options, ProbingArm
from skinplan.transforms import Array, apply, inverse, rotate


def probe_poses(
    points: Array, normals: Array, rolls: Array | float, ball_radius_m: float, facing: Array
) -> Array:
    """Builds poses of the ball that touches points: +z along the inward normal.

    Args:
        points: On the surface, shape (n, 3) [m].
        normals: Outward unit normals, shape (n, 3).
        rolls: Turn about the probing direction, shape (n,) or one number [rad].
        ball_radius_m: Radius of the ball [m].
        facing: Direction that +x is as near to as can be at roll 0, shape (3,) or (n, 3): where the
            T-Mac looks to. Where it is parallel to a normal another one is taken.

    Returns:
        ``T_a_probe`` in the frame of the points, shape (n, 4, 4) [m].
    """
    z = -normals
    wanted = np.broadcast_to(np.asarray(facing, dtype=float), z.shape)
    across = wanted - np.einsum("ni,ni->n", wanted, z)[:, None] * z
    spare = np.eye(3)[np.argmin(np.abs(z), axis=1)]
    spare = spare - np.einsum("ni,ni->n", spare, z)[:, None] * z
    weak = np.linalg.norm(across, axis=1) < 1e-6 * np.maximum(np.linalg.norm(wanted, axis=1), 1e-12)
    across = np.where(weak[:, None], spare, across)
    x = across / np.linalg.norm(across, axis=1, keepdims=True)
    y = np.cross(z, x)
    turn = np.broadcast_to(np.asarray(rolls, dtype=float), (len(z),))[:, None]
    result = np.zeros((len(z), 4, 4))
    result[:, :3, 0] = np.cos(turn) * x + np.sin(turn) * y
    result[:, :3, 1] = np.cos(turn) * y - np.sin(turn) * x
    result[:, :3, 2] = z
    result[:, :3, 3] = points + ball_radius_m * normals
    result[:, 3, 3] = 1.0
    return result


class StationReach:
    """Measuring from one place of the arm.

    Attributes:
        arm: Arm and tool.
        T_part_arm: Arm's base in the part, shape (4, 4) [m].
    """

    def __init__(
        self, arm: ProbingArm, T_part_arm: Array, points: Array, normals: Array, facing: Array
    ) -> None:
        """Solves the inverse kinematics.

        Args:
            arm: Arm and tool.
            T_part_arm: Arm's base in the part, shape (4, 4) [m].
            points: In the part, shape (n, 3) [m].
            normals: Outward unit normals, shape (n, 3).
            facing: Where the T-Mac looks to at roll 0, shape (3,).
        """
        self.arm, self.T_part_arm = arm, T_part_arm
        self._count = len(points)
        T_arm_part = inverse(T_part_arm)
        poses = probe_poses(
            apply(T_arm_part, points),
            rotate(T_arm_part, normals),
            0.0,
            arm.settings.tool.ball_radius_m,
            rotate(T_arm_part, np.atleast_2d(facing))[0],
        )
        q, valid, inside = arm.solve(poses)
        self._exists = valid.any(axis=1)
        self._inside: NDArray[np.bool_] = np.asarray(inside.any(axis=1))
        self._row, column = np.nonzero(inside)
        self._q = q[self._row, column]
        self._problem = arm.station_problem(T_part_arm)

    def kinematic(self) -> NDArray[np.bool_]:
        """Points with a solution inside all joint ranges, shape (n,): step (8) as printed."""
        return self._inside

    def reached(self) -> NDArray[np.bool_]:
        """Points with a solution inside the ranges that is free of collision, shape (n,)."""
        result = np.zeros(self._count, dtype=bool)
        if self._problem:
            return result
        row, q = self._arm_free()
        for roll in self._rolls():
            still = ~result[row]
            if not still.any():
                break
            turned = self.arm.rolled(q[still], np.full(int(still.sum()), roll))
            free = self.arm.free(turned, self.T_part_arm, tmac=True)
            result[row[still][free]] = True
        return result

    def options(self) -> Options:
        """All solutions inside the ranges, at all rolls, that are free of collision."""
        row, q = self._arm_free()
        if self._problem or not len(row):
            return Options(np.zeros(0, dtype=np.int64), np.zeros((0, 6)), np.zeros(0))
        rolls = self._rolls()
        numbers = np.repeat(row, len(rolls))
        turned = self.arm.rolled(np.repeat(q, len(rolls), axis=0), np.tile(rolls, len(row)))
        free = self.arm.free(turned, self.T_part_arm, tmac=True)
        return Options(numbers[free], turned[free], np.tile(rolls, len(row))[free])

    def reasons(self) -> list[str]:
        """Why each point is not reached; empty where the arm without T-Mac reaches it."""
        if self._problem:
            return [f"collision of {self._problem}"] * self._count
        reasons = np.where(self._inside, "", np.where(self._exists, LIMITS, NO_SOLUTION)).tolist()
        names = self.arm.problems(self._q, self.T_part_arm, tmac=False)
        free = np.zeros(self._count, dtype=bool)
        free[self._row[[not name for name in names]]] = True
        for row, name in zip(self._row.tolist(), names, strict=True):
            if name and not free[row]:
                reasons[row] = f"collision of {name}"
        for row in np.flatnonzero(free & ~self.reached()).tolist():
            reasons[row] = "collision of T-Mac at every roll"
        return [str(reason) for reason in reasons]

    def _rolls(self) -> Array:
        """Rolls from 0 outward to both sides: the first ones look where they should."""
        count = self.arm.settings.rolls
        steps = np.arange(count)
        order = np.where(steps % 2 == 1, (steps + 1) // 2, -(steps // 2))
        return np.asarray(2.0 * np.pi * order / count)

    def _arm_free(self) -> tuple[NDArray[np.int64], Array]:
        free = self.arm.free(self._q, self.T_part_arm, tmac=False)
        return self._row[free], self._q[free]
