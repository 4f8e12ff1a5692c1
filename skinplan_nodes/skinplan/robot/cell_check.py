"""Is the arm clear of itself, the floor, the base with its pedestal, and the cell's obstacles?"""

import numpy as np
from numpy.typing import NDArray

from skinplan.robot.arm import ArmModel
from skinplan.robot.bodies import SCANNER_LINK, Bodies, first_hit, near_box
from skinplan.robot.cell import CellConfig
from skinplan.robot.shapes import box_distances, segment_box_distances, segment_distances
from skinplan.transforms import Array, apply, inverse

PEDESTAL_RADIUS_M = 0.08


class SelfCheck:
    """The bodies among each other.

    Attributes:
        names: ``<link> with <link>`` of each pair that is compared.
    """

    def __init__(self, arm: ArmModel, bodies: Bodies, margin_m: float) -> None:
        order, names = bodies.order, bodies.names
        first, second = np.triu_indices(len(bodies), 1)
        kept = [
            abs(order[a] - order[b]) > 1
            and frozenset((names[a], names[b])) not in arm.pairs_left_out
            for a, b in zip(first, second, strict=True)
        ]
        self.first, self.second = first[kept], second[kept]
        self.names = [
            f"{names[a]} with {names[b]}" for a, b in zip(self.first, self.second, strict=True)
        ]
        # The wrist's links pass each other within millimetres by design: among links the capsules
        # are margin enough.
        margins = np.where(order[self.second] == SCANNER_LINK, margin_m, 0.0)
        self._keep = bodies.radii[self.first] + bodies.radii[self.second] + margins
        self._far = bodies.reach[self.first] + bodies.reach[self.second] + margins

    def hits(self, segments: Array) -> NDArray[np.int64]:
        """Returns the number of the first pair that meets, from 1; 0 = none, shape (n,)."""
        middle = 0.5 * (segments[:, :, 0] + segments[:, :, 1])
        gap = middle[:, self.first] - middle[:, self.second]
        near = np.einsum("npi,npi->np", gap, gap) < self._far**2
        row, pair = np.nonzero(near)
        distance = segment_distances(
            segments[row, self.first[pair]], segments[row, self.second[pair]]
        )
        near[row, pair] = distance < self._keep[pair]
        return first_hit(near)


class CellCheck:
    """The moving bodies against floor, base, pedestal and the cell's obstacles.

    Attributes:
        names: Names of the pairs.
    """

    def __init__(self, bodies: Bodies, cell: CellConfig, T_arm_base_map: Array | None) -> None:
        self._moving = np.flatnonzero(bodies.order >= 2)
        self._keep = bodies.radii[self._moving] + cell.collision_margin_m
        self._reach = bodies.reach[self._moving] + cell.collision_margin_m
        self._T_base_arm = cell.T_base_link_arm_base
        self.base_low, self.base_high = base_box(cell)
        self.pedestal = pedestal_axis(cell)
        self._obstacles = cell.obstacles if T_arm_base_map is not None else ()
        self._T_map_arm = None if T_arm_base_map is None else inverse(T_arm_base_map)
        things = ["floor", "base", "pedestal", *(o.name for o in self._obstacles)]
        links = [bodies.names[b] for b in self._moving]
        self.names = [f"{link} with {thing}" for thing in things for link in links]

    def hits(self, segments: Array, T_map_arm: Array | None = None) -> NDArray[np.int64]:
        """Returns the number of the first pair that meets, from 1; 0 = none, shape (n,).

        Args:
            segments: Capsule axes in the arm base, shape (n, b, 2, 3) [m].
            T_map_arm: Where the arm stands for each of them, shape (n, 4, 4) [m]; None = where the
                check was made for.
        """
        moving = segments[:, self._moving]
        floor, base, pedestal = self._base_hits(moving)
        found = [floor, base, pedestal]
        if self._obstacles:
            place = self._T_map_arm if T_map_arm is None else T_map_arm
            assert place is not None
            in_map = moved(moving, place)
            found += [
                near_box(
                    apply(inverse(o.T_map_box), in_map),
                    self._keep,
                    self._reach,
                    -0.5 * np.array(o.size_m),
                    0.5 * np.array(o.size_m),
                )
                for o in self._obstacles
            ]
        return first_hit(np.concatenate(found, axis=1))

    def _base_hits(self, moving: Array) -> tuple[NDArray[np.bool_], ...]:
        """Which moving bodies are in the floor, in the base and in the pedestal, each (n, m)."""
        T = self._T_base_arm
        height = moving @ T[2, :3] + T[2, 3]
        lowest = np.minimum(height[:, :, 0], height[:, :, 1])
        floor = lowest < self._keep
        base, pedestal = np.zeros_like(floor), np.zeros_like(floor)
        top = max(self.base_high[2], self.pedestal[1, 2] + PEDESTAL_RADIUS_M)
        row, body = np.nonzero(lowest < top + self._keep)  # most bodies are above all of it
        in_base = moving[row, body] @ T[:3, :3].T + T[:3, 3]
        middle = 0.5 * (in_base[:, 0] + in_base[:, 1])
        near = box_distances(middle, self.base_low, self.base_high) < self._reach[body]
        gap = segment_box_distances(in_base[near], self.base_low, self.base_high)
        base[row[near], body[near]] = gap < self._keep[body[near]]
        ends = np.sort(self.pedestal, axis=0)
        near = box_distances(middle, *ends) < self._reach[body] + PEDESTAL_RADIUS_M
        post = np.broadcast_to(self.pedestal, (int(near.sum()), 2, 3))
        gap = segment_distances(in_base[near], post)
        pedestal[row[near], body[near]] = gap < self._keep[body[near]] + PEDESTAL_RADIUS_M
        return floor, base, pedestal


def moved(segments: Array, T_a_b: Array) -> Array:
    """Maps segments, (n, b, 2, 3), by one transform, (4, 4), or by one for each row, (n, 4, 4)."""
    if T_a_b.ndim == 2:
        return segments @ T_a_b[:3, :3].T + T_a_b[:3, 3]
    joined = segments.reshape(len(segments), 2 * segments.shape[1], 3)
    flat = joined @ T_a_b[:, :3, :3].swapaxes(1, 2)
    return np.asarray((flat + T_a_b[:, None, :3, 3]).reshape(segments.shape))


def base_box(cell: CellConfig) -> tuple[Array, Array]:
    """Returns the corners of the base's box in the base frame, each of shape (3,) [m]."""
    length, width, height = cell.base_size_m
    return (
        np.array([-0.5 * length, -0.5 * width, 0.0]),
        np.array([0.5 * length, 0.5 * width, height]),
    )


def pedestal_axis(cell: CellConfig) -> Array:
    """Returns the axis of the pedestal's capsule in the base frame, shape (2, 3) [m]."""
    arm, height = cell.T_base_link_arm_base[:3, 3], cell.base_size_m[2]
    top = max(arm[2] - PEDESTAL_RADIUS_M, height)
    return np.array([[arm[0], arm[1], height], [arm[0], arm[1], top]])
