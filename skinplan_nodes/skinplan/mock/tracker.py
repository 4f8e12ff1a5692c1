"""A tracker that follows the scanner as long as it sees it (M1.1, C-Track)."""

import numpy as np
from scipy.spatial.transform import Rotation

from skinplan.mesh.model import SurfaceMesh
from skinplan.robot.arm import ArmModel
from skinplan.robot.bodies import Bodies
from skinplan.robot.cell import CellConfig
from skinplan.robot.tracker import TrackerSight
from skinplan.transforms import Array, inverse, require_transform, transform

#: Diagonal of the volume of 9.1 m^3 for which a volumetric accuracy is stated [m].
VOLUME_LENGTH_M = 3.6


class MockTracker:
    """Measures the scanner's pose with noise and with an error that grows over its volume.

    The volumetric error is a small linear distortion of the measured space, drawn once: lengths
    within the volume are wrong by at most `volumetric_m`, in proportion to the length.

    Args:
        T_map_tracker: Where it stands, shape (4, 4) [m]; +x is its view direction.
        seed: Of the noise and the distortion.
        noise_m: Standard deviation of the scanner's position, each axis [m].
        noise_rad: Standard deviation of the scanner's rotation, each axis [rad].
        volumetric_m: Greatest error of a length in the volume [m].
    """

    def __init__(
        self,
        T_map_tracker: Array,
        seed: int,
        noise_m: float = 2e-5,
        noise_rad: float = 3e-5,
        volumetric_m: float = 6.4e-5,
    ) -> None:
        self._T_tracker_map = inverse(require_transform(T_map_tracker, "T_map_tracker"))
        self._noise_m = noise_m
        self._noise_rad = noise_rad
        self._random = np.random.default_rng([seed, 0x72AC])
        axes = Rotation.random(random_state=np.random.default_rng([seed, 0x7015])).as_matrix()
        stretch = self._random.uniform(-1.0, 1.0, 3) * volumetric_m / VOLUME_LENGTH_M
        self._distortion: Array = axes @ np.diag(stretch) @ axes.T

    def measure(self, T_map_scanner: Array) -> Array:
        """Returns the scanner in the tracker frame, with its errors, shape (4, 4) [m].

        Raises:
            InputError: The pose is no rigid transform.
        """
        exact = self._T_tracker_map @ require_transform(T_map_scanner, "T_map_scanner")
        turn = Rotation.from_rotvec(self._random.normal(0.0, self._noise_rad, 3)).as_matrix()
        measured = exact @ transform(rotation=turn)
        measured[:3, 3] += self._distortion @ exact[:3, 3]
        measured[:3, 3] += self._random.normal(0.0, self._noise_m, 3)
        return measured


class LineOfSight:
    """Whether the tracker sees the scanner: range, cone, and what stands between them.

    Args:
        cell: The cell; the tracker's place and figures are its.
        model: The arm that holds the scanner.
        mesh: The true part, workpiece frame.
        T_map_workpiece: Where it truly stands, shape (4, 4) [m].
    """

    def __init__(
        self, cell: CellConfig, model: ArmModel, mesh: SurfaceMesh, T_map_workpiece: Array
    ) -> None:
        self._sight = TrackerSight(cell, mesh, T_map_workpiece)
        self._bodies = Bodies(model, cell)
        # A robot that stands is asked about sixty times a second, and most of the time it stands.
        self._last: tuple[bytes, bytes] = (b"", b"")
        self._answer = ""

    def hindrance(self, q: Array, T_map_arm_base: Array) -> str:
        """Returns why the tracker does not see the scanner; empty = it does.

        Args:
            q: True joint positions, shape (6,) [rad].
            T_map_arm_base: True pose of the arm's base, shape (4, 4) [m].
        """
        asked = (np.asarray(q, float).tobytes(), np.asarray(T_map_arm_base, float).tobytes())
        if asked != self._last:
            segments, T_arm_scanner = self._bodies.placed(q[None, :])
            code = int(
                self._sight.codes(self._bodies, segments, T_arm_scanner, T_map_arm_base[None])[0]
            )
            self._last, self._answer = asked, self._sight.names[code] if code else ""
        return self._answer
