"""The beam from tracker to T-Mac: range, emission, incidence, and what stands in its way (C 4).

The emission angle is counted from the horizontal at the tracker (it turns freely about the
vertical), the incidence angle from the mirror's normal. The beam is blocked by the part, by the
vehicle and by every capsule of arm and tool but the T-Mac's own, which carries the mirror.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.contact.probing_arm import ProbingArm
from skinplan.mesh.model import SurfaceMesh
from skinplan.robot.shapes import segment_box_distances, segment_distances
from skinplan.scanner.rays import RayCaster
from skinplan.transforms import Array, inverse

_START_M = 0.002  # rays start this far in front of the mirror


@dataclass(frozen=True, eq=False)
class Beam:
    """Beams to mirrors, one per pose.

    Attributes:
        range_m: Length, shape (n,) [m].
        emission_rad: Angle to the horizontal, shape (n,) [rad].
        incidence_rad: Angle to the mirror's normal, shape (n,) [rad].
        allowed: All three within the limits, shape (n,).
    """

    range_m: Array
    emission_rad: Array
    incidence_rad: Array
    allowed: NDArray[np.bool_]


class Sight:
    """Line of sight in a cell with one part."""

    def __init__(self, arm: ProbingArm, mesh: SurfaceMesh | None) -> None:
        """Prepares the rays.

        Args:
            arm: Arm and tool, with the tracker's limits in its settings.
            mesh: The part, axial frame; None = nothing in the way.
        """
        self._arm = arm
        self._limits = arm.settings.tracker
        self._rays = RayCaster(mesh) if mesh is not None else None

    @property
    def incidence_max_rad(self) -> float:
        """Largest incidence angle [rad]."""
        return self._limits.incidence_max_rad

    def beams(self, tracker: Array, T_axial_mirror: Array) -> Beam:
        """Measures beams against the limits.

        Args:
            tracker: Its place, shape (3,) [m], axial frame.
            T_axial_mirror: Mirrors, shape (n, 4, 4) [m].
        """
        limits = self._limits
        gap = T_axial_mirror[:, :3, 3] - tracker
        length = np.linalg.norm(gap, axis=1)
        beam = gap / np.maximum(length, 1e-12)[:, None]
        emission = np.arcsin(np.clip(np.abs(beam[:, 2]), 0.0, 1.0))
        facing = -np.einsum("ni,ni->n", beam, T_axial_mirror[:, :3, 0])
        incidence = np.arccos(np.clip(facing, -1.0, 1.0))
        allowed = (length >= limits.range_min_m) & (length <= limits.range_max_m)
        allowed &= (emission <= limits.emission_max_rad) & (incidence <= limits.incidence_max_rad)
        return Beam(length, emission, incidence, allowed)

    def past_part(self, tracker: Array, mirrors: Array) -> NDArray[np.bool_]:
        """Tells to which mirrors, shape (n, 3) [m], the part leaves the beam free, shape (n,)."""
        if self._rays is None or not len(mirrors):
            return np.ones(len(mirrors), dtype=bool)
        gap = tracker - mirrors
        length = np.linalg.norm(gap, axis=1)
        way = gap / np.maximum(length, 1e-12)[:, None]
        blocked = self._rays.occluded(mirrors + _START_M * way, way, length - _START_M)
        return np.asarray(~blocked)

    def past_arm(
        self, tracker: Array, mirrors: Array, q: Array, T_axial_arm: Array
    ) -> NDArray[np.bool_]:
        """Tells at which configurations arm, tool and vehicle leave the beam free, shape (n,).

        Args:
            tracker: Its place, shape (3,) [m], axial frame.
            mirrors: Where the beams end, shape (n, 3) [m].
            q: Joint positions, shape (n, 6) [rad].
            T_axial_arm: Arm's base, shape (4, 4) [m].
        """
        if not len(q):
            return np.zeros(0, dtype=bool)
        others = len(self._arm.bodies) - 1  # the last one is the T-Mac
        bodies = self._arm.segments(q, T_axial_arm)[:, :others]
        beam = np.stack([np.broadcast_to(tracker, mirrors.shape), mirrors], axis=1)
        repeated = np.repeat(beam, others, axis=0)
        gaps = segment_distances(repeated, bodies.reshape(-1, 2, 3)).reshape(len(q), others)
        keep = self._limits.beam_clearance_m
        free = np.all(gaps >= self._arm.radii[:others] + keep, axis=1)
        T_arm_axial = inverse(T_axial_arm)
        seen_from_arm = beam @ T_arm_axial[:3, :3].T + T_arm_axial[:3, 3]
        low, high = self._arm.vehicle()
        return np.asarray(free & (segment_box_distances(seen_from_arm, low, high) >= keep))

    def holds(self, tracker: Array, q: Array, T_axial_arm: Array) -> list[str]:
        """Says why the tracker loses the T-Mac at configurations, (n, 6) [rad]; empty = holds."""
        T_axial_mirror = T_axial_arm @ self._arm.forward_mirror(q)
        beams = self.beams(tracker, T_axial_mirror)
        mirrors = T_axial_mirror[:, :3, 3]
        part = self.past_part(tracker, mirrors)
        arm = self.past_arm(tracker, mirrors, q, T_axial_arm)
        limits = self._limits
        reasons = np.full(len(q), "", dtype=object)
        reasons[~arm] = "beam broken by the arm"
        reasons[~part] = "beam broken by the part"
        reasons[beams.incidence_rad > limits.incidence_max_rad] = "incidence angle beyond its limit"
        reasons[beams.emission_rad > limits.emission_max_rad] = "emission angle beyond its limit"
        short, far = beams.range_m < limits.range_min_m, beams.range_m > limits.range_max_m
        reasons[short | far] = "tracker out of range"
        return [str(reason) for reason in reasons]
