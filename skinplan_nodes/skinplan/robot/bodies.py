"""The capsules of arm and scanner, placed by joint positions."""

import numpy as np
from numpy.typing import NDArray

from skinplan.robot.arm import ArmModel, Body
from skinplan.robot.cell import CellConfig
from skinplan.robot.shapes import box_distances, segment_box_distances
from skinplan.transforms import Array, inverse

SCANNER_LINK = 7


class Bodies:
    """All bodies that move with the arm: the capsules of its links, and the scanner's sphere.

    Attributes:
        items: The bodies, the scanner last.
        names: Names of their links.
        order: Place in the chain, 0 = fixed to the arm base, `SCANNER_LINK` = the scanner, shape
            (b,).
        radii: Radii, shape (b,) [m].
        reach: Half length of each axis plus the radius: a ball about the axis' middle that holds
            the body, shape (b,) [m].
    """

    def __init__(self, arm: ArmModel, cell: CellConfig) -> None:
        zero = np.zeros((1, 6))
        self._T_6_scanner = T_6_scanner = (
            inverse(arm.links(zero)[0, 6]) @ arm.forward_scanner(zero)[0]
        )
        scanner = Body("scanner", 6, np.tile(T_6_scanner[:3, 3], (2, 1)), cell.scanner_radius_m)
        self.items: tuple[Body, ...] = (*arm.bodies, scanner)
        self.names = [body.link for body in self.items]
        joints = np.array([body.joint for body in self.items])
        self.order: NDArray[np.int64] = np.append(joints[:-1], SCANNER_LINK)
        self.radii: Array = np.array([body.radius for body in self.items])
        ends = np.array([body.ends for body in self.items])
        self.reach: Array = 0.5 * np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) + self.radii
        self._arm = arm
        self._groups = [
            (joint, np.flatnonzero(joints == joint), ends[joints == joint].reshape(-1, 3).T)
            for joint in np.unique(joints)
        ]

    def __len__(self) -> int:
        return len(self.items)

    def segments(self, q: Array) -> Array:
        """Returns the capsule axes in the arm base, shape (n, b, 2, 3) [m].

        Args:
            q: Joint positions, shape (n, 6) [rad].
        """
        return self.placed(q)[0]

    def placed(self, q: Array) -> tuple[Array, Array]:
        """Returns the capsule axes, (n, b, 2, 3), and the scanner, (n, 4, 4), in the arm base [m].

        Args:
            q: Joint positions, shape (n, 6) [rad].
        """
        frames = self._arm.links(q)
        result = np.empty((len(q), len(self.items), 2, 3))
        for joint, members, ends in self._groups:
            turned = frames[:, joint, :3, :3] @ ends + frames[:, joint, :3, 3, None]
            result[:, members] = turned.swapaxes(1, 2).reshape(len(q), len(members), 2, 3)
        return result, frames[:, 6] @ self._T_6_scanner


def first_hit(hits: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Returns the number of the first hit of each row, from 1; 0 = none.

    Args:
        hits: shape (n, k).
    """
    if not hits.shape[1]:
        return np.zeros(len(hits), dtype=np.int64)
    return np.where(hits.any(axis=1), np.argmax(hits, axis=1) + 1, 0)


def near_box(
    segments: Array, radii: Array, reach: Array, low: Array, high: Array
) -> NDArray[np.bool_]:
    """Tells which capsules come nearer to a box than a distance, shape (n, b).

    Args:
        segments: Axes in the box's frame, shape (n, b, 2, 3) [m].
        radii: Radius and distance to be kept, shape (b,) [m].
        reach: Ball about the axis' middle that holds the capsule and that distance, (b,) [m].
        low: Lower corner of the box, shape (3,) [m].
        high: Upper corner, shape (3,) [m].
    """
    middle = 0.5 * (segments[:, :, 0] + segments[:, :, 1])
    gap = box_distances(middle.reshape(-1, 3), low, high).reshape(middle.shape[:2])
    hits = gap < reach  # most capsules are far away
    row, body = np.nonzero(hits)
    hits[row, body] = segment_box_distances(segments[row, body], low, high) < radii[body]
    return np.asarray(hits)
